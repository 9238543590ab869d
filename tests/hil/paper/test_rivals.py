"""Computed torque end to end, and the paper's argument: an error of the arm hurts it, and not the observer."""

from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
import pytest

from hil import scenario_file
from hil.assemble import build_nodes
from hil.errors import ScenarioError
from hil.evaluate import evaluate
from hil.experiment import switched
from hil.paper.rivals import SAME_ERROR, compare_rivals, rivals
from hil.rig import run_inline
from hil.scenario import Model
from hil.summary import deviations

URAD = 1e-6
COMPUTED_TORQUE = ("dsp.law=computed-torque", "joint.observer=false")
NO_FRICTION = "arm.coulomb_N_m=[0.0, 0.0, 0.0]"


@cache
def rows():
    with ThreadPoolExecutor(1) as executor:
        return {row.name: row for row in compare_rivals(scenario_file.load("paper-joint"), executor)}


def largest(name):
    """Of joints 1 to 3, urad."""
    return np.array(rows()[name].largest_rad) / URAD


def final(name):
    return np.array(rows()[name].final_rad) / URAD


def ran(name, *settings):
    return evaluate(run_inline(scenario_file.load(name, [*COMPUTED_TORQUE, *settings]), compiled=False))


# -- the law on the rig --


def test_with_exact_parameters_little_is_left():
    """Measured 24 / 26 / 26 urad, final 15 / 22 / 17.

    The delay: a torque acts 1.46 ms after its sample (a cycle, and the time to the Current frame), so it lacks that
    times the commanded jerk, 30 rad/s^3 at both ends, which K2 makes 22 urad. Friction at rest: see below.
    """
    assert np.all(largest("computed torque, exact") < 35)
    assert np.all(final("computed torque, exact") < 30)


def test_what_is_left_of_an_ideal_arm_is_the_delay_times_the_jerk():
    """No gravity, no Coulomb friction, an encoder 64 times finer: measured 20 / 22 / 24 urad; final below 1."""
    run = ran("paper-joint", NO_FRICTION, "arm.gravity_m_s2=0", f"encoder.counts_per_turn={64 * 819_200}")
    found = np.max(np.abs(run.deviation), axis=0) / URAD
    jerk, k2 = 60 * 0.5, 2000.0
    delays_s = 1e-3 + np.array([0.45e-3, 0.57e-3, 0.68e-3])
    assert found == pytest.approx(delays_s * jerk / k2 / URAD, rel=0.15)
    assert np.all(np.sqrt(np.mean(run.deviation[run.final_rows] ** 2, axis=0)) < 1 * URAD)


def test_friction_at_rest_keeps_what_the_end_of_the_motion_left():
    """Measured: final 2 / 6 / 8 urad without Coulomb friction, 15 / 22 / 17 with it."""
    frictionless = np.array(deviations(ran("paper-joint", NO_FRICTION))["final_deviation_rad"]) / URAD
    assert np.all(final("computed torque, exact") > 1.5 * frictionless)


def test_follows_a_path_in_task_space():
    """Measured 0.095 mm (the observer 0.071, neither 3.3).

    On the circle the joints turn back, where friction's sign, too, comes 1.5 ms late: up to 16 mrad/s of joint 3.
    """
    found = deviations(ran("paper-task"))
    assert max(found["max_position_deviation_m"]) < 0.15e-3


@pytest.mark.parametrize("name", ["one-joint", "two-joints", "five-joints"])
def test_holds_for_other_arms(name):
    """Measured 21, 26 and 50 urad."""
    assert max(deviations(ran(name))["max_deviation_rad"]) < 80 * URAD


# -- the paper's argument --


