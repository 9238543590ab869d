"""A rig whose frames round nothing: what acts is what was meant, and the frames are those of the rounded values."""

import numpy as np
import pytest

from dbc.compiler import load_arm
from hil import scenario_file
from hil.evaluate import evaluate
from hil.quantise.closed_loop import closed_loop
from hil.quantise.float_twin import FloatLaw
from hil.quantise.unrounded import UnroundedSeats
from hil.rig import run_inline

SHORT = ("duration_s=0.2", "trajectory.time_s=0.15", "trajectory.by_rad=[0.05, -0.05, 0.05]")
COUNT_A, COUNT_RAD_S2 = 1 / 2048, 1 / 128


@pytest.fixture(scope="module")
def scenario():
    return scenario_file.load("paper-joint", SHORT)


@pytest.fixture(scope="module")
def unrounded(scenario):
    """The evaluation of a run, and each joint's law with what it was given and what it meant."""
    seats = UnroundedSeats(scenario, load_arm())
    told = {}
    signals = FloatLaw.signals

    def listened(law, count, count_prev, w_prev, d, a_ref):
        found = signals(law, count, count_prev, w_prev, d, a_ref)
        told.setdefault(law, []).append((a_ref, found["i"][0]))
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(FloatLaw, "signals", listened)
        evaluation = evaluate(run_inline(scenario, compiled=False, seat=seats.seat))
    return evaluation, {n: np.array(told[step.law]) for n, step in seats.steps.items()}


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_the_amplifier_gives_what_the_joint_meant(unrounded, joint):
    """The plant records at kT what acted since the cycle before."""
    evaluation, told = unrounded
    acted = evaluation.current[1:, joint - 1]
    meant, framed = told[joint][:-1, 1] * COUNT_A, evaluation.i_ref[:-1, joint - 1]
    assert acted == pytest.approx(meant, abs=1e-12)
    assert np.max(np.abs(framed - meant)) <= 0.5 * COUNT_A
    assert np.mean(framed != meant) > 0.9


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_the_joint_hears_what_the_dsp_meant(unrounded, joint):
    """In the cycle after; the first two are nothing, before and at the start."""
    evaluation, told = unrounded
    heard, framed = told[joint][1:, 0] * COUNT_RAD_S2, evaluation.a_ref[:-1, joint - 1]
    assert np.max(np.abs(heard - framed)) <= 0.5 * COUNT_RAD_S2
    assert np.mean(heard != framed) > 0.5


def test_the_report_has_a_line_for_the_database(scenario):
    evaluation = evaluate(run_inline(scenario, compiled=False))
    rows = closed_loop(evaluation, load_arm())["joints"]
    for row in rows:
        assert row["database_largest_difference_rad"] > 0.0
        ratio = row["max_deviation_float_rad"] / row["max_deviation_unrounded_rad"]
        assert row["database_penalty"] == pytest.approx(ratio - 1.0)
