"""What is written down of a run, and its replay, against numpy's integers and the frames on the bus."""

import numpy as np
import pytest

from dbc.compiler import load_arm
from firmware_py.joint_cpu import SIGNALS
from firmware_py.words import Words
from hil import scenario_file
from hil.assemble import build_joint
from hil.errors import ScenarioError
from hil.evaluate import evaluate
from hil.quantise.signals import (
    AS_IT_WAS,
    SATURATED,
    UNDERFLOWED,
    WRAPPED,
    TracedWords,
    constants,
    replay,
    step_signals,
)
from hil.quantise.tap import COLUMNS, Tap
from hil.rig import run_inline
from hil.word_format import WordFormat, words_of
from tests.conftest import SHORT

I16, I32 = np.iinfo(np.int16), np.iinfo(np.int32)
ROWS = 20_000
KTN = (10.0, 6.0, 2.0)
FORM = WordFormat.of(scenario_file.load("paper-joint"), load_arm())
STEP_SIGNALS = step_signals(FORM)
KIND = {"saturate": SATURATED, "wrap": WRAPPED}


@pytest.fixture(scope="module")
def tapped():
    """A short run that somebody looks on, and who does."""
    tap = Tap()
    return run_inline(scenario_file.load("paper-joint", SHORT), seat=tap.seat), tap


def traced():
    return words_of(scenario_file.load("paper-joint"), load_arm(), TracedWords)


def random_samples():
    """Steps at random, from small to far too large for their formats; constants of any size."""
    rng = np.random.default_rng(7)
    count = rng.integers(0, 1 << 16, ROWS)
    near = rng.random(ROWS) < 0.5
    count_prev = np.where(near, (count + rng.integers(-40, 41, ROWS)) % (1 << 16), rng.integers(0, 1 << 16, ROWS))
    w_prev = np.where(near, rng.integers(-40, 41, ROWS), rng.integers(I16.min, I16.max + 1, ROWS))
    d = np.where(rng.random(ROWS) < 0.3, rng.integers(-70_000, 70_001, ROWS), rng.integers(I32.min, I32.max, ROWS))
    a_ref = np.where(rng.random(ROWS) < 0.3, rng.integers(-2, 3, ROWS), rng.integers(I16.min, I16.max + 1, ROWS))
    ka, kb, kj, limit = rng.integers(1, 1 << 15, (4, ROWS))
    shift = rng.integers(0, 16, ROWS)
    return np.stack([np.arange(ROWS), count, count_prev, w_prev, d, a_ref, ka, kb, kj, shift, limit], axis=1)


