"""Arms at rest: what is run, what is measured of it, and that the dead band is where it is predicted."""

import json
from dataclasses import replace
from io import StringIO
from itertools import pairwise
from math import pi

import numpy as np
import pytest
from rich.console import Console

from dbc.compiler import load_arm
from hil import scenario_file
from hil.engine.functional_run import FunctionalRun, inline
from hil.errors import ScenarioError
from hil.quantise import rest_cases
from hil.quantise.rest import Timed, experiment, lines, rest, row_of
from hil.quantise.rest_figure import write_rest
from hil.quantise.rest_show import show_rest, summary
from hil.scenario_file import check
from hil.word_format import WordFormat, with_word

CODEC = load_arm()
FINE = ("encoder.counts_per_turn=67108864", "joint.word.kb_fraction=6")


def run_inline(scenario):
    return inline(scenario), ""


# -- the dead band, as the rig runs --


@pytest.mark.parametrize(
    ("name", "settings", "dominant"),
    [
        ("paper-joint", (), ("encoder",) * 3),
        ("one-joint", (*FINE,), ("reference",)),
        ("one-joint", (*FINE[:1], "joint.word.kb_fraction=9", "joint.word.current_fraction=8"), ("current",)),
        ("one-joint", ("joint.g_rad_s=20", "joint.word.d_fraction=0"), ("d",)),
        ("one-joint", ("joint.g_rad_s=20", "joint.word.d_fraction=2"), ("d",)),
    ],
)
def test_arms_rest_within_a_factor_of_2_of_their_dead_band(name, settings, dominant):
    found = rest(scenario_file.load(name, settings), run_inline)
    assert tuple(each.predicted.dominant for each in found) == dominant
    for each in found:
        assert 0.5 <= each.ratio <= 2.0
        assert each.amplitude <= each.measured


def test_a_floor_of_d_shows_on_one_side_of_the_command():
    """g = 20, no bits of d: 90 urad, all of it below the command but for one encoder count above it."""
    (found,) = rest(scenario_file.load("one-joint", ("joint.g_rad_s=20", "joint.word.d_fraction=0")), run_inline)
    down, up = found.edges
    assert found.predicted.low < -10 * found.predicted.high
    assert down < up < found.predicted.high
    assert up - down > 0.5 * found.predicted.width


# -- what is run --


def test_the_experiment_is_a_scenario_with_nothing_but_the_arm_and_a_slow_torque():
    scenario = scenario_file.load("grasp", ())
    timed = Timed.of(scenario, settles=10)
    at_rest = experiment(scenario, [band_of(0.0)] * 3, timed, CODEC)
    check(at_rest)
    assert not at_rest.has_world
    assert at_rest.arm.coulomb_N_m == (0.0, 0.0, 0.0)
    assert at_rest.arm.viscosity_N_m_s == scenario.arm.viscosity_N_m_s
    assert at_rest.trajectory.by_rad == (0.0, 0.0, 0.0)
    assert [torque.joint for torque in at_rest.torque] == [1, 2, 3]
    assert at_rest.load == at_rest.grasp == at_rest.wall == ()


def test_joints_by_their_own_timers_sample_on_their_frames():
    scenario = scenario_file.load("drift", ())
    at_rest = experiment(scenario, [band_of(0.0)] * 3, Timed.of(scenario, settles=10), CODEC)
    assert [at_rest.crystal_ppb(joint) for joint in (1, 2, 3)] == [None] * 3


def test_a_torque_comes_to_half_its_peak_before_an_edge_is_looked_at():
    """Down: from half the least torque to the least; up: from half the largest on; nothing pushes while alone."""
    scenario = scenario_file.load("one-joint", ())
    timed = Timed.of(scenario, settles=10)
    (torque,) = experiment(scenario, [band_of(8e-6)], timed, CODEC).torque
    at_s = np.arange(timed.cycles) * scenario.clock.period_s
    share = np.where(at_s < torque.at_s, 0.0, np.sin(torque.frequency_rad_s * (at_s - torque.at_s)))
    assert np.all(share[timed.alone] == 0.0)
    assert np.max(share[timed.down]) == pytest.approx(-0.5, abs=0.01)
    assert np.min(share[timed.down]) == pytest.approx(-1.0, abs=1e-4)
    assert np.min(share[timed.up]) == pytest.approx(0.5, abs=0.01)
    assert np.max(share[timed.up]) == pytest.approx(1.0, abs=1e-4)
    spring_N_m = 700.0 * 90.0 * 1.29
    wanted_N_m = 2 * spring_N_m * (8e-6 - 2 * pi / 819200) + 4 * 10.0 / 2048
    assert torque.amplitude_N_m == pytest.approx(wanted_N_m)


