"""What a rig that only listens knows of a run by the machine's clock: when each frame was on the bus, and how late."""

from array import array
from collections import Counter
from typing import Any

from dbc.codec import Codec
from hil.latency import distribution
from hil.scenario import Scenario
from hil.witness import Witness

PATIENCE = 5.0
"""Periods of silence after which one looks what has become of the nodes: their own rules engage the brakes before."""
SLOW = ("State", "Heartbeat")
"""Frames of many senders that count as one."""


class WallWitness(Witness):
    """Knows by the stamps, too, when each frame was on the bus.

    missing_frames: not heard in their cycle, by name; skipped: cycles without Sync; since_sync_s: of each frame, behind
    its cycle's Sync, in wall time; intervals_s: from Sync to Sync.
    """

    in_real_time = True

    def __init__(self, scenario: Scenario, codec: Codec) -> None:
        super().__init__(scenario, codec)
        self.missing_frames: Counter[str] = Counter()
        self.skipped = 0
        self.since_sync_s: dict[str, array[float]] = {}
        self.intervals_s = array("d")
        self._pace = scenario.clock.pace
        self._wall_period_s = scenario.clock.period_s / scenario.clock.pace
        self.patience_s = PATIENCE * self._wall_period_s
        self._sync_came_ns = 0

    def _instant(self, name: str, came_ns: int) -> int:
        if name == "Sync":
            if self.cycle > 0:
                self.intervals_s.append((came_ns - self._sync_came_ns) * 1e-9)
            self._sync_came_ns = came_ns
        elif self.cycle >= 0:
            kind = name.partition("_")[0] if name.startswith(SLOW) else name
            self.since_sync_s.setdefault(kind, array("d")).append((came_ns - self._sync_came_ns) * 1e-9)
        since_ns = max(0, came_ns - self._sync_came_ns)
        return self.cycle * self._period_ns + min(round(since_ns * self._pace), self._period_ns - 1)

    def _count_missing(self, names: list[str], cycles: int) -> None:
        self.missing_frames.update(names)
        self.skipped += cycles

    def figures(self) -> dict[str, Any]:
        """Return what was measured of the run's time."""
        return {
            "pace": self._pace,
            "period_s": self._wall_period_s,
            "skipped_cycles": self.skipped,
            "missing_frames": dict(self.missing_frames),
            "sync_interval": distribution(self.intervals_s),
            "since_sync": {name: distribution(values) for name, values in sorted(self.since_sync_s.items())},
        }