@pytest.mark.parametrize("error", ["- 20 %", "+ 20 %"])
def test_an_error_of_20_percent_hurts_computed_torque_and_not_the_observer(error):
    """Measured: 1020 / 658 / 828 urad or more, final 474 / 239 / 299, against 164 / 36 / 131, final below 6."""
    rival, observer = f"computed torque, model {error}", f"observer, Jn {error}"
    assert np.all(largest(rival) > 15 * largest("computed torque, exact"))
    assert np.all(final(rival) > 150)
    assert np.all(largest(observer) < 1.5 * largest("observer"))
    assert np.all(final(observer) < 15)
    assert np.all(largest(rival) > 4 * largest(observer))


def test_a_payload_hurts_who_does_not_know_of_it_and_not_the_observer():
    """2 kg: measured 2694 / 2747 / 13 491 urad, final 1296 / 1042 / 3132, against 212 / 68 / 404, final below 4."""
    assert np.all(largest("computed torque, 2 kg unknown") > 8 * largest("observer, 2 kg unknown"))
    assert np.all(final("computed torque, 2 kg unknown") > 500)
    assert np.all(final("observer, 2 kg unknown") < 15)
    assert np.all(largest("computed torque, 2 kg known") < 70)


def test_a_wrong_model_is_better_than_none():
    for error in ("model - 20 %", "model + 20 %"):
        assert np.all(largest("neither") > 1.5 * largest(f"computed torque, {error}"))
    assert np.all(largest("neither, 2 kg unknown") > 1.2 * largest("computed torque, 2 kg unknown"))


def test_nothing_saturates_and_nobody_stops():
    """AccelRef holds +-256 rad/s^2: the largest torque over Jn is 44, joint 3's with 2 kg."""
    assert {(row.saturations, row.fault) for row in rows().values()} == {(0, "")}
    run = ran("paper-joint", "load=[{mass_kg=2.0, at_s=0.0, until_s=1.5}]")
    assert 30 < np.nanmax(np.abs(run.a_ref)) < 60


def test_every_rival_is_a_run_of_the_same_arm():
    scenario = scenario_file.load("load-step", [*COMPUTED_TORQUE, "model.scale=0.5"])
    chosen = {rival.name: rival.scenario(scenario) for rival in rivals(scenario)}
    for name, each in chosen.items():
        assert (each.arm, each.trajectory, each.clock) == (scenario.arm, scenario.trajectory, scenario.clock)
        assert (each.dsp.law == "computed-torque") == name.startswith("computed torque")
        assert each.joint.observer == name.startswith("observer")
        assert each.load[:1] == scenario.load
        assert [load.mass_kg for load in each.load[1:]] == [2.0] * ("2 kg" in name)
    assert chosen["computed torque, exact"].model == Model()
    for observer, rival in SAME_ERROR:
        assert {f"observer, {observer}", f"computed torque, {rival}"} <= chosen.keys()


# -- the scenario --


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (["dsp.law=computed-torque"], r"joint.observer = true: .* set joint.observer = false, or dsp.law = 'accel"),
        (
            ["model.scale=0.8"],
            r"\[model\] scale=0.8 .* needs no model of the arm: leave it out",
        ),
        (["dsp.law=torque"], r"dsp.law = 'torque': Input should be 'acceleration' or 'computed-torque'"),
        ([*COMPUTED_TORQUE, "model.scale=0"], r"model.scale = 0: Input should be greater than 0"),
        ([*COMPUTED_TORQUE, "model.payload_kg=-1"], r"model.payload_kg = -1: Input should be greater than or equal"),
    ],
)
def test_what_does_not_go_together_is_refused(settings, message):
    with pytest.raises(ScenarioError, match=message):
        build_nodes(scenario_file.load("paper-joint", settings))


def test_the_counterpart_of_computed_torque_is_the_observer():
    scenario = scenario_file.load("paper-joint", [*COMPUTED_TORQUE, "model.scale=0.8"])
    assert switched(scenario) == scenario_file.load("paper-joint")
    plain = scenario_file.load("paper-joint", ["joint.observer=false"])
    assert switched(switched(plain)) == plain
