"""A row against the run's own evaluation and summary, on the bus and off it; what is refused, and what stops."""

from dataclasses import replace

import numpy as np
import pytest

from dbc.compiler import load_arm
from firmware_py.joint_cpu import SIGNALS
from hil import evaluate as module
from hil import scenario_file
from hil.engine import functional_run
from hil.errors import NodeError
from hil.evaluate import evaluate
from hil.rig import run_inline
from hil.summary import deviations, summarise
from hil.sweep import row as rows
from hil.sweep.paths import Base

SHORT = {
    "duration_s": 0.15,
    "clock": {"setup_cycles": 60},
    "trajectory": {"kind": "quintic", "by_rad": [0.02, -0.01, 0.02], "time_s": 0.04},
}


def base_of(fidelity, **values):
    plain = scenario_file.parse(scenario_file.read("paper-joint"), "paper-joint")
    return Base.of(plain | SHORT | values | {"bus": {"fidelity": fidelity}})


@pytest.mark.parametrize("fidelity", ["functional", "bits"])
def test_the_figures_are_those_of_the_run(fidelity):
    """To rounding, 1e-12: the same true angles; the current from the frames as the figures draw it."""
    base = base_of(fidelity)
    outcome = run_inline(base.scenario({"drive.limit_A": 0.8}), compiled=False)
    evaluation = evaluate(outcome)
    expected, summary = deviations(evaluation), summarise(outcome, evaluation, 0.0)
    found = rows.row(base, {"drive.limit_A": 0.8})
    assert (found["status"], found["reason"]) == ("ok", "")
    rest = evaluation.deviation[-100:]
    for n in (1, 2, 3):
        assert found[f"max_deviation_rad_{n}"] == pytest.approx(expected["max_deviation_rad"][n - 1], rel=1e-12)
        assert found[f"final_deviation_rad_{n}"] == pytest.approx(expected["final_deviation_rad"][n - 1], rel=1e-12)
        assert found[f"swing_rad_{n}"] == pytest.approx(max(rest[:, n - 1]) - min(rest[:, n - 1]), rel=1e-12)
        assert found[f"current_noise_A_{n}"] == pytest.approx(np.std(evaluation.i_ref[-100:, n - 1]), rel=1e-9)
    tip = max(np.linalg.norm(evaluation.x_cmd - evaluation.x, axis=1))
    assert found["max_tip_deviation_m"] == pytest.approx(tip, rel=1e-12)
    counted = summary["saturations_by_signal"]
    assert found["saturations_amplifiers"] == sum(n for name, n in counted.items() if name.startswith("plant")) > 0


def test_saturations_are_counted_by_signal_over_all_joints():
    """Half an ampere is far too little: the joints' own limit."""
    base = base_of("functional")
    point = {"joint.limit_A": 0.5}
    outcome = run_inline(base.scenario(point), compiled=False)
    found = rows.row(base, point)
    for name in SIGNALS:
        expected = sum(outcome.reports[f"joint{n}"]["saturations"].get(name, 0) for n in (1, 2, 3))
        assert found[f"saturations_{name}"] == expected
    assert found["saturations_i"] > 0


def test_a_coarse_encoder_makes_more_noise_in_the_current():
    """KB times the difference of counts: the paper's own trade."""
    noise = [
        rows.row(base_of("functional"), {"encoder.counts_per_turn": counts})["current_noise_A_1"]
        for counts in (819_200, 81_920)
    ]
    assert noise[1] > 3 * noise[0]
    assert noise[0] >= load_arm().scale("Current_1", "Reference") / 10


def test_a_refused_point_has_its_reason_and_no_figures():
    found = rows.row(base_of("functional"), {"joint.g_rad_s": 1200.0})
    assert found.keys() == {"status", "reason"}
    assert found["status"] == "refused"
    assert "g_rad_s" in found["reason"]


def test_a_run_that_stops_itself_has_its_reason_and_what_there_was_of_it(monkeypatch):
    base = base_of("functional")
    whole = functional_run.inline(base.scenario({}))
    cut = {name: getattr(whole, name)[:30] for name in ("q", "a_ref", "current", "estimate")}
    monkeypatch.setattr(rows, "run", lambda _: replace(whole, **cut, stopped="joint1: three strikes"))
    found = rows.row(base, {})
    assert (found["status"], found["reason"]) == ("stopped", "joint1: three strikes")
    assert found["max_deviation_rad_1"] == rows.figures(base.scenario({}), replace(whole, **cut))["max_deviation_rad_1"]
    assert found["final_deviation_rad_1"] != rows.figures(base.scenario({}), whole)["final_deviation_rad_1"]
    nothing = {name: values[:0] for name, values in cut.items()}
    monkeypatch.setattr(rows, "run", lambda _: replace(whole, **nothing, stopped="dsp: set-up failed"))
    assert "max_deviation_rad_1" not in rows.row(base, {})


def test_a_node_that_fails_stops_the_run_and_not_the_sweep(monkeypatch):
    """Without the line in our source, which depends on where it is installed."""

    def fail(_scenario):
        raise NodeError("plant failed in /somewhere/plant.py, line 3") from OverflowError("math range error")

    monkeypatch.setattr(rows, "run", fail)
    assert rows.row(base_of("functional"), {}) == {"status": "stopped", "reason": "OverflowError: math range error"}


def test_the_motion_is_computed_once_for_all_runs_of_it():
    module._motions.cache_clear()
    base = base_of("functional")
    for counts in (819_200, 409_600):
        rows.row(base, {"encoder.counts_per_turn": counts})
    assert module._motions.cache_info().hits == 1
    rows.row(base, {"trajectory.time_s": 0.05})
    assert module._motions.cache_info().misses == 2