def by_numpy(samples):
    """Every signal with what it was before it got its size: (before, after, what a difference is called)."""
    _, count, count_prev, w_prev, d, a_ref, ka, kb, kj, shift, limit = samples.T
    w = (count - count_prev).astype(np.int16).astype(np.int64)
    dw = (w - w_prev).astype(np.int16).astype(np.int64)
    pull = np.clip(kb * dw, I16.min, I16.max)
    d1 = np.clip(d - (pull << 16), I32.min, I32.max)
    estimate = d1 >> 16
    feed = np.floor_divide(kj * a_ref + (1 << shift) // 2, 1 << shift)
    i = np.clip(feed + estimate, -limit, limit)
    error = np.clip(i - estimate, I16.min, I16.max)
    push = 2 * ka * error
    d2 = np.clip(d1 + push, I32.min, I32.max)
    both = np.stack([d - (pull << 16), d1 + push], axis=1).ravel(), np.stack([d1, d2], axis=1).ravel()
    return {
        "count": (count_prev + w, count, "wrap"),
        "w": (count - count_prev, w, "wrap"),
        "dw": (w - w_prev, dw, "wrap"),
        "KB*dw": (kb * dw, pull, "saturate"),
        "d": (*both, "saturate"),
        "a_ref": (a_ref, a_ref, "wrap"),
        "i": (feed + estimate, i, "saturate"),
        "i-d": (i - estimate, error, "saturate"),
        "KA*(i-d)": (push, push, "wrap"),
        "estimate": (d1, estimate, None),
        "KJ*a_ref": (kj * a_ref, feed, None),
    }


def test_every_signal_is_numpys_and_every_overflow_is_seen():
    samples = random_samples()
    traces, expected = replay(samples, traced()), by_numpy(samples)
    assert traces.keys() == expected.keys() == {signal.name for signal in STEP_SIGNALS}
    for name, (before, after, kind) in expected.items():
        assert np.array_equal(traces[name].raw, after), name
        if kind is not None:
            assert np.array_equal(traces[name].became, np.where(before != after, KIND[kind], AS_IT_WAS)), name
    assert {name for name, trace in traces.items() if np.any(trace.became)} == expected.keys() - {"a_ref", "KA*(i-d)"}


def test_an_underflow_is_less_than_a_count_of_which_nothing_is_left():
    """By fractions: of the estimate less than a count; of KJ*a_ref what the nearest count to is zero."""
    samples = random_samples()
    traces = replay(samples, traced())
    column = dict(zip(COLUMNS, samples.T.tolist(), strict=True))
    left = traces["d"].raw[::2] / 65536
    assert np.array_equal(traces["estimate"].became == UNDERFLOWED, (left != 0) & (np.abs(left) < 1))
    exact = np.array(
        [kj * a / 2**s for kj, a, s in zip(column["kj"], column["a_ref"], column["shift"], strict=True)], dtype=float
    )
    nothing = (exact != 0) & (exact >= -0.5) & (exact < 0.5)
    assert np.array_equal(traces["KJ*a_ref"].became == UNDERFLOWED, nothing)
    assert nothing.sum() > 20  # else this says nothing


def test_a_run_that_is_looked_at_is_the_same_run(tapped, short):
    outcome, _ = tapped
    plain = run_inline(short)
    assert outcome.log.frames == plain.log.frames
    assert [r for r in outcome.reports.values() if "saturations" in r] == [
        r for r in plain.reports.values() if "saturations" in r
    ]


def test_a_joint_that_nobody_looks_at_has_the_bare_words(short):
    joint = build_joint(short, 1, load_arm())
    assert type(joint.words) is Words
    assert joint.step.__qualname__ == "make_step.<locals>.step"


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_what_the_replay_finds_was_on_the_bus(tapped, joint):
    """Current frames carry i and the estimate in counts of 1/2048 A; the evaluation has the estimate in N m."""
    outcome, tap = tapped
    traces, evaluation = replay(tap.samples(joint), traced()), evaluate(outcome)
    assert np.array_equal(traces["i"].raw, np.rint(evaluation.i_ref[:, joint - 1] * 2048))
    assert np.array_equal(traces["estimate"].raw, np.rint(evaluation.estimate[:, joint - 1] / KTN[joint - 1] * 2048))
    at_ns = tap.samples(joint)[:, 0]
    assert np.array_equal(at_ns // 1_000_000, np.arange(200))  # each sample in its cycle of 1 ms


def test_the_signals_hold_what_the_firmware_names():
    assert set(SIGNALS) <= {signal.name for signal in STEP_SIGNALS}


@pytest.mark.parametrize(
    ("name", "q_format"),
    [("count", "UQ16.0"), ("w", "Q15.0"), ("d", "Q15.16"), ("KA*(i-d)", "Q15.16"), ("KJ*a_ref", "Q31.0")],
)
def test_formats_are_those_of_the_architecture(name, q_format):
    assert next(signal for signal in STEP_SIGNALS if signal.name == name).q_format == q_format


def test_constants_have_the_formats_of_the_architecture():
    assert [signal.q_format for signal in constants(FORM, shift=13)] == ["Q0.15", "Q15.0", "Q2.13"]


def test_a_law_of_somebody_elses_is_refused_by_name():
    scenario = scenario_file.load("paper-joint", [*SHORT, "joint2.cpu=hil.paper.table1:CountedJoint"])
    with pytest.raises(ScenarioError, match=r"joint2\.cpu = 'hil\.paper\.table1:CountedJoint'.*joint2\.cpu = 'python'"):
        run_inline(scenario, seat=Tap().seat)


@pytest.mark.parametrize(
    "settings",
    [
        ["joint.word.current_fraction=8", "joint.limit_A=15", "joint.g_rad_s=900", "encoder.counts_per_turn=6400"],
        ["joint.word.bits=9", "joint.word.overflow='wrap'", "joint.word.current_fraction=4"],
        ["joint.word.round_estimate='nearest'", "joint.word.acceleration_fraction=12", "dsp.k2_1_s2=20000"],
    ],
)
def test_what_the_run_counts_the_replay_finds(settings):
    """Every overflow, also those between the CPU's counts and the bus's: the run's own counters, by joint."""
    fixed = ["duration_s=0.15", "trajectory.time_s=0.1", "joint.word.kb_fraction=fit", "bus.fidelity=functional"]
    scenario, tap = scenario_file.load("paper-joint", [*fixed, *settings]), Tap()
    outcome = run_inline(scenario, compiled=False, seat=tap.seat)
    counted = 0
    for joint in (1, 2, 3):
        words = words_of(scenario, load_arm(), TracedWords)
        traces = replay(tap.samples(joint), words)
        reported = outcome.reports[f"joint{joint}"]["saturations"]
        for name, number in reported.items():
            overflowed = np.isin(traces[name].became, (SATURATED, WRAPPED))
            assert number == (0 if name in ("w", "dw") else np.sum(overflowed)), (joint, name)
        counted += sum(reported.values())
    assert counted > 0
