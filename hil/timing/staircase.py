"""The recurrences of response-time analysis: how long a bus takes for all that may come meanwhile.

What comes is a sum of stairs, each climbing by one frame's time at a time. The least time that is as long as what comes
within it is found from below. Ref: M. Joseph, P. Pandya, "Finding response times in a real-time system" (1986).
"""

from collections.abc import Iterable
from typing import NamedTuple

STEPS = 5_000
"""From below to the answer, at most: close to full load there are more than anybody waits for."""
FULL = 1.0 - 1e-9
"""A load from which on no answer is looked for: it would take beyond all STEPS."""


class Stair(NamedTuple):
    """What comes within t: ceil((t + offset_ns) / period_ns) frames of time_ns each."""

    offset_ns: int
    period_ns: int
    time_ns: int


class Staircase:
    """A sum of stairs."""

    def __init__(self, stairs: Iterable[Stair]) -> None:
        self._stairs = list(stairs)
        self.load = sum(each.time_ns / each.period_ns for each in self._stairs)
        self._lift_ns = sum(each.offset_ns * each.time_ns / each.period_ns for each in self._stairs)

    def meets(self, constant_ns: int, from_ns: int) -> int | None:
        """Return the least t from from_ns on that is constant_ns and what comes within t; None if it is out of reach.

        At from_ns there must be at least that much. A stair lies nowhere below its slope, so the instant at which the
        slopes alone would meet t is none too late to begin with (the small numbers: floats may err).
        """
        if self.load > FULL:
            return None
        slopes_ns = (constant_ns + self._lift_ns) / (1.0 - self.load + 1e-12)
        t_ns = max(from_ns, int(slopes_ns * (1.0 - 1e-12)))
        stairs = self._stairs
        for _ in range(STEPS):
            longer_ns = constant_ns + sum([-(-(t_ns + offset) // period) * time for offset, period, time in stairs])
            if longer_ns <= t_ns:
                return t_ns
            t_ns = longer_ns
        return None
