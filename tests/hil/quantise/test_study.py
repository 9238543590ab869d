"""What is found of whole scenarios: the figures that must be shown, in JSON and in 80 columns; and what cannot be."""

import json
from io import StringIO
from math import isfinite

import numpy as np
import pytest
from rich.console import Console

from hil import scenario_file
from hil.quantise import show
from hil.quantise.study import rounded_trace, study
from hil.rig import run_inline

SHORT = ("duration_s=0.2", "trajectory.time_s=0.15", "trajectory.by_rad=[0.05, -0.05, 0.05]")
EXACT = {"count", "w", "dw", "a_ref"}
"""Both hear the same counts and references, and differences of counts are whole."""


@pytest.fixture(scope="module")
def paper():
    """paper-joint, whole."""
    return study(scenario_file.load("paper-joint"))


def rows_of(found, name):
    return [row for row in found["signals"] if row["name"] == name]


def test_every_word_of_paper_joint_has_a_bit_of_head_room_and_nothing_saturates(paper):
    """But the wrapping counter; the constants must fit and no more."""
    signals = [row for row in paper.found["signals"] if row["name"] != "count"]
    assert len(signals) == 3 * 14
    assert [
        (row["name"], row["joint"]) for row in signals if row["headroom_bits"] < (0 if row["constant"] else 1)
    ] == []
    assert sum(row["saturations"] for row in paper.found["signals"]) == 0
    assert {row["name"] for row in paper.found["signals"] if row["wraps"]} == {"count", "w"}


@pytest.mark.parametrize(
    ("name", "ranges"),
    [
        ("w", (123, 123, 123)),
        ("KB*dw", (2956, 1968, 914)),
        ("d", (5240, 1987, 1586)),
        ("a_ref", (450, 478, 496)),
        ("i", (5419, 2088, 1678)),
        ("i-d", (968, 684, 330)),
    ],
)
def test_ranges_are_those_of_the_architectures_table(paper, name, ranges):
    found = [int(max(abs(row["min"]), abs(row["max"]))) for row in rows_of(paper.found, name)]
    assert found == list(ranges)


def test_every_signal_has_its_ratio_or_no_error_at_all(paper):
    """25 dB: joint 3's d, which adds up what KB's rounding costs (0.1 % of KB w); what is rounded once has 55."""
    for row in paper.found["signals"]:
        if row["name"] in EXACT:
            assert (row["sqnr_db"], row["largest_error"]) == (None, 0.0)
        else:
            assert isfinite(row["sqnr_db"])
            assert row["sqnr_db"] > (25 if row["name"] in ("d", "estimate", "i") else 55)


def test_one_rounding_is_wrong_by_half_a_count_at_most(paper):
    """KJ*a_ref: half a count, and 450 counts of a constant rounded to 16 bits, 450 x 2^-15; AccelRef: half a count."""
    assert all(0.4 < row["largest_error"] < 0.52 for row in rows_of(paper.found, "KJ*a_ref"))
    assert all(0.4 < row["largest_error"] <= 0.5 for row in rows_of(paper.found, "AccelRef"))


def test_sixteen_bits_add_less_than_a_tenth_to_the_largest_deviation(paper):
    """The robot in float64 has the same encoders, and the same counts of current."""
    compared = paper.found["closed_loop"]
    assert compared["fault"] is None
    assert [row["joint"] for row in compared["joints"]] == [1, 2, 3]
    for row in compared["joints"]:
        assert row["penalty"] <= 0.10
        assert row["penalty"] == pytest.approx(row["max_deviation_rad"] / row["max_deviation_float_rad"] - 1)
        # another robot: not the same run again; three encoder counts of 7.67 urad at the most
        assert 0.0 < row["largest_difference_rad"] < 3 * 7.67e-6
        assert 0.4 < row["largest_output_rounding"] <= 0.5


def test_the_run_that_is_measured_is_the_run_itself():
    scenario = scenario_file.load("paper-joint", SHORT)
    assert study(scenario).found["frame_log_sha256"] == run_inline(scenario).log.sha256()


def test_the_json_has_what_was_asked_for(paper):
    again = json.loads(json.dumps(paper.found, allow_nan=False))
    assert again["scenario"] == "paper-joint"
    wanted = {"name", "joint", "q_format", "min", "max", "headroom_bits", "saturations", "wraps", "underflows"}
    wanted |= {"first_saturation_s", "sqnr_db", "largest_error", "unit", "histogram"}
    for row in again["signals"]:
        assert wanted <= row.keys()
    d = rows_of(again, "d")[0]
    assert sum(d["histogram"]) == 2 * 1500  # behind the speed's term, and behind the current's
    assert all(sum(row["histogram"]) == 1500 for row in rows_of(again, "i"))


def shown(found):
    text = StringIO()
    show.show(Console(file=text, width=80, markup=False, highlight=False), found)
    return text.getvalue()


def test_a_table_leaves_eighty_columns_to_its_numbers(paper):
    lines = shown(paper.found).splitlines()
    assert all(len(line) <= 80 and "…" not in line for line in lines)
    assert sum(line.split()[:1] == ["KB*dw"] for line in lines) == 3
    row = next(line.split() for line in lines if line.split()[:1] == ["KB*dw"])
    assert row[:5] == ["KB*dw", "Q15.0", "-2956", "2956", "3/0"]
    assert any(line.startswith("joint 1: count wrapped 2 x, first at 0.00114") for line in lines)


