"""Position control against eqs. (16), (20), (21) in numpy's float64; what is stored is single precision."""

from array import array

import numpy as np
import pytest

from firmware_py.dsp.control import CommandTable, JointSpace, TaskSpace, position_control, second_order
from firmware_py.dsp.kinematics import OutOfReach, SingularPoint, tip
from firmware_py.dsp.trajectory import Circle, Quintic, Transformed

LENGTHS = (0.30, 0.25, 0.15)
START = (0.4, 0.9, -0.5)
K1, K2 = 90.0, 2000.0
T_NS = 1_000_000
T_S = 1e-3
CYCLES = 300

HALF_ULP = 2.0**-24
"""Rounding of a number between 1 and 2 in single precision: 60 nrad; angles and positions here stay below 2."""

NOISE = 4 * K1 * HALF_ULP / T_S + 4 * K2 * HALF_ULP
"""Largest effect of single precision on (16): four rounded positions behind the two velocities, two in the error."""


def quintic():
    return Quintic(START, (0.5, -0.5, 0.5), 0.25)


def circle():
    return Circle(tip(LENGTHS, START), 0.05, 0.25)


def measured(seed, q0=START):
    """Angles near a moving pose, one row a cycle, as single precision holds them."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(0.0, 3e-4, (CYCLES, 3)), axis=0)
    return (np.array(q0) + walk).astype(np.float32).astype(float)


def commands(motion):
    """Position, mean velocity over the period before, acceleration, by cycle; the start before cycle 0."""
    rows = [motion.at(k * T_S) for k in range(CYCLES)]
    position = np.array([p for p, _, _ in rows])
    velocity = np.diff(position, axis=0, prepend=position[:1]) / T_S
    return position, velocity, np.array([a for _, _, a in rows])


def reference_law(motion, position, velocity):
    x_cmd, v_cmd, a_cmd = commands(motion)
    return a_cmd + K1 * (v_cmd - velocity) + K2 * (x_cmd - position)


def mean_velocity(position, start):
    return np.diff(position, axis=0, prepend=[start]) / T_S


def tip_terms(q, w):
    """Jacobian and Jac' w by their textbook formulas."""
    theta, rate = np.cumsum(q), np.cumsum(w)
    jacobian = np.ones((3, 3))
    bias = np.zeros(3)
    for k in range(3):
        jacobian[0, k] = -np.sum(np.array(LENGTHS[k:]) * np.sin(theta[k:]))
        jacobian[1, k] = np.sum(np.array(LENGTHS[k:]) * np.cos(theta[k:]))
        bias[:2] -= LENGTHS[k] * rate[k] ** 2 * np.array([np.cos(theta[k]), np.sin(theta[k])])
    return jacobian, bias


# -- the law --


def test_second_order_is_eq_16():
    rng = np.random.default_rng(16)
    x_cmd, v_cmd, a_cmd, x, v = rng.normal(size=(5, 3))
    expected = a_cmd + 7.0 * (v_cmd - v) + 11.0 * (x_cmd - x)
    assert second_order((x_cmd, v_cmd, a_cmd), x, v, 7.0, 11.0) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_joint_space_is_eq_16(seed):
    q = measured(seed)
    control = position_control("joint", quintic(), False, START, LENGTHS, (K1, K2), CYCLES, T_NS)
    expected = reference_law(quintic(), q, mean_velocity(q, START))
    for cycle in range(CYCLES):
        assert control.step(cycle, tuple(q[cycle])) == pytest.approx(expected[cycle], abs=NOISE)


@pytest.mark.parametrize("seed", [4, 5])
def test_joint_space_follows_a_task_space_path_through_inverse_kinematics(seed):
    q = measured(seed)
    control = position_control("joint", circle(), True, START, LENGTHS, (K1, K2), CYCLES, T_NS)
    assert isinstance(control, JointSpace)
    expected = reference_law(Transformed(circle(), LENGTHS, START), q, mean_velocity(q, START))
    for cycle in range(CYCLES):
        assert control.step(cycle, tuple(q[cycle])) == pytest.approx(expected[cycle], abs=NOISE)