def test_no_torque_is_more_than_half_of_what_the_drive_has():
    scenario = scenario_file.load("one-joint", ())
    (torque,) = experiment(scenario, [band_of(1.0)], Timed.of(scenario, settles=10), CODEC).torque
    assert torque.amplitude_N_m == 0.5 * 8.0 * 10.0


def band_of(width):
    from hil.quantise.dead_band import DeadBand

    return DeadBand(alone={"encoder": width}, low=0.0, high=width, cycle=0.0)


# -- what is measured --


def test_lines_have_the_amplitude_and_the_frequency_of_a_sine():
    """On a bin of the window: 40 periods of 1000 samples; a Hann window leaves the amplitude of such a line."""
    t_s = np.arange(1000) * 1e-3
    frequencies, spectrum = lines(5.0 + 3e-6 * np.sin(2 * pi * 40.0 * t_s), 1e-3)
    strongest = np.argmax(spectrum)
    assert frequencies[strongest] == pytest.approx(40.0)
    assert spectrum[strongest] == pytest.approx(3e-6, rel=0.005)
    assert frequencies[-1] == pytest.approx(500.0)


def synthetic(scenario, deviation):
    """A run of one joint whose angle is the command and deviation(t)."""
    at_s = np.arange(scenario.cycles) * scenario.clock.period_s
    q = (scenario.start_rad[0] + deviation(at_s))[:, None]
    none = np.zeros_like(q, dtype=np.int64)
    return FunctionalRun(q, none, none, none, none, none, none), "no reason"


def test_amplitude_mean_range_and_period_are_those_of_the_motion():
    scenario = scenario_file.load("one-joint", ())
    timed = Timed.of(scenario, settles=10)

    def moved(at_s):
        k = np.arange(len(at_s))
        cycle = 2e-6 * np.sin(2 * pi * at_s / 0.01) + 1e-6
        return np.where(k < timed.pushed, cycle, np.where(k < timed.down.stop, -7e-6, 9e-6))

    (found,) = rest(scenario, lambda at_rest: synthetic(at_rest, moved))
    row = row_of(found, CODEC)
    assert row["amplitude_rad"] == pytest.approx(4e-6, rel=0.1)  # 10 samples a period miss the peaks by 5 %
    assert row["mean_rad"] == pytest.approx(1e-6, rel=0.01)
    assert row["measured_rad"] == pytest.approx(16e-6)
    assert row["pushed_rad"] == pytest.approx([-7e-6, 9e-6])
    assert row["period_s"] == pytest.approx(0.01, rel=0.02)
    assert row["ratio"] == pytest.approx(16e-6 / row["predicted"]["range_rad"])
    assert all(one[1] >= other[1] for one, other in pairwise(row["spectrum"]))
    assert found.slow == "no reason"
    json.dumps(row, allow_nan=False)


def test_what_does_not_move_has_no_period():
    (found,) = rest(scenario_file.load("one-joint", ()), lambda scenario: synthetic(scenario, np.zeros_like))
    assert (found.amplitude, found.period_s) == (0.0, None)


def test_what_has_not_settled_is_given_more_time():
    lengths = []

    def slowly(scenario):
        lengths.append(scenario.cycles)
        return synthetic(scenario, lambda at_s: 1e-2 * np.exp(-at_s / 0.15) * np.cos(2 * pi * at_s / 0.1))

    (found,) = rest(scenario_file.load("one-joint", ()), slowly)
    assert len(lengths) > 1
    assert lengths == sorted(lengths)
    assert found.amplitude < found.predicted.range
    with pytest.raises(ScenarioError, match="has not settled after 7200 periods"):
        rest(scenario_file.load("one-joint", ()), lambda scenario: synthetic(scenario, lambda t: 1e-3 * (20.0 - t)))


