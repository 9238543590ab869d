"""The DSP: sends Sync, sets the joints up, unwraps their counters and sends each its acceleration reference.

One cycle: Sync k by its timer at kT; when the last Encoder frame of cycle k has come, AccelRef k. It ends the run with
Stop, and says why.
"""

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from dbc.codec import Codec
from dbc.status import Status
from firmware_py.dsp.control import PositionControl
from firmware_py.dsp.kinematics import SingularPoint
from firmware_py.dsp.setup import Setup

INIT, READY, RUN, FAULT = 0, 1, 2, 3
STOP_END, STOP_NOT_READY, STOP_SINGULAR, STOP_ENCODER_LOST = 0, 3, 4, 6
NO_FAULT, FAULT_ENCODER_LOST, FAULT_STOPPED, FAULT_SINGULAR, FAULT_NOT_READY = 0, 1, 4, 5, 7
MISSES_TO_FAULT = 3
JOINTS_A_FRAME = 3
ACCEL_REFS = ("AccelRef", "AccelRef_2")
"""The frames of the references, each of three joints."""

Send = tuple[int, int, bytes]
Reaction = tuple[int, int | None, list[Send]]


@dataclass(frozen=True)
class DSPSettings:
    """What the DSP is built with.

    cycles: of the run; setup_cycles: before it; tables: parameter values of each joint; zero_rad: the pose at which the
    counters are zero; rad_per_count: of the encoders; counts_per_rad_s2: of AccelRef.
    """

    joints: int
    period_ns: int
    cycles: int
    setup_cycles: int
    compute_ns: int
    tables: tuple[tuple[int, ...], ...]
    zero_rad: tuple[float, ...]
    rad_per_count: float
    counts_per_rad_s2: float