@pytest.mark.parametrize("seed", [6, 7, 8])
def test_task_space_is_eqs_20_and_21(seed):
    q = measured(seed)
    control = position_control("task", circle(), True, START, LENGTHS, (K1, K2), CYCLES, T_NS)
    assert isinstance(control, TaskSpace)
    x = np.array([tip(LENGTHS, row) for row in q])
    x_ref = reference_law(circle(), x, mean_velocity(x, tip(LENGTHS, START)))
    w = mean_velocity(q, START)
    for cycle in range(CYCLES):
        jacobian, bias = tip_terms(q[cycle], w[cycle])
        expected = np.linalg.solve(jacobian, x_ref[cycle] - bias)
        gain = np.abs(np.linalg.inv(jacobian)).sum(axis=1).max()
        assert control.step(cycle, tuple(q[cycle])) == pytest.approx(expected, abs=gain * NOISE)


@pytest.mark.parametrize(("space", "motion"), [("joint", quintic), ("joint", circle), ("task", circle)])
def test_at_rest_in_the_start_pose_nothing_is_asked_for_in_cycle_0(space, motion):
    """What is left is the start itself, rounded: 60 nrad times K2 and K1 / T, through the inverse Jacobian."""
    control = position_control(space, motion(), motion is circle, START, LENGTHS, (K1, K2), CYCLES, T_NS)
    assert control.step(0, START) == pytest.approx((0.0, 0.0, 0.0), abs=20 * NOISE)
    rounded = tuple(array("f", START))
    if motion is quintic:
        again = position_control(space, motion(), False, START, LENGTHS, (K1, K2), CYCLES, T_NS)
        assert list(again.step(0, rounded)) == [0.0, 0.0, 0.0]


def test_single_precision_costs_less_than_three_counts_of_accel_ref():
    assert NOISE < 3 / 128


def test_task_space_refuses_a_singular_pose():
    control = position_control("task", circle(), True, START, LENGTHS, (K1, K2), CYCLES, T_NS)
    with pytest.raises(SingularPoint, match=r"q2 = 0\.0200 rad"):
        control.step(0, (0.4, 0.02, -0.5))


# -- the table --


@pytest.mark.parametrize("motion", [quintic, circle])
def test_command_table_holds_the_start_before_cycle_0(motion):
    table = CommandTable(motion(), CYCLES, T_NS)
    position, velocity, _ = table.at(0)
    assert list(position) == list(array("f", motion().at(0.0)[0]))
    assert velocity == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("motion", [quintic, circle])
def test_command_table_is_the_trajectory_in_single_precision(motion):
    table = CommandTable(motion(), CYCLES, T_NS)
    for cycle in range(CYCLES + 1):
        position, velocity, acceleration = table.at(cycle)
        p, _, a = motion().at(cycle * T_S)
        assert np.array(position).tolist() == np.array(p, dtype=np.float32).astype(float).tolist()
        assert np.array(acceleration).tolist() == np.array(a, dtype=np.float32).astype(float).tolist()
        before = table.at(max(0, cycle - 1))[0]
        assert velocity == [(x - y) / T_S for x, y in zip(position, before, strict=True)]


def test_what_the_controllers_keep_is_single_precision():
    control = position_control("task", circle(), True, START, LENGTHS, (K1, K2), CYCLES, T_NS)
    control.step(0, (0.4000000001, 0.9000000001, -0.5000000001))
    for kept in (*control.x_before, *control.q_before):
        assert kept == float(np.float32(kept))


def test_velocity_command_is_the_mean_over_the_last_period():
    table = CommandTable(quintic(), CYCLES, 2 * T_NS)
    _, velocity, _ = table.at(50)
    p49, p50 = (quintic().at(k * 2 * T_S)[0] for k in (49, 50))
    assert velocity == pytest.approx((np.array(p50) - p49) / (2 * T_S), abs=2 * HALF_ULP / (2 * T_S))


def test_command_table_refuses_an_unreachable_path():
    with pytest.raises(OutOfReach, match="move the path inside"):
        position_control("joint", Circle(tip(LENGTHS, START), 0.5, 0.25), True, START, LENGTHS, (K1, K2), CYCLES, T_NS)
