"""Straight-line source text of classical Runge-Kutta steps of the arm: four evaluations, no loop, no calls.

With q' = w the positions need no slopes of their own: q + h w + h^2/6 (a1 + a2 + a3) is the same sum as the textbook's.
The torque of a stage is Kt(q) i(t) + e, where e is what is constant over the step: external torque, and Coulomb
friction against the direction of each sliding joint. i comes at start, middle and end (an amplifier with lag moves it).
A step of three joints costs 4.8 us in CPython 3.11, and 0.5 us as machine code with the same bits (`compiled`).
Units: SI. Ref: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, table II.1.2.
"""

from functools import cache

from plant.closed_form import acceleration_lines, driving_lines, each, function_text, indented, unpack_lines
from plant.contact import Lines, contact_lines

_MOMENTS = ("", "half", "half", "h")  # of the four stages, after the step's start


@cache
def step_text(n: int, free: tuple[int, ...], watched: tuple[int, ...], ripple: bool, surfaces: int = 0) -> str:
    """Return the text of step(h, q, w, start, middle, end, e, modes) -> (q, w, calm) for the free joints.

    calm says of every watched joint that it moves in the direction of its mode (+1, -1) when the step ends, and that
    the acceleration at the start would not have turned it around (if that is so, it may have turned twice).
    With surfaces near the tip, where they are at the start is a further argument.
    """
    start, middle, end = (unpack_lines(n, i=current) for current in ("start", "middle", "end"))
    body = unpack_lines(n, q="q", w="w", e="e", s="modes")
    body += _step_lines(n, free, ripple, (start, middle, [], end), surfaces)
    calm = " and ".join(_calm(watched)) or "True"
    body += [f"return ({each(n, 'q{i}')}), ({each(n, 'w{i}')}), {calm}"]
    return function_text(f"step(h, q, w, start, middle, end, e, modes{', surfaces' if surfaces else ''})", body)


@cache
def glide_text(n: int, watched: tuple[int, ...], ripple: bool) -> str:
    """Return the text of glide(legs, q, w, e, modes) -> (legs done, q, w, q"): steps of an arm whose joints all slide.

    legs is flat: the span h and the n currents of one step, which are constant there, then those of the next. It stops
    before the first that would not be calm, or whose speeds would not be finite: what that means, others find out
    (q" is then of no use).
    """
    joints = tuple(range(1, n + 1))
    total = " + ".join(f"w{i}" for i in joints)
    leg = ["h = legs[k]", *(f"i{i} = legs[k + {i}]" for i in joints)]
    leg += _step_lines(n, joints, ripple, ([], [], [], []))
    leg += [f"total = {total}", f"if not ({' and '.join(['total - total == 0.0', *_calm(watched)])}):"]
    leg += indented([f"return k // {n + 1}, ({each(n, 'Q{i}')}), ({each(n, 'W{i}')}), ({each(n, 'a1_{i}')})"])
    body = [*unpack_lines(n, q="q", w="w", e="e", s="modes"), f"for k in range(0, len(legs), {n + 1}):", *indented(leg)]
    body += [*driving_lines(joints, ripple), *acceleration_lines(n, joints)]
    body += [f"return len(legs) // {n + 1}, ({each(n, 'q{i}')}), ({each(n, 'w{i}')}), ({each(n, 'x{i}')})"]
    return function_text("glide(legs, q, w, e, modes)", body)


def _step_lines(
    n: int, free: tuple[int, ...], ripple: bool, currents: tuple[Lines, Lines, Lines, Lines], surfaces: int = 0
) -> Lines:
    """Carry q_i, w_i of the free joints over h; Q_i, W_i is where they were; currents: what sets i_i before a stage."""
    body = ["half = 0.5 * h", *(f"Q{i} = q{i}; W{i} = w{i}" for i in free)]
    for stage, current in enumerate(currents, start=1):
        body += _stage_lines(free, stage) if stage > 1 else []
        body += current
        body += driving_lines(free, ripple) if ripple or current or stage == 1 or surfaces else []
        body += contact_lines(n, free, surfaces, _MOMENTS[stage - 1])
        body += acceleration_lines(n, free)
        body += [f"a{stage}_{i} = x{i}" for i in free] if stage < 4 else []
    return body + _end_lines(free)


def _stage_lines(free: tuple[int, ...], stage: int) -> Lines:
    span = "h" if stage == 4 else "half"
    lines = []
    for i in free:
        # w_i is still the speed of the stage before, which is the slope of q
        lines += [f"q{i} = Q{i} + {span} * w{i}", f"w{i} = W{i} + {span} * a{stage - 1}_{i}"]
    return lines


def _end_lines(free: tuple[int, ...]) -> Lines:
    lines = ["sixth = h / 6.0"]
    for i in free:
        lines += [
            f"c{i} = a2_{i} + a3_{i}",
            f"q{i} = Q{i} + h * (W{i} + sixth * (a1_{i} + c{i}))",
            f"w{i} = W{i} + sixth * (a1_{i} + c{i} + c{i} + x{i})",
        ]
    return lines


def _calm(watched: tuple[int, ...]) -> Lines:
    return [f"w{i} * s{i} > 0.0 and (W{i} + h * a1_{i}) * s{i} > 0.0" for i in watched]
