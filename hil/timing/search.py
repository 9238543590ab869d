"""The search for a limit: the largest value of a quantity with which something still holds, the lowest bit rate."""

from collections.abc import Callable
from dataclasses import dataclass
from math import floor

from hil.wire.rates import NS_PER_S

SHORTEST_BIT_NS, LONGEST_BIT_NS = 1_000, 1_000_000
"""Of 1 Mbit/s and 1 kbit/s."""
STRIDES = 64
"""The first stride is this part of the span; the next ones double."""


@dataclass(frozen=True)
class Largest:
    """The largest value that holds; None if not even the least one does. beyond: it is the ceiling, and that holds."""

    value: float | None
    beyond: bool = False


def largest(holds: Callable[[float], bool], low: float, high: float, steps: int, begin: float) -> Largest:
    """Return the largest of so many steps from low to high that holds: the first limit that is met from a value on.

    Upwards if that one holds, else downwards, in strides that double, and then between the last two. So what holds may
    end below, too: a Jn that is too small is as bad as one too large.
    """

    def at(step: int) -> bool:
        return holds(low + step * (high - low) / steps)

    step = min(max(floor(steps * (begin - low) / (high - low)), 0), steps)
    upwards = at(step)
    end, stride = (steps, max(1, steps // STRIDES)) if upwards else (0, -max(1, steps // STRIDES))
    while True:
        if step == end:
            return Largest(high, beyond=True) if upwards else Largest(None)
        last, step = step, min(max(step + stride, 0), steps)
        if at(step) != upwards:
            break
        stride *= 2
    good, bad = (last, step) if upwards else (step, last)
    return Largest(low + _last(at, good, bad) * (high - low) / steps)


def lowest_bitrate(holds: Callable[[int], bool], shortest_ns: int = SHORTEST_BIT_NS) -> int | None:
    """Return the lowest bit rate, by the longest bit in whole ns with which it holds; None if the shortest is too long.

    It must hold for every shorter bit then, too: what bounds are made of grows with the bit.
    """
    if not holds(shortest_ns):
        return None
    return -(-NS_PER_S // _last(holds, shortest_ns, LONGEST_BIT_NS))


def _last(holds: Callable[[int], bool], good: int, bad: int) -> int:
    """Return the last step that holds between one that does and one that does not."""
    while bad - good > 1:
        step = (good + bad) // 2
        good, bad = (step, bad) if holds(step) else (good, step)
    return good
