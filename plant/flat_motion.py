"""`stick_slip` on a flat arm: plain functions over arrays, which Numba takes as they are, to the same bits.

Nothing is remembered but the modes: what `stick_slip` keeps to save time in Python makes no result. Its modes are
those of `friction`, its instants those of `bracket`. Units: SI. Ref: eq. (1), c.
"""

from math import copysign, inf

from plant.bracket import begin, goes_on, guess, narrowed
from plant.flat_dynamics import FlatArm, balance, copy, current_after, runge_kutta_step
from plant.friction import BREAKAWAY_SLACK
from plant.stick_slip import MOST_PARTS, SHORTEST_PART


def advance(arm: FlatArm, span_s: float) -> bool:
    """Integrate over span_s, currents included; return False if changes of friction do not end."""
    settle(arm)
    if _stays(arm):
        return True
    left_s = span_s
    for _ in range(MOST_PARTS):
        left_s -= _advance_part(arm, left_s, span_s * SHORTEST_PART)
        if left_s <= 0.0:
            return True
        settle(arm)
    return False


def settle(arm: FlatArm) -> None:
    """Find the modes at this instant: the direction of joints that turn, and what fits for those at rest."""
    resting = 0
    at_rest = False
    for j in range(arm.joints):
        arm.modes[j] = int(copysign(1.0, arm.w[j]))
        at_rest = at_rest or arm.w[j] == 0.0
        resting += _rests(arm, j)
    if at_rest:
        _choose(arm, 3**resting)
    _set_constant(arm)


def _choose(arm: FlatArm, choices: int) -> None:
    """Try standing and both directions for every joint at rest, in the order of `friction`."""
    least, best = inf, 0
    for choice in range(choices):
        _take_choice(arm, choice, choices)
        contradiction = _contradiction(arm)
        if contradiction <= 0.0:
            return
        if contradiction < least:
            least, best = contradiction, choice
    _take_choice(arm, best, choices)


def _take_choice(arm: FlatArm, choice: int, choices: int) -> None:
    """Set the modes of the joints at rest: the digits of choice in base 3, 2 being -1, the last joint's the lowest."""
    unit = choices // 3
    for j in range(arm.joints):
        if _rests(arm, j):
            digit = choice // unit % 3
            arm.modes[j] = -1 if digit == 2 else digit
            unit //= 3


def _contradiction(arm: FlatArm) -> float:
    """Return by how much a joint at rest holds more than it can, or slides against its acceleration."""
    _set_constant(arm)
    a = arm.slopes[0]
    balance(arm, arm.q, arm.w, arm.current, a)
    worst = 0.0
    for j in range(arm.joints):
        if not _rests(arm, j):
            continue
        s = arm.modes[j]
        excess = abs(arm.held[j]) - arm.limit[j] * (1.0 + BREAKAWAY_SLACK) if s == 0 else -s * a[j]
        worst = max(worst, excess)
    return worst


def _rests(arm: FlatArm, j: int) -> bool:
    return bool(arm.w[j] == 0.0 and arm.limit[j] > 0.0)


def _set_constant(arm: FlatArm) -> None:
    for j in range(arm.joints):
        arm.constant[j] = arm.external[j] - arm.modes[j] * arm.limit[j]


def _stays(arm: FlatArm) -> bool:
    """Return whether all joints stand, and what they must hold does not change."""
    changes = 0
    for j in range(arm.joints):
        changes += arm.modes[j] != 0 or arm.current[j] != arm.reference[j]
    return changes == 0


def _advance_part(arm: FlatArm, longest_s: float, shortest_s: float) -> float:
    """Advance to the next change, at most longest_s; return how far."""
    part_s = longest_s
    calm = runge_kutta_step(arm, part_s)
    margin = _margin(arm, part_s)
    while margin > 0.0 and not calm and part_s > shortest_s:
        part_s *= 0.5  # it nearly stops: it may have stopped and set off again
        calm = runge_kutta_step(arm, part_s)
        margin = _margin(arm, part_s)
    if margin <= 0.0:
        part_s = _first_change(arm, part_s, margin)
        runge_kutta_step(arm, part_s)
    _take_step(arm, part_s)
    return part_s


def _take_step(arm: FlatArm, span_s: float) -> None:
    """Go where the last step led; a joint that rubs and would turn the other way stops."""
    current_after(arm, span_s, arm.current_then)
    copy(arm.current_then, arm.current)
    copy(arm.q_then, arm.q)
    for j in range(arm.joints):
        goes_on = arm.limit[j] == 0.0 or arm.modes[j] * arm.w_then[j] > 0.0
        arm.w[j] = arm.w_then[j] if goes_on else 0.0


def _first_change(arm: FlatArm, end_s: float, margin: float) -> float:
    """Return when a margin that is used up at end_s is so first: `bracket.first_negative`."""
    runge_kutta_step(arm, 0.0)
    search = begin(end_s, _margin(arm, 0.0), margin)
    while goes_on(search):
        at_s = guess(search)
        runge_kutta_step(arm, at_s)
        search = narrowed(search, at_s, _margin(arm, at_s))
    return search[1]


def _margin(arm: FlatArm, span_s: float) -> float:
    """Return what is left after the step of span_s before a joint must change: speed, or torque to hold."""
    margin = inf
    standing = 0
    for j in range(arm.joints):
        if arm.modes[j] == 0:
            standing += 1
        elif arm.limit[j] > 0.0:
            margin = min(margin, arm.modes[j] * arm.w_then[j])
    return min(margin, _release_margin(arm, span_s)) if standing else margin


def _release_margin(arm: FlatArm, span_s: float) -> float:
    """Return how much more [N m] the standing joint closest to its release could hold after the step of span_s."""
    current_after(arm, span_s, arm.current_then)
    balance(arm, arm.q_then, arm.w_then, arm.current_then, arm.slopes[0])
    margin = inf
    for j in range(arm.joints):
        if arm.modes[j] == 0:
            margin = min(margin, arm.limit[j] * (1.0 + 2.0 * BREAKAWAY_SLACK) - abs(arm.held[j]))
    return margin
