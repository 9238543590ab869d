"""Arms of 1 to 6 joints: they run, their frames scale, and what does not fit is refused with the sum."""

import numpy as np
import pytest

from dbc.compiler import load_arm
from hil import scenario_file
from hil.assemble import arm_parameters
from hil.errors import ScenarioError
from hil.evaluate import evaluate
from hil.figures import write_figures
from hil.processes import run_processes
from hil.rig import run_inline
from hil.summary import deviations, summarise
from hil.wire.bits import INTERMISSION_BITS, worst_case_bits
from plant.nominal import nominal_inertia

ARMS = {"one-joint": 1, "two-joints": 2, "paper-joint": 3, "five-joints": 5}
URAD = 1e-6

SIX = {
    "name": "six",
    "duration_s": 0.5,
    "start_rad": [0.4, 0.9, -0.5, 0.3, -0.3, 0.2],
    "clock": {"period_s": 0.002},
    "arm": {
        "lengths_m": [0.3, 0.25, 0.15, 0.1, 0.08, 0.05],
        "masses_kg": [3.0, 1.5, 0.5, 0.3, 0.2, 0.1],
        "rotor_inertia_kg_m2": [1.2, 0.5, 0.08, 0.03, 0.01, 0.01],
        "viscosity_N_m_s": [2.0, 1.0, 0.2, 0.08, 0.03, 0.02],
        "coulomb_N_m": [4.0, 2.0, 0.4, 0.15, 0.05, 0.02],
    },
    "drive": {"torque_constant_N_m_A": [10.0, 6.0, 2.0, 1.0, 0.5, 0.5]},
    "brake": {"torque_N_m": [60.0, 30.0, 8.0, 4.0, 2.0, 1.0]},
    "joint": {
        "g_rad_s": 350.0,
        "inertia_kg_m2": [1.345, 0.537, 0.0855, 0.0312, 0.0103, 0.01],
        "torque_constant_N_m_A": [10.0, 6.0, 2.0, 1.0, 0.5, 0.5],
    },
    "trajectory": {"kind": "quintic", "by_rad": [0.1, -0.1, 0.1, -0.1, 0.1, -0.1], "time_s": 0.4},
}


@pytest.mark.parametrize(("name", "joints"), ARMS.items())
def test_arm_follows_its_command_with_the_observer_and_not_without(name: str, joints: int) -> None:
    """At least ten times in the largest deviation and fifty in the final one, as fig. 15 of three joints."""
    on, off = (evaluate(run_inline(scenario_file.load(name, [f"joint.observer={on}"]))) for on in ("true", "false"))
    assert on is not None
    assert off is not None
    with_observer, without = deviations(on), deviations(off)
    assert len(with_observer["max_deviation_rad"]) == joints
    assert np.all(np.array(with_observer["max_deviation_rad"]) * 10 <= without["max_deviation_rad"])
    assert np.all(np.array(with_observer["final_deviation_rad"]) * 50 <= without["final_deviation_rad"])
    assert np.all(np.array(with_observer["final_deviation_rad"]) <= 20 * URAD)


@pytest.mark.parametrize("name", ["one-joint", "two-joints", "five-joints"])
def test_nominal_inertia_of_an_arm_is_the_least_that_its_motors_feel(name: str) -> None:
    scenario = scenario_file.load(name)
    least = nominal_inertia(arm_parameters(scenario, load_arm()))
    np.testing.assert_allclose(scenario.joint.inertia_kg_m2, least, rtol=0.004)  # written with three digits and more


def test_six_joints_run_as_processes_and_inline_to_the_same_frames() -> None:
    scenario = scenario_file.build({**SIX})
    outcome = run_processes(scenario, "arm")
    assert outcome.log.frames == run_inline(scenario).log.frames
    summary = summarise(outcome, evaluate(outcome), 0.0)
    assert [summary[key] for key in ("lost_frames", "deadline_misses", "saturations", "faults")] == [0, 0, 0, []]


def test_references_of_more_than_three_joints_come_in_a_second_frame() -> None:
    evaluation = evaluate(run_inline(scenario_file.load("five-joints")))
    assert evaluation is not None
    assert evaluation.a_ref.shape == (750, 5)
    assert not np.any(np.isnan(evaluation.a_ref))
    # a half turn of the command's acceleration is in every one of them, joints 4 and 5 included
    assert np.all(np.max(np.abs(evaluation.a_ref), axis=0) > 2.0)


def test_cycle_that_does_not_fit_is_refused_with_the_sum() -> None:
    """Five joints in 1 ms: the sum of the longest frames, each from the bits of its kind."""
    bits = [worst_case_bits(n) + INTERMISSION_BITS for n in (1, *[4] * 5, *[6] * 5, 8, 8, 8)]
    with pytest.raises(ScenarioError, match=r"the frames of one cycle need 1\d\d\d us") as refusal:
        run_inline(scenario_file.load("five-joints", ["clock.period_s=0.001"]))
    sum_of_kinds = "65 Sync + 5 x 95 Encoder + 5 x 115 Current + 2 x 135 AccelRef + 135 State"
    assert f"; {sum_of_kinds} = {sum(bits)} bits;" in str(refusal.value)


@pytest.mark.parametrize("setting", ["dsp.space=task", "trajectory={kind='line', by_m=[0.01, 0.0], time_s=1.0}"])
def test_task_space_takes_three_joints(setting: str) -> None:
    with pytest.raises(ScenarioError, match=r"task space \(x, y, phi\) takes 3 joints, but arm.lengths_m has 2"):
        scenario_file.load("two-joints", [setting])


@pytest.mark.parametrize("name", ["one-joint", "five-joints"])
def test_figures_have_a_row_a_joint(name: str, tmp_path) -> None:
    runs = [
        evaluate(run_inline(scenario_file.load(name, ["duration_s=0.2", f"joint.observer={on}"])))
        for on in ("true", "false")
    ]
    assert runs[0] is not None
    assert runs[1] is not None
    write_figures(tmp_path, runs[0], runs[1])
    response = (tmp_path / "response.svg").read_text()
    for joint in range(1, runs[0].scenario.joints + 1):
        assert f"joint {joint}: angle" in response
