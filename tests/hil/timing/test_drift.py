"""Joints by their own timers on the rig: what they sampled, against a loop over the instants of the frame log."""

import json
from fractions import Fraction
from io import StringIO
from itertools import pairwise
from math import floor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from dbc.compiler import load_arm
from firmware_py.joint_cpu import JointCPU
from hil import experiment, scenario_file, show
from hil.assemble import build_nodes
from hil.errors import ScenarioError
from hil.evaluate import evaluate
from hil.frame_log import FrameLog
from hil.processes import run_processes
from hil.rig import Outcome, run_inline
from hil.scenario_file import check
from hil.summary import samples, summarise
from hil.timing.drift import Comparison, compare, describe, on_frame, show_drift, slips

CODEC = load_arm()
T_NS = 1_000_000
SLOW = ("trajectory.by_rad=[0.02, -0.02, 0.02]", "trajectory.time_s=0.25", "duration_s=0.3")
TIMERS = {
    "two crystals beside an Encoder": (
        "joint1.crystal_ppm=8000",
        "joint1.crystal_phase_s=0.0004",
        "joint2.crystal_ppm=-9000",
    ),
    "all crystals": ("joint.crystal_ppm=-4000", "joint2.crystal_ppm=5000.5", "joint3.crystal_phase_s=0.0009"),
    "100 ppm through a beat": (
        "joint1.crystal_ppm=100",
        "joint1.crystal_phase_s=0.000015",
        "joint3.crystal_ppm=-100",
        "joint3.crystal_phase_s=0.000985",
    ),
    "no error, at the Encoder's instant": ("joint.crystal_ppm=0",),
}


@pytest.fixture(scope="module", params=TIMERS)
def run(request: Any) -> Outcome:
    return run_inline(scenario_file.load("paper-joint", [*SLOW, *TIMERS[request.param]]), compiled=False)


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    return compare(scenario_file.load("drift"))


def own_timers(outcome: Outcome) -> list[int]:
    scenario = outcome.scenario
    return [n for n in range(1, scenario.joints + 1) if scenario.crystal_ppb(n) is not None]


def heard(outcome: Outcome, name: str) -> list[tuple[int, tuple[int, ...]]]:
    """Return (end in ns, fields) of every frame of this name from cycle 0 on."""
    frame = CODEC[name]
    frames = [(end_ns, frame.unpack(data)) for end_ns, each, data, _ in outcome.log.frames if each == frame.identifier]
    return [(end_ns, fields) for end_ns, fields in frames if end_ns > 0 and fields is not None]


def test_every_joint_samples_what_a_loop_over_instants_finds(run: Outcome) -> None:
    """Cycle by cycle: a tick finds the last Encoder that ended before it, one of the same instant it does not."""
    assert own_timers(run)
    for joint in own_timers(run):
        error = Fraction(str(run.scenario.of_joint(joint, "crystal_ppm"))) / 10**6
        phase_ns = round(run.scenario.of_joint(joint, "crystal_phase_s") * 1e9)
        encoders = heard(run, f"Encoder_{joint}")
        sampled, first_ns = [0], encoders[0][0]
        currents = [fields[-1] for _, fields in heard(run, f"Current_{joint}")]
        for tick in range(1, len(currents)):
            tick_ns = first_ns + phase_ns + floor(tick * T_NS / (1 + error))
            sampled.append(next(k for k in range(len(encoders) - 1, -1, -1) if encoders[k][0] < tick_ns))
        assert currents == [cycle & 0xFF for cycle in sampled]
        steps = [later - earlier for earlier, later in pairwise(sampled)]
        report = run.reports[f"joint{joint}"]
        ticks_behind_the_log = 1  # one whose Current is not sent yet when the run ends
        assert 0 <= report["doubled_samples"] - steps.count(0) <= ticks_behind_the_log
        assert 0 <= report["missed_samples"] - sum(max(step - 1, 0) for step in steps) <= ticks_behind_the_log
        slid = len(steps) - sampled[-1]
        assert abs(report["beats"] - abs(slid)) <= ticks_behind_the_log
        expected = abs(float(error)) * run.scenario.cycles
        assert abs(report["beats"] - expected) <= 1.0  # the phase decides which of the two


def test_the_frame_log_shows_what_the_joints_counted(run: Outcome) -> None:
    for joint in own_timers(run):
        found, report = slips(run, joint), run.reports[f"joint{joint}"]
        assert 0 <= report["doubled_samples"] - len(found.doubled_s) <= 1
        assert 0 <= report["missed_samples"] - len(found.missed_s) <= 1
        assert found.doubled_s == sorted(found.doubled_s)


def test_slips_are_read_off_the_cycles_that_currents_name() -> None:
    """Cycles 254 to 3 over the end of the byte: 255 twice, 1 and 2 never; what was before cycle 0 does not count."""
    said = [(-1, 254), (1, 254), (2, 255), (3, 255), (4, 0), (5, 3)]
    log = FrameLog()
    for at_ms, cycle in said:
        log.frames.append((at_ms * T_NS, 0x122, CODEC["Current_2"].pack(0, 0, cycle), "joint2"))
    log.frames.append((6 * T_NS, 0x121, CODEC["Current_1"].pack(0, 0, 3), "joint1"))
    found = slips(SimpleNamespace(log=log), 2)  # type: ignore[arg-type]
    assert found.doubled_s == pytest.approx([0.003])
    assert found.missed_s == pytest.approx([0.005, 0.005])


