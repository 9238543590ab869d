"""The figures that the bench stands for, on whole runs of the built-in scenarios, inline."""

from functools import cache

import numpy as np
import pytest

from hil import scenario_file
from hil.evaluate import Evaluation, evaluate
from hil.rig import Outcome, run_inline
from hil.summary import deviations, summarise

URAD = 1e-6


@cache
def ran(name: str, *settings: str) -> Outcome:
    return run_inline(scenario_file.load(name, settings))


def evaluated(name: str, *settings: str) -> Evaluation:
    evaluation = evaluate(ran(name, *settings))
    assert evaluation is not None
    return evaluation


def figures(name: str, *settings: str) -> dict[str, np.ndarray]:
    return {key: np.array(value) for key, value in deviations(evaluated(name, *settings)).items()}


OFF = "joint.observer=false"


def test_paper_joint_stays_within_300_urad_and_ends_within_20() -> None:
    found = figures("paper-joint")
    assert np.all(found["max_deviation_rad"] <= 300 * URAD)
    assert np.all(found["final_deviation_rad"] <= 20 * URAD)


def test_paper_joint_without_the_observer_is_10_times_worse_and_50_times_at_the_end() -> None:
    on, off = figures("paper-joint"), figures("paper-joint", OFF)
    assert np.all(off["max_deviation_rad"] >= 10 * on["max_deviation_rad"])
    assert np.all(off["final_deviation_rad"] >= 50 * on["final_deviation_rad"])


def test_paper_task_stays_within_1_2_cm_a_second_and_0_3_mm() -> None:
    found = figures("paper-task")
    assert np.all(found["max_velocity_deviation_m_s"] <= 0.012)
    assert np.all(found["max_position_deviation_m"] <= 0.3e-3)
    # 2 pi r / time at the quintic's peak rate of 15/8.
    assert found["peak_command_speed_m_s"] == pytest.approx(2 * np.pi * 0.05 * 15 / 8, rel=1e-4)


def test_paper_task_without_the_observer_is_2_times_worse_in_velocity_and_10_times_in_position() -> None:
    on, off = figures("paper-task"), figures("paper-task", OFF)
    assert np.all(off["max_velocity_deviation_m_s"] >= 2 * on["max_velocity_deviation_m_s"])
    assert np.all(off["max_position_deviation_m"] >= 10 * on["max_position_deviation_m"])


def test_a_load_on_the_hand_moves_the_arm_without_the_observer_and_not_with_it() -> None:
    unloaded, loaded = figures("paper-joint", OFF, "duration_s=2.2"), figures("load-step", OFF)
    moved = np.abs(_final_mean("load-step", OFF) - _final_mean("paper-joint", OFF, "duration_s=2.2"))
    assert np.all(moved >= 0.3e-3)
    assert np.all(loaded["final_deviation_rad"] > unloaded["final_deviation_rad"])
    assert np.all(figures("load-step")["final_deviation_rad"] <= 30 * URAD)


def _final_mean(name: str, *settings: str) -> np.ndarray:
    evaluation = evaluated(name, *settings)
    mean: np.ndarray = evaluation.deviation[evaluation.final_rows].mean(axis=0)
    return mean


@pytest.mark.parametrize("name", [name for name in scenario_file.builtin_names() if name != "drift"])
@pytest.mark.parametrize("settings", [(), (OFF,), ("bus.fidelity=functional",)])
def test_nothing_is_lost_missed_or_saturated_in_a_built_in_scenario(name: str, settings: tuple[str, ...]) -> None:
    """All but drift, which is late on purpose (tests/hil/timing/test_drift.py)."""
    summary = summarise(ran(name, *settings), evaluated(name, *settings), 0.0)
    assert [summary[key] for key in ("lost_frames", "deadline_misses", "saturations", "faults")] == [0, 0, 0, []]
    assert summary["cycles"] == scenario_file.load(name, settings).cycles


def test_the_terms_of_the_disturbance_add_up_to_the_truth_of_eq_3() -> None:
    """Ktn i - Jn q" from the plant's own record, rounding only."""
    outcome, evaluation = ran("load-step"), evaluated("load-step")
    report = outcome.reports["plant"]
    rows = np.array(report["rows"])[: outcome.scenario.cycles]
    acceleration = rows[:, [report["columns"].index(f"a_rad_s2_{n}") for n in (1, 2, 3)]]
    Ktn, Jn = np.array(outcome.scenario.joint.torque_constant_N_m_A), np.array(outcome.scenario.joint.inertia_kg_m2)
    expected = Ktn * evaluation.current - Jn * acceleration
    np.testing.assert_allclose(evaluation.disturbance.total(), expected, atol=1e-9)


def test_the_estimate_follows_the_true_disturbance() -> None:
    """Means over 100 ms within 3 % of the largest, from 100 ms on.

    One count of the encoder is worth 7.2 N m of joint 1's estimate in one sample, so samples cannot be compared.
    """
    evaluation = evaluated("paper-joint")
    truth, estimate = (
        values[100:1000].reshape(-1, 100, 3).mean(axis=1)
        for values in (evaluation.disturbance.total(), evaluation.estimate)
    )
    assert np.all(np.abs(estimate - truth) <= 0.03 * np.max(np.abs(truth), axis=0))


def test_bits_and_functional_differ_in_time_and_little_in_motion() -> None:
    """The action delays of `functional` are the worst-case ends of the frames: a tenth of a period apart at most."""
    bits, functional = evaluated("paper-joint"), evaluated("paper-joint", "bus.fidelity=functional")
    assert np.max(np.abs(bits.q - functional.q)) < 50 * URAD
    assert summarise(ran("paper-joint", "bus.fidelity=functional"), functional, 0.0)["bus_load"] is None


def test_the_bus_is_as_full_as_the_budget_says() -> None:
    """At most 830 + 135 bits of 1000 a cycle by the worst case, at least without a stuff bit: 8 + 3 x 79 + ..."""
    load = summarise(ran("paper-joint"), evaluated("paper-joint"), 0.0)["bus_load"]
    unstuffed = 55 + 3 * 79 + 3 * 95 + 2 * 111 - 11 * 0
    assert unstuffed / 1000 <= load <= 0.965


def test_the_deviation_starts_with_the_fall_before_the_first_current() -> None:
    """Gravity acts before the observer knows of it: the largest deviation of a good run is in its first 100 ms."""
    assert np.all(np.argmax(np.abs(evaluated("paper-joint").deviation), axis=0) < 100)
