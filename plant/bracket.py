"""Where a function of time first falls below zero.

A search is a tuple that is told values, so that whoever cannot hand a function over (`flat_motion`) can search too.
Units: s. Ref: Illinois variant of regula falsi (Dowell, Jarratt, BIT 11, 1971), kept off its ends so that both move.
"""

from collections.abc import Callable
from math import frexp, ldexp

WIDTH_S = 1e-15
_HALVINGS = 60

Search = tuple[float, float, float, float, float, float, float]
"""low, high, the function there, which end moved last (1 low, -1 high, 0 none), width to reach, halvings left."""


def first_negative(function: Callable[[float], float], end_s: float) -> float:
    """Return the right end, within WIDTH_S, of a bracket in (0, end_s] where function turns from positive to <= 0.

    function(end_s) must not be positive. It may start at zero (a joint that sets off): then the bracket is searched by
    halving, and if function is positive nowhere, the shortest span tried is returned.
    """
    search = begin(end_s, function(0.0), function(end_s))
    while goes_on(search):
        at_s = guess(search)
        search = narrowed(search, at_s, function(at_s))
    return search[1]


def begin(end_s: float, at_low: float, at_high: float) -> Search:
    """Begin between 0 and end_s."""
    return 0.0, end_s, at_low, at_high, 0.0, _width(end_s), float(_HALVINGS)


def goes_on(search: Search) -> bool:
    """Return whether a value is to be told."""
    low, high, at_low, _, _, width, halvings = search
    return high - low > width if at_low > 0.0 else halvings > 0.0


def guess(search: Search) -> float:
    """Return of which time."""
    low, high, at_low, at_high, _, width, _ = search
    if at_low <= 0.0:
        return 0.5 * high
    inset = 0.4 * width  # every guess takes away this much, so the search ends
    at_s = low + (high - low) * at_low / (at_low - at_high)
    return min(max(at_s, low + inset), high - inset)


def narrowed(search: Search, at_s: float, value: float) -> Search:
    """Return the search that knows this value."""
    low, high, at_low, at_high, side, width, halvings = search
    if at_low <= 0.0:
        if value > 0.0:
            return at_s, high, value, at_high, 0.0, _width(high), halvings
        return low, at_s, at_low, value, 0.0, width, halvings - 1.0
    if value > 0.0:
        return at_s, high, value, at_high * (0.5 if side == 1.0 else 1.0), 1.0, width, halvings
    return low, at_s, at_low * (0.5 if side == -1.0 else 1.0), value, -1.0, width, halvings


def _width(high: float) -> float:
    """Return the width to reach: 8 ulp of high where that is more."""
    return max(WIDTH_S, ldexp(8.0, frexp(high)[1] - 53))