def test_the_plant_counts_every_current_once(run: Outcome) -> None:
    """By a set of the cycles that had theirs: the frames that ended before the plant's last wake-up."""
    last_ns = run.scenario.cycles * T_NS
    late = again = 0
    missed = {}
    for joint in (1, 2, 3):
        answered: set[int] = set()
        for end_ns, fields in heard(run, f"Current_{joint}"):
            if end_ns > last_ns:
                continue
            period = end_ns // T_NS
            cycle = period - ((period - fields[-1]) & 0xFF)
            again += cycle in answered
            late += cycle not in answered and cycle < period
            answered.add(cycle)
        missed[f"joint{joint}"] = run.scenario.cycles - len(answered)
    report = run.reports["plant"]
    assert (report["late_currents"], report["repeated_currents"]) == (late, again)
    assert report["missed_currents"] == missed


def test_processes_and_inline_make_the_same_frames_and_counts() -> None:
    scenario = scenario_file.load("paper-joint", [*SLOW, *TIMERS["all crystals"]])
    inline, processes = run_inline(scenario, compiled=False), run_processes(scenario, "arm")
    assert processes.log.frames == inline.log.frames
    assert samples(processes) == samples(inline)


def test_a_crystal_without_error_half_a_period_away_never_slips() -> None:
    settings = [*SLOW, "joint.crystal_ppm=0", "joint.crystal_phase_s=0.0005"]
    counted = samples(run_inline(scenario_file.load("paper-joint", settings), compiled=False))
    nothing = {"doubled": 0, "missed": 0, "beats": 0}
    assert counted == {"samples": dict.fromkeys(("joint1", "joint2", "joint3"), nothing)}


# -- what is made of it --


def test_the_built_in_scenario_shows_a_beat_of_each_kind_and_what_it_costs(comparison: Comparison) -> None:
    found = describe(comparison)
    fast, slow, on_encoder = found["joints"]
    assert (fast["beats"], slow["beats"], on_encoder["beats"]) == (1, 1, None)
    assert fast["doubled"] - fast["missed"] == slow["missed"] - slow["doubled"] == 1
    assert (fast["slip_periods"], slow["slip_periods"]) == (pytest.approx(0.3), pytest.approx(-0.3))
    for row in (fast, slow):
        assert row["largest_rad"] > 10 * row["largest_on_frame_rad"]
    assert on_encoder["largest_rad"] < 2 * on_encoder["largest_on_frame_rad"]
    assert found["faults"] == []
    assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_deviation_jumps_where_the_frame_log_has_the_slips(comparison: Comparison) -> None:
    """Before the first of them a joint by its own timer follows as well as one on the Encoder frame."""
    deviation, t_s = abs(comparison.own.deviation), comparison.own.t_s
    for joint, found in comparison.slips.items():
        first_s = min(found.doubled_s + found.missed_s)
        quiet = deviation[(t_s > 0.2) & (t_s < 1.0), joint - 1]
        assert t_s[deviation[:, joint - 1].argmax()] - first_s == pytest.approx(0.05, abs=0.05)
        assert deviation[:, joint - 1].max() > 30 * quiet.max()


def test_the_run_beside_is_the_one_without_crystals(comparison: Comparison) -> None:
    settings = ["joint.g_rad_s=500", "trajectory.time_s=2.5", "duration_s=3"]
    plain = run_inline(scenario_file.load("paper-joint", settings), compiled=False)
    evaluation = evaluate(plain)
    assert evaluation is not None
    assert np.array_equal(evaluation.q, comparison.on_frame.q)
    everywhere = ["joint.crystal_ppm=50", "joint.crystal_phase_s=0.0001", "joint2.crystal_phase_s=0.0002"]
    beside = on_frame(scenario_file.load("paper-joint", [*SLOW, *everywhere]))
    assert build_nodes(beside)[2].__class__ is JointCPU
    assert [beside.crystal_ppb(n) for n in (1, 2, 3)] == [None] * 3
    check(beside)


def test_a_scenario_without_crystals_is_refused() -> None:
    with pytest.raises(
        ScenarioError, match=r"paper-joint: no joint samples by a timer of its own: set joint1.crystal_"
    ):
        compare(scenario_file.load("paper-joint"))


def test_summary_and_terminal_say_what_was_sampled(comparison: Comparison, capsys: Any) -> None:
    summary = summarise(comparison.outcome, comparison.own, 0.0)
    counted = summary["samples"]
    assert counted.keys() == {"joint1", "joint2"}
    assert summary["deadline_misses_by_cause"]["plant repeated_currents"] == sum(
        each["doubled"] for each in counted.values()
    )
    show.result(experiment.Result(comparison.outcome, comparison.own, summary, None), None)
    doubled, missed = counted["joint1"]["doubled"], counted["joint1"]["missed"]
    said = f"samples of joint1, by its own timer: doubled {doubled}, missed {missed}, beats 1"
    assert said in capsys.readouterr().out


def test_the_table_shows_both_runs(comparison: Comparison) -> None:
    out = StringIO()
    console = Console(width=80, file=out)
    found = describe(comparison)
    show_drift(console, found)
    text = out.getvalue()
    for row in found["joints"]:
        assert f"{row['largest_rad'] * 1e6:.1f} ({row['largest_on_frame_rad'] * 1e6:.1f})" in text
    assert "+100" in text
    assert "plant late_currents" in text


def test_the_figure_marks_the_slips(comparison: Comparison, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from hil.timing.drift_figure import write_drift

    png, svg = write_drift(tmp_path, comparison)
    assert png.read_bytes().startswith(b"\x89PNG")
    text = svg.read_text()
    for joint, found in comparison.slips.items():
        assert f"joint {joint}, crystal " in text
        assert f"{len(found.doubled_s)} samples doubled, {len(found.missed_s)} missed" in text
    assert "joint 3, on the Encoder frame in both runs" in text