@pytest.mark.parametrize(
    ("error", "cell"), [(0.0, "0"), (1.2e-05, "1e-05"), (0.3896, "0.39"), (33.7, "34"), (41_234.5, "41234")]
)
def test_an_error_keeps_to_seven_characters(paper, error, cell):
    one = rows_of(paper.found, "KB*dw")[0] | {"largest_error": error}
    line = next(line for line in shown({"signals": [one], "closed_loop": None}).splitlines() if "KB*dw" in line)
    assert line.split()[-1] == cell


def test_a_robot_in_float64_that_stops_itself_is_said(paper):
    found = paper.found | {"closed_loop": {"fault": {"cause": "current lost"}, "joints": []}}
    assert "in float64 the run stops itself: current lost" in shown(found)


@pytest.mark.parametrize(
    "settings",
    [
        ["bus.fidelity=functional"],
        ["joint.observer=false"],
        ["joint1.crystal_ppm=100"],
        ["wire.faults=[{kind='cut off', node='joint3', from_s=0.0502, to_s=0.0509}]"],
    ],
    ids=["functional", "no observer", "free-running", "a frame is lost"],
)
def test_other_runs_have_their_figures_too(settings):
    found = study(scenario_file.load("paper-joint", [*SHORT, *settings]))
    assert found.faults == []
    assert len(found.found["signals"]) == 3 * 15
    assert all(row["penalty"] is not None for row in found.found["closed_loop"]["joints"])
    assert shown(found.found)


def test_without_an_observer_d_is_nothing_and_has_no_error():
    found = study(scenario_file.load("paper-joint", [*SHORT, "joint.observer=false"])).found
    for row in rows_of(found, "d"):
        assert (row["min"], row["max"], row["sqnr_db"], row["largest_error"]) == (0, 0, None, 0)
    assert all(row["largest_error"] == 0 for row in rows_of(found, "KA") + rows_of(found, "KB"))


def test_a_current_at_its_limit_is_counted_as_the_run_counts_it():
    """0.05 A: joint 1 cannot hold itself against gravity, so it saturates for most of the run."""
    scenario = scenario_file.load("paper-joint", [*SHORT, "joint.limit_A=0.05"])
    found = study(scenario).found
    report = run_inline(scenario).reports
    for row in rows_of(found, "i"):
        assert row["saturations"] == report[f"joint{row['joint']}"]["saturations"]["i"]
    first = rows_of(found, "i")[0]
    assert first["saturations"] > 50
    assert 0.0 < first["first_saturation_s"] < 0.05
    assert f"first at {first['first_saturation_s']:.6f} s" in shown(found)


def test_a_reference_that_was_limited_is_a_saturation_and_one_that_vanished_an_underflow():
    trace = rounded_trace(np.array([1.4, 40_000.0, 0.3, 0.0, -0.5]), np.array([1.0, 32_767.0, 0.0, 0.0, 0.0]))
    assert trace.raw.tolist() == [1, 32767, 0, 0, 0]
    assert trace.became.tolist() == [0, 1, 3, 0, 3]


CUT = "wire.faults=[{kind='cut off', node='joint1', from_s=0.1}]"


def test_a_run_that_stops_itself_shows_what_it_was_and_says_so(hil, short_settings):
    run = hil.run("quantise", "paper-joint", *short_settings, "--set", CUT, "--json")
    assert run.returncode == 6
    assert "the run stopped at 0.1" in run.stderr
    found = json.loads(run.stdout)
    assert found["closed_loop"] is None
    assert 90 < sum(rows_of(found, "i")[0]["histogram"]) < 110


def test_the_command_writes_its_folder_whole(hil, short_settings):
    run = hil.run("quantise", "paper-joint", *short_settings, "--out", "found", "--json")
    assert (run.returncode, run.stderr) == (0, "")
    folder = hil.folder / "found"
    assert json.loads((folder / "quantisation.json").read_text()) == json.loads(run.stdout)
    assert scenario_file.load(str(folder / "scenario.toml")).duration_s == 0.2
    again = hil.run("quantise", "paper-joint", *short_settings, "--out", "found")
    assert again.returncode == 7
    assert "found" in again.stderr


def test_a_law_of_ones_own_ends_with_the_reason(hil, short_settings):
    run = hil.run("quantise", *short_settings, "--set", "joint2.cpu=hil.paper.table1:CountedJoint")
    assert run.returncode == 3
    assert run.stderr.startswith("hil: joint2.cpu = 'hil.paper.table1:CountedJoint': its control law is its own")
    assert run.stdout == ""


def test_joints_of_machine_code_have_no_other_formats_to_try(hil, short_settings):
    """They would have computed on in their own, and no proposal would have been proved."""
    run = hil.run("quantise", *short_settings, "--set", "joint2.cpu=i8086")
    assert (run.returncode, run.stdout) == (3, "")
    assert run.stderr.startswith("hil: joint2: cpu = 'i8086': its machine code is of the default formats")


def test_no_signal_of_a_run_leaves_its_derived_range(paper):
    rows = [row for row in paper.found["signals"] if "derived_min" in row]
    assert {row["name"] for row in rows} >= {"w", "dw", "KB*dw", "i", "d"}
    for row in rows:
        assert row["derived_min"] <= row["min"] <= row["max"] <= row["derived_max"], (row["joint"], row["name"])
        assert row["derived_headroom_bits"] <= row["headroom_bits"]
