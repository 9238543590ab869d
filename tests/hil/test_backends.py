"""The same closed loop with the arm computed in two ways; arms that one of them cannot carry."""

from functools import cache

import numpy as np
import pytest

from dbc.compiler import load_arm
from hil import backends, scenario_file
from hil.assemble import arm_parameters, build_nodes
from hil.backends import BackendComparison, compare_backends
from hil.errors import FaultError, ScenarioError
from hil.evaluate import evaluate
from hil.processes import run_processes
from hil.rig import run_inline
from plant.nominal import nominal_inertia

PYMUNK = "plant.backend=pymunk"
SHORT = "duration_s=0.1"


@cache
def compared(*settings: str) -> BackendComparison:
    return compare_backends(scenario_file.load("direct-drive", settings))


def test_in_a_closed_loop_frames_are_equal_until_an_edge_falls_between_two_angles() -> None:
    """7.7e-6 rad are a count; pymunk is 1e-7 rad off by then; what comes after needs no second backend."""
    found = compared()
    assert found.backends.cycles == 1500
    assert found.backends.angle_before.size <= 1e-6
    assert found.backends.counts.size <= 2 * found.control.counts.size
    assert found.backends.angle.size <= 2 * found.control.angle.size


def test_without_the_observer_encoder_frames_differ_by_one_count_at_most() -> None:
    found = compared("joint.observer=false").backends
    assert found.counts.size <= 1
    assert found.angle.size <= 8e-6


def test_an_arm_that_falls_falls_in_both_the_same_way() -> None:
    """Without currents, pymunk's own error and nothing else."""
    found = compared("duration_s=0.3", "drive.limit_A=1e-4", "joint.observer=false").backends
    assert found.counts.size <= 1
    assert found.angle.size <= 1e-6


def test_loads_torques_from_outside_and_ripple_act_alike() -> None:
    """A load that comes and goes within a step, and currents at the odd instants at which their frames end."""
    found = compared(
        "duration_s=0.3",
        "load=[{mass_kg=0.5, at_s=0.0300333, until_s=0.2}]",
        "torque=[{joint=2, amplitude_N_m=0.5, frequency_rad_s=50.0, at_s=0.05, until_s=0.25}]",
        "drive.ripple=[0.02, 0.02, 0.02]",
    )
    assert found.backends.angle_before.size <= 1e-6
    assert found.backends.angle.size <= 2 * found.control.angle.size


def test_the_nominal_inertia_of_direct_drive_is_the_least_over_the_workspace() -> None:
    scenario = scenario_file.load("direct-drive")
    least = nominal_inertia(arm_parameters(scenario, load_arm()))
    assert scenario.joint.inertia_kg_m2 == pytest.approx(least, rel=1e-3)


@pytest.mark.parametrize("backend", ["closed", "pymunk"])
def test_direct_drive_follows_its_command(backend: str) -> None:
    """The arm falls until the first currents act; after 0.3 s that is made good."""
    evaluation = evaluate(run_inline(scenario_file.load("direct-drive", [f"plant.backend={backend}"]), compiled=False))
    assert evaluation is not None
    deviation = abs(evaluation.deviation)
    assert deviation.max() <= 6e-3
    assert deviation[300:].max() <= 6e-4
    assert deviation[evaluation.final_rows].max() <= 5e-5


REFUSED = {
    ("paper-joint", PYMUNK): r"plant.backend = 'pymunk': rotor inertia of joint 2: 0\.5 kg m\^2, but pymunk takes 0",
    ("direct-drive", "arm.coulomb_N_m=[0.0, 0.0, 0.4]"): r"Coulomb friction of joint 3: 0\.4 N m, .* take the backend",
    ("direct-drive", "drive.lag_s=0.001"): r"amplifier lag: 0\.001 s, but pymunk takes 0",
    ("direct-drive", "arm.viscosity_N_m_s=[0.0, 0.0, 5.0]"): r"viscosity of joint 3: 5 N m s, but pymunk takes at most",
    ("direct-drive", "plant.backend=bullet"): r"plant.backend = 'bullet': Input should be 'closed' or 'pymunk'",
    ("direct-drive", "plant.backed=pymunk"): r"unknown key plant.backed: did you mean plant.backend\?",
}


@pytest.mark.parametrize(("name", "setting"), REFUSED)
def test_an_arm_that_a_backend_cannot_carry_is_refused(name: str, setting: str) -> None:
    with pytest.raises(ScenarioError, match=REFUSED[name, setting]):
        build_nodes(scenario_file.load(name, [PYMUNK, setting]))


def test_a_comparison_of_what_pymunk_cannot_carry_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"plant.backend = 'pymunk': rotor inertia of joint 2"):
        compare_backends(scenario_file.load("paper-joint", [SHORT]))


@pytest.mark.usefixtures("runtime")
def test_frames_are_the_same_inline_and_as_processes() -> None:
    scenario = scenario_file.load("direct-drive", [PYMUNK, SHORT])
    assert run_processes(scenario, "arm").log.sha256() == run_inline(scenario).log.sha256()


def test_a_comparison_says_where_and_why() -> None:
    text = str(compared())
    assert text.startswith("direct-drive: angles within ")
    assert "the closed form against itself with 1 mg on the hand differs by " in text
    alone = str(compared("joint.observer=false"))
    assert alone.endswith("rad")
    assert "by at most 1 counts" in alone
    assert str(compared(SHORT)).startswith("direct-drive: 100 cycles, all Encoder frames equal, angles within ")


def test_a_difference_is_found_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two off in one frame, three in a later one; what is missing is no difference."""
    outcome = run_inline(scenario_file.load("direct-drive", [SHORT]), compiled=False)
    counts = backends._encoder_counts(outcome)
    off = counts.copy()
    off[70, 1] += 2
    off[60, 2] -= 1
    off[80, 2] += 3
    off[90] = np.nan
    tables = iter((counts, off))
    monkeypatch.setattr(backends, "_encoder_counts", lambda _: next(tables))
    found = backends.difference(outcome, outcome)
    assert (found.first, found.beyond, found.counts) == ((1, 60, 3), (2, 70, 2), (3, 80, 3))
    assert found.angle.size == found.angle_before.size == 0.0


def test_runs_that_never_began_are_no_comparison() -> None:
    outcome = run_inline(scenario_file.load("direct-drive", [SHORT]), compiled=False)
    outcome.reports["plant"]["rows"] = []
    with pytest.raises(FaultError, match="direct-drive: a run ended in its set-up, nothing is there to compare"):
        backends.difference(outcome, outcome)


def test_counters_that_wrap_are_no_difference() -> None:
    assert backends._wrapped(np.array([[65535.0, -65535.0, np.nan, 32767.0]])).tolist() == [[-1.0, 1.0, 0.0, 32767.0]]
