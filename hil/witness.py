"""What a rig that only listens knows of a run by the Sync frame: its cycle, its log, and whose turn it is."""

import time
from typing import Any

from dbc.codec import Codec
from hil.constants import STOP_REASONS, cycle_frames
from hil.frame_log import FrameLog
from hil.scenario import Scenario


class Witness:
    """Hears every frame. began: wall time at cycle 0. strange: frames that the database does not know.

    lost: frames that were on the bus, since the next Sync stands for them, and that the rig was too slow to hear. One
    that comes behind that Sync, since sockets need not hear two senders in one order, is not lost, and is of its own
    cycle.
    """

    in_real_time = False
    """Whether silence is a matter of the nodes' own time."""
    patience_s = 0.0
    """For how long nothing may be heard until one looks what has become of the nodes."""

    def __init__(self, scenario: Scenario, codec: Codec) -> None:
        self.log = FrameLog()
        self.cycle = -scenario.clock.setup_cycles - 1
        self.began: float | None = None
        self.stopped = False
        self.strange = self.lost = 0
        self._period_ns = scenario.period_ns
        self._cycles = scenario.cycles
        self._names = {frame.identifier: name for name, frame in codec.items()}
        self._sync, self._stop = codec["Sync"], codec["Stop"]
        self._due = [name for name in cycle_frames(scenario.joints) if name != "State"]
        self._heard: set[str] = set()
        self._missed: set[str] = set()
        self._codecs = codec.by_identifier

    def hear(self, identifier: int, data: bytes, came_ns: int = 0) -> bool:
        """Take a frame; return whether it moved the run on: one that comes again, or nobody knows, does not.

        came_ns: when it came, on CLOCK_MONOTONIC; by Sync that does not matter.
        """
        name = self._names.get(identifier)
        if name is None:
            self.strange += 1
            return False
        if identifier == self._stop.identifier:
            self._end(data)
        if identifier == self._sync.identifier and not self._begin(data):
            return False
        if name in self._missed and self._is_of(self.cycle - 1, identifier, data):
            return self._take_late(name, identifier, data)
        moved = name not in self._heard
        self._heard.add(name)
        self.log.watch(self._instant(name, data, came_ns), identifier, data, sender_of(name))
        return moved

    def _end(self, data: bytes) -> None:
        """Take a Stop; that of the end stands for the Sync of the cycle behind the last."""
        self.stopped = True
        self.cycle += data == b"\0"

    def _is_of(self, cycle: int, identifier: int, data: bytes) -> bool:
        fields = self._codecs[identifier].unpack(data)
        return fields is not None and fields[-1] == cycle & 0xFF

    def _take_late(self, name: str, identifier: int, data: bytes) -> bool:
        """Take a frame that came behind the next Sync, and was counted as lost; it does not move the run on."""
        self._missed.discard(name)
        self.lost -= self.cycle > 0
        self.log.watch((self.cycle - 1) * self._period_ns, identifier, data, sender_of(name))
        return False

    def _instant(self, _name: str, _data: bytes, _came_ns: int) -> int:
        """Return when a frame was on the bus, in ns since cycle 0: by Sync, at the beginning of its cycle."""
        return self.cycle * self._period_ns

    @property
    def done(self) -> float:
        """The share of the run that is done, 0 to 1."""
        return min(max(self.cycle / self._cycles, 0.0), 1.0)

    def begins_cycle(self, identifier: int) -> bool:
        """Return whether a frame is a Sync."""
        return identifier == self._sync.identifier

    def _begin(self, data: bytes) -> bool:
        fields = self._sync.unpack(data)
        ahead = 0 if fields is None else (fields[0] - self.cycle) & 0xFF
        self.cycle += ahead
        missing = [name for name in self._due if name not in self._heard]
        if ahead and self.cycle > 0:
            self._count_missing(missing, ahead - 1)
        if ahead:
            self._missed = set() if self.in_real_time else set(missing)
            self._heard.clear()
        if self.began is None and self.cycle >= 0:
            self.began = time.perf_counter()
        return ahead > 0

    def _count_missing(self, names: list[str], cycles: int) -> None:
        """Count what was not heard, of the cycle that ends and of whole cycles behind it."""
        self.lost += len(names) + cycles * len(self._due)

    def figures(self) -> dict[str, Any]:
        """Return what was measured of the run's time: by Sync it has none."""
        return {}

    def end(self) -> str:
        """Say how the run ended that was heard."""
        if not self.log.frames:
            return "the run had not begun"
        end_ns, identifier, data, _ = self.log.frames[-1]
        stop = ""
        if identifier == self._stop.identifier and data:
            stop = f", Stop with reason {data[0]}, {STOP_REASONS.get(data[0], 'unknown')}"
        return f"the last frame was heard at {end_ns * 1e-9:.3f} s{stop}"

    def missing(self) -> str:
        """Return who is to speak next: the sender of the first frame of this cycle that has not come, else the DSP."""
        due = [name for name in self._due if name not in self._heard]
        if self.cycle < -1:  # before the references begin
            due = [name for name in due if not name.startswith("AccelRef")]
        return sender_of(due[0]) if due else "dsp"


def sender_of(frame: str) -> str:
    """Return who sends a frame, by its name; a Stop may be anybody's, and counts as the DSP's."""
    kind, _, number = frame.partition("_")
    if kind in ("Current", "Acknowledge"):
        return f"joint{number}"
    if kind in ("State", "Heartbeat"):
        return {"0": "plant", "7": "dsp"}.get(number, f"joint{number}")
    return "plant" if kind == "Encoder" else "dsp"
