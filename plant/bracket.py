"""Where a function of time first falls below zero.

Units: s. Ref: Illinois variant of regula falsi (Dowell, Jarratt, BIT 11, 1971), kept off its ends so that both move.
"""

from collections.abc import Callable
from math import ulp

WIDTH_S = 1e-15
_HALVINGS = 60


def first_negative(function: Callable[[float], float], end_s: float) -> float:
    """Return the right end, within WIDTH_S, of a bracket in (0, end_s] where function turns from positive to <= 0.

    function(end_s) must not be positive. It may start at zero (a joint that sets off): then the bracket is searched by
    halving, and if function is positive nowhere, the shortest span tried is returned.
    """
    low, high = 0.0, end_s
    at_low, at_high = function(0.0), function(end_s)
    for _ in range(_HALVINGS):
        if at_low > 0.0:
            return _close_in(function, low, high, at_low, at_high)
        middle = 0.5 * high
        at_middle = function(middle)
        if at_middle > 0.0:
            low, at_low = middle, at_middle
        else:
            high, at_high = middle, at_middle
    return high


def _close_in(function: Callable[[float], float], low: float, high: float, at_low: float, at_high: float) -> float:
    side = 0
    width = max(WIDTH_S, 8.0 * ulp(high))
    inset = 0.4 * width  # every guess takes away this much, so the search ends
    while high - low > width:
        guess = low + (high - low) * at_low / (at_low - at_high)
        guess = min(max(guess, low + inset), high - inset)
        value = function(guess)
        if value > 0.0:
            low, at_low, at_high, side = guess, value, at_high * (0.5 if side == 1 else 1.0), 1
        else:
            high, at_high, at_low, side = guess, value, at_low * (0.5 if side == -1 else 1.0), -1
    return high