def test_a_run_that_stops_itself_and_a_loop_that_is_too_slow_are_refused():
    scenario = scenario_file.load("one-joint", ())

    def stopped(at_rest):
        ran, slow = synthetic(at_rest, np.zeros_like)
        return replace(ran, stopped="dsp: singular point"), slow

    with pytest.raises(ScenarioError, match="stops itself: dsp: singular point"):
        rest(scenario, stopped)
    with pytest.raises(ScenarioError, match=r"dsp.k2_1_s2 = 0.1: .* 600 s is the most"):
        Timed.of(scenario_file.load("one-joint", ("dsp.k2_1_s2=0.1",)), settles=10)


# -- the cases --


def test_the_cases_are_the_scenario_every_bit_of_d_and_coarser_counts():
    scenario = scenario_file.load("paper-joint", ())
    every = list(rest_cases.cases(scenario, CODEC))
    assert every[0] == (rest_cases.AS_IT_IS, False, scenario)
    for fine in (False, True):
        bits = [
            each.scenario.joint.word.d_fraction for each in every if (each.swept, each.fine) == ("d_fraction", fine)
        ]
        assert bits == list(range(17))
    word = [each.scenario.joint.word for each in every]
    assert [each.current_fraction for each in word[-6:-3]] == [9, 7, 5]
    assert [each.acceleration_fraction for each in word[-3:]] == [5, 3, 1]
    assert {each.scenario.encoder.counts_per_turn for each in every if each.fine} == {2**26}
    for each in every:
        check(each.scenario)


def test_kb_keeps_as_many_bits_as_its_word_has_room_for():
    """KB of joint 1 is 1478 counts at 819 200 a turn: 18.04 at 2^26, and 2^10 times that is the most below 2^15."""
    scenario = scenario_file.load("paper-joint", ())
    finer = rest_cases.with_encoder(scenario, 2**26)
    assert WordFormat.of(finer, CODEC).kb_fraction == 10


def test_a_case_that_cannot_be_is_named_and_the_rest_is_shown(monkeypatch, tmp_path):
    scenario = scenario_file.load("one-joint", ())
    coarse = with_word(scenario, current_fraction=-10)
    bits = [rest_cases.Case("d_fraction", fine, with_word(scenario, d_fraction=3)) for fine in (False, True)]
    every = [
        rest_cases.Case(rest_cases.AS_IT_IS, False, scenario),
        *bits,
        rest_cases.Case("current_fraction", 1, coarse),
    ]
    monkeypatch.setattr(rest_cases, "cases", lambda _scenario, _codec: every)
    monkeypatch.setattr(
        rest_cases, "rest", lambda each: rest(each, lambda ran: synthetic(ran, lambda t: 1e-6 * np.sin(t)))
    )
    shares = []
    found = rest_cases.study(scenario, shares.append)
    assert shares == [0.25, 0.5, 0.75]
    values = rest_cases.to_json(found)
    assert [(row["swept"], row["finer_encoder"], row["d_fraction"]) for row in values["rest"]] == [
        ("as it is", False, 16),
        ("d_fraction", False, 3),
        ("d_fraction", True, 3),
    ]
    (refused,) = values["rest_refused"]
    assert "joint1" in refused["cause"]
    console = Console(file=StringIO(), width=80, markup=False, highlight=False)
    show_rest(console, values)
    text = console.file.getvalue()
    assert max(map(len, text.splitlines()[:-3])) <= 80
    assert "joint 1: dominated by the encoder" in text
    assert "not fast: no reason" in text
    assert "not at rest: current_fraction: joint1" in text
    png, svg = write_rest(tmp_path, found)
    assert png.read_bytes().startswith(b"\x89PNG")
    assert "dominated by the encoder" in svg.read_text()


def test_the_summary_says_up_to_which_bits_of_d_its_resolution_dominates():
    def row(swept, bits, dominant, ratio):
        fine = swept != rest_cases.AS_IT_IS
        return {
            "joint": 1,
            "swept": swept,
            "finer_encoder": fine,
            "d_fraction": bits,
            "dominant": dominant,
            "ratio": ratio,
        }

    bits_of_d = [row("d_fraction", bits, "d" if bits < 3 else "current", 1.0 + bits / 10) for bits in range(5)]
    assert list(summary([row(rest_cases.AS_IT_IS, 16, "encoder", 0.8), *bits_of_d])) == [
        "joint 1: dominated by the encoder; with the finer encoder by the current, by d at 2 bits",
        "measured over predicted: 0.80 to 1.40 in 6 cases",
    ]
