"""What is on a bus while nobody of ours sends: listened to for a while, and judged.

Ref: linux/can/error.h (error frames).
"""

import time
from collections import Counter
from dataclasses import dataclass, field

import can

from dbc.codec import Codec
from hil.bus_errors import CURES, HARMLESS, WIRES, explain
from hil.can_port import CanPort
from hil.doctor.finding import Finding, Verdict

GOING_ON = "a run is going on: let it end, or stop it (cansend CHANNEL 010#01); if none is, another device sends 0x080"
STRANGER = (
    "another sender of our identifiers: see who by unplugging one device after the other, or take another channel"
)


@dataclass
class Traffic:
    """What was heard. ours: frames on our identifiers, by name. errors: error frames, by what they say. stamp_age_s:
    age of the freshest time stamp when its frame was taken. trouble: why it ended early."""

    seconds: float = 0.0
    frames: int = 0
    ours: Counter[str] = field(default_factory=Counter)
    errors: Counter[str] = field(default_factory=Counter)
    stamp_age_s: float | None = None
    trouble: str = ""

    def hear(self, message: can.Message, now_s: float, codec: Codec) -> None:
        """Take a frame; now_s: the system's clock."""
        if message.is_error_frame:
            self.errors.update(explain(message.arbitration_id, bytes(message.data)))
            return
        self.frames += 1
        age_s = now_s - message.timestamp
        if self.stamp_age_s is None or abs(age_s) < abs(self.stamp_age_s):
            self.stamp_age_s = age_s
        known = codec.by_identifier.get(message.arbitration_id)
        if known is not None and not message.is_extended_id:
            self.ours[known.name] += 1


def listen(port: CanPort, codec: Codec, seconds: float) -> Traffic:
    """Listen for a while and send nothing."""
    heard, began = Traffic(), time.monotonic()
    try:
        while (left := began + seconds - time.monotonic()) > 0:
            message = port.bus.recv(left)
            if message is not None:
                heard.hear(message, time.time(), codec)
    except (can.CanError, OSError) as error:
        heard.trouble = str(error)
    heard.seconds = time.monotonic() - began
    return heard


def check_traffic(heard: Traffic) -> list[Finding]:
    """Return what there is to say of what was heard."""
    return [others(heard), error_frames(heard)]


def others(heard: Traffic) -> Finding:
    """Does anybody send on our identifiers?"""
    limit = "nobody sends on our identifiers before a run"
    if heard.trouble:
        cure = f"{heard.trouble}: is the interface up?"
        return Finding("other traffic", f"listening failed after {heard.seconds:.1f} s", limit, "bad", cure)
    value = f"{heard.frames} frames in {heard.seconds:.1f} s"
    if not heard.ours:
        return Finding("other traffic", f"{value}, none on our identifiers", limit, "ok")
    value = f"{value}; ours: {', '.join(f'{name} {count}' for name, count in heard.ours.most_common(4))}"
    if "Sync" in heard.ours:
        return Finding("other traffic", value, limit, "warn", GOING_ON)
    return Finding("other traffic", value, limit, "bad", STRANGER)


def error_frames(heard: Traffic) -> Finding:
    """Does the controller report errors?"""
    if not heard.errors:
        return Finding("error frames", "0", "0", "ok")
    value = ", ".join(f"{text} {count}" for text, count in heard.errors.most_common())
    told = [text for text in heard.errors if text not in HARMLESS]
    cure = "; ".join(dict.fromkeys(CURES.get(text, WIRES) for text in told))
    verdict: Verdict = "bad" if "bus-off" in told or "no acknowledgement" in told else "warn" if told else "ok"
    return Finding("error frames", value, "0", verdict, cure)
