"""Derived ranges: against arms and steps that do the worst that chance finds within the limits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dbc.compiler import load_arm
from firmware_py.joint_cpu import make_step
from hil import scenario_file
from hil.assemble import arm_parameters, joint_trajectory
from hil.constants import parameter_table
from hil.quantise.derived import SPEED_ROOM, Interval, derived, physical_limits
from hil.quantise.signals import TracedWords, step_signals
from hil.word_format import WordFormat, words_of
from plant.rigid_body import RigidBody

CODEC = load_arm()
TRIALS = 3000
numbers = st.floats(-1e6, 1e6)
intervals = st.tuples(numbers, numbers).map(lambda ends: Interval(min(ends), max(ends)))


@given(x=intervals, y=intervals, shares=st.tuples(st.floats(0, 1), st.floats(0, 1)), factor=st.floats(-100, 100))
def test_what_is_inside_stays_inside(x, y, shares, factor):
    """To the rounding of the point's own float64: 1e-9 of the largest."""
    a, b = (each.low + share * (each.high - each.low) for each, share in zip((x, y), shares, strict=True))
    for value, interval in ((a + b, x + y), (a - b, x - y), (a * factor, x * factor)):
        slack = 1e-9 * max(interval.bound, 1.0)
        assert interval.low - slack <= value <= interval.high + slack
    word = Interval(-50.0, 49.0)
    assert Interval(-60, 20).cut(word) == Interval(-50, 20)


@pytest.mark.parametrize("name", ["paper-joint", "paper-task", "two-joints", "five-joints"])
def test_no_arm_accelerates_beyond_its_limit(name):
    """By the plant's own equations, at poses of the path, random speeds, and the corners of all torques.

    A fifth of the limit is reached by somebody, or the limit would say nothing.
    """
    scenario = scenario_file.load(name)
    arm, limits, rng = arm_parameters(scenario, CODEC), physical_limits(scenario, CODEC), np.random.default_rng(5)
    body, motion, n = RigidBody(arm), joint_trajectory(scenario), scenario.joints
    commanded = np.max(np.abs([motion.at(k * 1e-3)[1] for k in range(scenario.cycles)]), axis=0)
    assert limits.speed == pytest.approx(SPEED_ROOM * commanded, rel=1e-3)
    found = np.zeros(n)
    for t_s in rng.uniform(0.0, motion.time_s, TRIALS):
        w = rng.choice([-1.0, 1.0], n) * limits.speed * rng.choice([1.0, rng.random()])
        current = rng.choice([-1.0, 1.0], n) * min(scenario.drive.limit_A, scenario.joint.limit_A)
        torque = current * np.array(arm.torque_constant_Nm_A) - np.sign(w) * np.array(arm.coulomb_Nm)
        a = body.acceleration(motion.at(t_s)[0], tuple(w), tuple(torque))
        found = np.maximum(found, np.abs(a))
    assert np.all(found <= limits.acceleration)
    assert np.all(found > 0.2 * limits.acceleration)


@pytest.mark.parametrize("settings", [[], ["joint.word.bits=12"], ["joint.word.kb_fraction=4"], ["joint.word.bits=24"]])
@pytest.mark.parametrize("joint", [1, 3])
def test_no_step_leaves_its_ranges(settings, joint):
    """Any counter within the limits, any reference, from limit to limit: each signal inside, and most get near."""
    scenario = scenario_file.load("paper-joint", settings)
    form, rng = WordFormat.of(scenario, CODEC), np.random.default_rng(joint)
    ranges = derived(scenario, joint, CODEC, physical_limits(scenario, CODEC))
    table, words = parameter_table(scenario, joint, CODEC), words_of(scenario, CODEC, TracedWords)
    step = make_step(TracedWords)
    w_prev = d = count = w = 0
    for _ in range(TRIALS):
        reach = int(ranges["dw"].bound)
        dw = int(rng.choice([-reach, reach, rng.integers(-reach, reach + 1)]))
        bound = int(min(ranges["w"].bound, (1 << form.bits - 1) - 1))
        w = int(np.clip(w + dw, max(-bound, w - reach), min(bound, w + reach)))
        count_prev, count = count, (count + w) & 0xFFFF
        a_ref = int(rng.choice([-0x8000, 0x7FFF, rng.integers(-0x8000, 0x8000)]))
        w_prev, d, _, _ = step(words, count, count_prev, w_prev, d, a_ref, *table)
    near = set()
    for signal in step_signals(form):
        if signal.name not in ranges:
            continue
        values = np.array([value for value, _ in words.kept[signal.name]]) * 0.5**signal.fraction
        slack = 0.5**signal.fraction  # the last rounding
        assert ranges[signal.name].low - slack <= values.min() <= values.max() <= ranges[signal.name].high + slack
        if max(-values.min(), values.max()) > 0.5 * ranges[signal.name].bound:
            near.add(signal.name)
    assert near >= {"w", "dw", "KB*dw", "a_ref", "KJ*a_ref", "i"}


def test_a_torque_from_outside_and_a_load_widen_the_range():
    plain = physical_limits(scenario_file.load("paper-joint"), CODEC).acceleration
    pushed = physical_limits(
        scenario_file.load("paper-joint", ["torque=[{joint=2, amplitude_N_m=30.0, until_s=1.0}]"]), CODEC
    ).acceleration
    assert np.all(pushed > plain)
    loaded = physical_limits(scenario_file.load("load-step"), CODEC).acceleration
    assert np.all(loaded >= plain)