class DSP:
    """The position controller's computer."""

    name = "dsp"

    def __init__(self, settings: DSPSettings, control: PositionControl, codec: Codec, status: Status) -> None:
        self.settings = settings
        self.control = control
        self.status = status
        self.setup = Setup(codec, settings.tables, version=codec.version)
        self.sync, self.stop = codec["Sync"], codec["Stop"]
        self.encoders = [codec[f"Encoder_{n}"] for n in range(1, settings.joints + 1)]
        frames = -(-settings.joints // JOINTS_A_FRAME)
        self.accel_refs = [codec[name] for name in ACCEL_REFS[:frames]]

        self.wakes_on = (self.encoders[-1].identifier, self.stop.identifier)
        self.stores = tuple(frame.identifier for frame in self.encoders[:-1]) + tuple(self.setup.answers)
        self.joint_of = {frame.identifier: n for n, frame in enumerate(self.encoders)}

        self.state = INIT
        self.fault = NO_FAULT
        self.message = ""
        self.cycle = -settings.setup_cycles
        self.handled = True
        self.finished = False
        self.counts = [0] * settings.joints
        self.counter = [0] * settings.joints
        self.encoder_cycle = [0] * settings.joints
        self.q = array("f", settings.zero_rad)
        self.missed_in_a_row = 0
        self.missed_encoders = 0
        self.crc_errors = 0
        self.reference_saturations = [0] * settings.joints

    def on_start(self, now_ns: int) -> Reaction:
        """Begin at the next multiple of the period."""
        period_ns = self.settings.period_ns
        return 0, -(-now_ns // period_ns) * period_ns, []

    def store(self, identifier: int, data: bytes, _at_ns: int) -> None:
        """Keep an Encoder frame, or take an acknowledgement."""
        if identifier in self.joint_of:
            self._take_encoder(identifier, data)
        else:
            self.setup.store(identifier, data)

    def on_timer(self, now_ns: int) -> Reaction:
        """Begin a cycle with Sync, or end the run."""
        self.cycle = cycle = now_ns // self.settings.period_ns
        if cycle >= self.settings.cycles:
            return self._end(STOP_END, NO_FAULT, "")
        if not self.handled and self._encoders_lost():
            return self._end(STOP_ENCODER_LOST, FAULT_ENCODER_LOST, "no Encoder frame for three cycles")
        if self.setup.refusal:
            return self._end(STOP_NOT_READY, FAULT_NOT_READY, self.setup.refusal)
        if cycle == -1 and not self.setup.complete:
            name = f"joint{self.setup.joint + 1}"
            return self._end(STOP_NOT_READY, FAULT_NOT_READY, f"{name} was not ready by cycle -2")
        self.handled = False
        sync = (0, self.sync.identifier, self.sync.pack(cycle & 0xFF))
        return 0, now_ns + self.settings.period_ns, [sync]

    def on_frame(self, identifier: int, data: bytes, now_ns: int) -> Reaction:
        """Answer the last Encoder frame of the cycle with the references of all joints."""
        if identifier == self.stop.identifier:
            if self.stop.unpack(data) is None:
                self.crc_errors += 1
                return 0, (self.cycle + 1) * self.settings.period_ns, []
            self.finished = True
            self.state, self.fault = INIT, FAULT_STOPPED
            return 0, None, []
        self._take_encoder(identifier, data)
        self.handled = True
        self.missed_in_a_row = 0
        try:
            sends = self._answer()
        except SingularPoint as error:
            return self._end(STOP_SINGULAR, FAULT_SINGULAR, str(error))
        sends += self.status.sends(
            now_ns, self.state, self.fault, sum(self.reference_saturations), 0, self.missed_encoders, self.setup.version
        )
        return self.settings.compute_ns, (self.cycle + 1) * self.settings.period_ns, sends

    def _answer(self) -> list[Send]:
        if self.cycle < -1:
            frame = self.setup.next_frame()
            self.state = READY if self.setup.complete else INIT
            return [] if frame is None else [(self.settings.compute_ns, *frame)]
        if self.cycle == -1:
            return self._references([0.0] * self.settings.joints)
        self.state = RUN
        self._unwrap()
        return self._references(self.control.step(self.cycle, tuple(self.q)))

    def _take_encoder(self, identifier: int, data: bytes) -> None:
        joint = self.joint_of[identifier]
        fields = self.encoders[joint].unpack(data)
        if fields is None:
            self.crc_errors += 1
            return
        self.counter[joint], self.encoder_cycle[joint] = fields

    def _unwrap(self) -> None:
        """Carry the 16-bit counters on to angles; a joint whose frame of this cycle is missing keeps its angle."""
        settings = self.settings
        for joint, counter in enumerate(self.counter):
            if self.encoder_cycle[joint] != self.cycle & 0xFF:
                self.missed_encoders += 1
                continue
            self.counts[joint] += ((counter - self.counts[joint] + 0x8000) & 0xFFFF) - 0x8000
            self.q[joint] = settings.zero_rad[joint] + self.counts[joint] * settings.rad_per_count

    def _references(self, accelerations: Sequence[float]) -> list[Send]:
        """Pack q"_ref into AccelRef frames, rounded to the nearest count; what does not fit is limited and counted."""
        raw = [0] * (JOINTS_A_FRAME * len(self.accel_refs))
        for joint, acceleration in enumerate(accelerations):
            count = round(acceleration * self.settings.counts_per_rad_s2)
            raw[joint] = max(-0x8000, min(0x7FFF, count))
            self.reference_saturations[joint] += raw[joint] != count
        return [
            (
                self.settings.compute_ns,
                frame.identifier,
                frame.pack(*raw[m * JOINTS_A_FRAME : (m + 1) * JOINTS_A_FRAME], self.cycle & 0xFF),
            )
            for m, frame in enumerate(self.accel_refs)
        ]

    def _encoders_lost(self) -> bool:
        """Count a cycle that never saw its last Encoder frame; three in a row end the run."""
        self.missed_encoders += 1
        self.missed_in_a_row += 1
        return self.missed_in_a_row >= MISSES_TO_FAULT

    def _end(self, reason: int, fault: int, message: str) -> Reaction:
        self.fault = fault
        self.state = FAULT if fault else self.state
        self.message = message
        self.finished = True
        return 0, None, [(0, self.stop.identifier, self.stop.pack(reason))]

    def report(self) -> dict[str, Any]:
        """Counters of the emulated system, by cause."""
        return {
            "fault": self.message,
            "skipped_status": self.status.skipped,
            "crc_errors": self.crc_errors + self.setup.crc_errors,
            "missed_encoders": self.missed_encoders,
            "repeated_parameters": self.setup.repeats,
            "saturations": {f"AccelRef joint{n}": count for n, count in enumerate(self.reference_saturations, start=1)},
        }
