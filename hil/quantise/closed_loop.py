"""The closed loop in float64 beside the one in words, and what the database's scales cost of the difference."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dbc.codec import Codec
from hil.evaluate import Array, Evaluation, evaluate
from hil.quantise.float_twin import FloatSeats
from hil.quantise.unrounded import UnroundedSeats
from hil.rig import Progress, no_progress, run_inline
from hil.summary import deviations, faults

LARGEST, FINAL = "max_deviation_rad", "final_deviation_rad"


@dataclass(frozen=True)
class Loop:
    """Deviations of a run by joint: all of them (K, n), the largest, and the rms of the last 100 ms, rad."""

    deviation: Array
    largest: list[float]
    final: list[float]

    @classmethod
    def of(cls, evaluation: Evaluation) -> "Loop":
        """Return those of a run."""
        figures = deviations(evaluation)
        return cls(evaluation.deviation, figures[LARGEST], figures[FINAL])


class Stopped(Exception):
    """The run in float64 stopped itself: args[0] is the fault."""


def closed_loop(evaluation: Evaluation, codec: Codec, progress: Progress = no_progress) -> dict[str, Any]:
    """Run a scenario with joints in float64, with frames as they are and with frames that round nothing.

    Return the deviations of all three by joint, what words add to the largest, and what the database adds to it. fault:
    what ended a run in float64; its figures are left out then.
    """
    scenario, seats = evaluation.scenario, FloatSeats(evaluation.scenario, codec)
    try:
        in_float = _run(evaluation, seats, lambda share: progress(share / 2))
        unrounded = _run(evaluation, UnroundedSeats(scenario, codec), lambda share: progress((1 + share) / 2))
    except Stopped as stopped:
        return {"fault": stopped.args[0], "joints": []}
    words = Loop.of(evaluation)
    rows = [
        {
            "joint": joint,
            "max_deviation_rad": words.largest[joint - 1],
            "max_deviation_float_rad": in_float.largest[joint - 1],
            "penalty": _penalty(words.largest[joint - 1], in_float.largest[joint - 1]),
            "final_deviation_rad": words.final[joint - 1],
            "final_deviation_float_rad": in_float.final[joint - 1],
            "largest_difference_rad": _apart(words, in_float, joint),
            "largest_output_rounding": max(map(abs, step.roundings)),
            "max_deviation_unrounded_rad": unrounded.largest[joint - 1],
            "database_penalty": _penalty(in_float.largest[joint - 1], unrounded.largest[joint - 1]),
            "final_deviation_unrounded_rad": unrounded.final[joint - 1],
            "database_largest_difference_rad": _apart(in_float, unrounded, joint),
        }
        for joint, step in sorted(seats.steps.items())
    ]
    return {"fault": None, "joints": rows}


def _run(evaluation: Evaluation, seats: FloatSeats, progress: Progress) -> Loop:
    outcome = run_inline(evaluation.scenario, progress, compiled=False, seat=seats.seat)
    other, stopped = evaluate(outcome), faults(outcome)
    if other is None or stopped:
        raise Stopped(stopped[0])
    return Loop.of(other)


def _apart(one: Loop, other: Loop, joint: int) -> float:
    """Return the largest difference of a joint between two runs, rad."""
    return float(np.max(np.abs(one.deviation[:, joint - 1] - other.deviation[:, joint - 1])))


def _penalty(of_one: float, of_other: float) -> float | None:
    """Return by which share of the other's a deviation is larger; None where that is nothing."""
    return of_one / of_other - 1.0 if of_other > 0.0 else None
