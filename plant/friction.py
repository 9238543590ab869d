"""Which joints slide, and which stand, when some of them have no speed: Coulomb friction as a complementarity problem.

A joint stands if what it must hold stays below its limit; otherwise it slides the way it accelerates. With M positive
definite exactly one acceleration fits (it minimises a' M a / 2 - torque' a + sum of limit |a|), so all choices are
tried, standing first. Modes: +1 and -1 are the direction of sliding, 0 is standing. Units: rad/s, rad/s^2, N m.
Not modelled: static friction above the kinetic one, Stribeck's curve.
"""

from collections.abc import Callable
from itertools import product
from math import copysign, inf

from plant.parameters import Vector

Modes = tuple[int, ...]
Balance = Callable[[Modes], tuple[Vector, Vector]]
"""modes -> (q", what standing joints hold)."""

# A joint that stands is released above limit (1 + slack); its release is located at limit (1 + 2 slack), so that
# rounding (1e-15 of the largest torque) cannot hold it again at the same instant, or turn a joint that sets off.
BREAKAWAY_SLACK = 1e-12


def modes_of(w: Vector, limit_Nm: Vector, balance: Balance) -> Modes:
    """Return the modes of joints with speeds w: the direction of those that turn, and what fits for those at rest.

    A joint without friction (limit 0) never stands. If rounding leaves no choice without contradiction, the least one.
    """
    modes = [int(copysign(1.0, v)) for v in w]
    if 0.0 not in w:
        return tuple(modes)
    resting = [j for j, (v, c) in enumerate(zip(w, limit_Nm, strict=True)) if v == 0.0 and c > 0.0]
    least, best = inf, tuple(modes)
    for choice in product((0, 1, -1), repeat=len(resting)):
        for j, s in zip(resting, choice, strict=True):
            modes[j] = s
        candidate = tuple(modes)
        contradiction = _contradiction(candidate, resting, limit_Nm, balance)
        if contradiction <= 0.0:
            return candidate
        if contradiction < least:
            least, best = contradiction, candidate
    return best


def release_margin(modes: Modes, limit_Nm: Vector, held_Nm: Vector) -> float:
    """Return how much more [N m] the standing joint closest to its release could hold; inf if none stands."""
    margin = inf
    for s, c, held in zip(modes, limit_Nm, held_Nm, strict=True):
        if s == 0:
            margin = min(margin, c * (1.0 + 2.0 * BREAKAWAY_SLACK) - abs(held))
    return margin


def _contradiction(modes: Modes, resting: list[int], limit_Nm: Vector, balance: Balance) -> float:
    """Return by how much a joint at rest holds more than it can, or slides against its acceleration."""
    a, held_Nm = balance(modes)
    worst = 0.0
    for j in resting:
        s = modes[j]
        worst = max(worst, abs(held_Nm[j]) - limit_Nm[j] * (1.0 + BREAKAWAY_SLACK) if s == 0 else -s * a[j])
    return worst
