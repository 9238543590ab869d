"""What a rig that only listens knows of a run by the machine's clock: when each frame was on the bus, and how late."""

from array import array
from collections import Counter
from collections.abc import Callable, Collection
from typing import Any

from dbc.codec import Codec
from hil.constants import BUS, BY_TURNS, COMPUTING, DRIVE, HOST
from hil.latency import distribution
from hil.scenario import Scenario
from hil.wall_drive import LATE_END
from hil.witness import Witness, sender_of

PATIENCE = 5.0
"""Periods of silence after which one looks what has become of the nodes: their own rules engage the brakes before."""


class WallWitness(Witness):
    """Knows by the stamps, too, when each frame was on the bus.

    missing_frames: not heard in their cycle, by name; skipped: cycles without Sync; since_sync_s: of each frame, behind
    its cycle's Sync, in wall time; answers_s: of each frame, behind the one that it answers; by_dsp_s: of each
    Current, behind the Sync before its own, whose AccelRef it uses; intervals_s: from Sync to Sync. misses: of each
    joint's current, by cause. external: nodes of somebody else; errors: on the bus, so far.
    """

    in_real_time = True

    def __init__(
        self,
        scenario: Scenario,
        codec: Codec,
        external: Collection[str] = (),
        errors: Callable[[], int] = lambda: 0,
    ) -> None:
        super().__init__(scenario, codec)
        self._codec = codec
        self._joints = range(1, scenario.joints + 1)
        self._external, self._errors, self._errors_before = external, errors, 0
        self.missing_frames: Counter[str] = Counter()
        self.skipped = 0
        self.since_sync_s: dict[str, array[float]] = {}
        self.answers_s: dict[str, array[float]] = {}
        self.by_dsp_s: dict[str, array[float]] = {}
        self.intervals_s = array("d")
        self.misses = {f"joint{n}": dict.fromkeys((BUS, COMPUTING, DRIVE, HOST), 0) for n in self._joints}
        self._pace = scenario.clock.pace
        self._wall_period_s = scenario.clock.period_s / scenario.clock.pace
        self.patience_s = PATIENCE * self._wall_period_s
        self._sync_came_ns = 0
        self._sync_before_ns: int | None = None
        self._came_ns: dict[str, int] = {}

    def _instant(self, name: str, data: bytes, came_ns: int) -> int:
        if name == "Stop" and data == b"\0":
            return self.cycle * self._period_ns
        if name == "Sync":
            if self.cycle > 0:
                self.intervals_s.append((came_ns - self._sync_came_ns) * 1e-9)
            self._sync_before_ns = self._sync_came_ns if self.cycle > 0 and "AccelRef" in self._came_ns else None
            self._sync_came_ns = came_ns
            self._came_ns.clear()
        self._came_ns[name] = came_ns
        since_ns = came_ns - self._sync_came_ns
        if self.cycle >= 0 and (name in self._due[1:] or name.startswith(BY_TURNS)):
            kind = name.partition("_")[0] if name.startswith(BY_TURNS) else name
            late_s = self._age(name, data) * self._wall_period_s
            self.since_sync_s.setdefault(kind, array("d")).append(since_ns * 1e-9 + late_s)
            asked_ns = None if late_s else self._came_ns.get(self._answered(name))
            if asked_ns is not None:
                self.answers_s.setdefault(name, array("d")).append((came_ns - asked_ns) * 1e-9)
            if not late_s and kind.startswith("Current") and self._sync_before_ns is not None:
                self.by_dsp_s.setdefault(name, array("d")).append((came_ns - self._sync_before_ns) * 1e-9)
        return self.cycle * self._period_ns + min(round(max(0, since_ns) * self._pace), self._period_ns - 1)

    def _answered(self, name: str) -> str:
        """Return the frame that one answers; State and Heartbeat come by a timer."""
        kind, _, number = name.partition("_")
        if kind.startswith("Encoder"):
            return "Sync"
        if kind == "Current":
            return f"Encoder_{number}"
        return f"Encoder_{self._joints[-1]}" if kind == "AccelRef" else ""

    def _age(self, name: str, data: bytes) -> int:
        """Return by how many cycles a frame is late: behind how many Syncs that are not its own."""
        fields = self._codec[name].unpack(data)
        age = 0 if fields is None else (self.cycle - fields[-1]) & 0xFF
        return age if age < 0x80 else 0

    def _end(self, data: bytes) -> None:
        """Count what the last cycle lacks; the DSP may have skipped some of the last."""
        self.stopped = True
        if data == b"\0":
            ahead = max(1, self._cycles - self.cycle)
            self._count_missing([name for name in self._due if name not in self._heard], ahead - 1)
            self.cycle += ahead if ahead <= LATE_END else 1

    def _count_missing(self, names: list[str], cycles: int) -> None:
        self.missing_frames.update(names)
        self.skipped += cycles
        errors = self._errors()
        disturbed, self._errors_before = errors > self._errors_before, errors
        for n in self._joints:
            first = next((name for name in (f"Encoder_{n}", f"Current_{n}") if name in names), None)
            if first is not None:
                foreign = sender_of(first) in self._external
                self.misses[f"joint{n}"][BUS if disturbed else COMPUTING if foreign else HOST] += 1
            self.misses[f"joint{n}"][HOST] += cycles

    def figures(self) -> dict[str, Any]:
        """Return what was measured of the run's time."""
        return {
            "pace": self._pace,
            "period_s": self._wall_period_s,
            "skipped_cycles": self.skipped,
            "missing_frames": dict(self.missing_frames),
            "sync_interval": distribution(self.intervals_s),
            "since_sync": {name: distribution(values) for name, values in sorted(self.since_sync_s.items())},
            "answers": {name: distribution(values) for name, values in sorted(self.answers_s.items())},
            "by_dsp": {name: distribution(values) for name, values in sorted(self.by_dsp_s.items())},
            "current_misses": self.misses,
        }
