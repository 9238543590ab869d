"""The search for a limit: the largest value of a quantity with which something still holds."""

from collections.abc import Callable
from dataclasses import dataclass
from math import floor

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
    while bad - good > 1:
        step = (good + bad) // 2
        good, bad = (step, bad) if at(step) else (good, step)
    return Largest(low + good * (high - low) / steps)
