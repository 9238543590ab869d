"""How fast virtual time may go: as fast as the machine can, k times real time, or step by step."""

import time
from math import inf

from hil.wire.protocol import FAR_NS


class Pace:
    """rate: virtual seconds a wall second (inf: no limit). While paused only what was granted by `step` passes."""

    def __init__(self, rate: float = inf) -> None:
        self.rate = rate
        self.paused = False
        self._granted_ns = -FAR_NS
        self._anchor: tuple[float, int] | None = None

    @property
    def unlimited(self) -> bool:
        """Whether nothing but the machine limits it."""
        return self.rate == inf

    def set(self, rate: float) -> None:
        """Go on at another rate, from here."""
        self.rate = rate
        self._anchor = None

    def pause(self, now_ns: int) -> None:
        """Stand still."""
        self.paused, self._granted_ns = True, now_ns

    def resume(self) -> None:
        """Go on from here."""
        self.paused, self._anchor = False, None

    def step(self, now_ns: int, step_ns: int) -> None:
        """Pass step_ns, then stand still."""
        self.paused, self._granted_ns = True, max(self._granted_ns, now_ns) + step_ns

    def limit_ns(self, now_ns: int) -> int:
        """Return up to which instant time may go now."""
        if self.paused:
            return self._granted_ns
        if self.unlimited:
            return FAR_NS
        if self._anchor is None:
            self._anchor = time.monotonic(), now_ns
        began_s, began_ns = self._anchor
        return began_ns + round((time.monotonic() - began_s) * self.rate * 1e9)

    def wait_s(self, now_ns: int, due_ns: int) -> float:
        """Return the wall time until this instant may come; inf while paused."""
        if self.paused:
            return 0.0 if due_ns <= self._granted_ns else inf
        if self.unlimited:
            return 0.0
        return max(0.0, (due_ns - self.limit_ns(now_ns)) / 1e9 / self.rate)
