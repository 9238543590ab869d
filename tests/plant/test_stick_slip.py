"""Sliding, standing and the changes between them, against closed forms and the equation of motion."""

from dataclasses import replace
from math import exp, log
from random import Random

import numpy as np
import pytest

from plant.drive import Amplifiers
from plant.parameters import DEFAULT_ARM
from plant.rigid_body import RigidBody
from plant.robot import Robot
from plant.stick_slip import StickSlip

S, MS, US = 1_000_000_000, 1_000_000, 1_000
J = 0.5 + 1 / 3  # of the fixture one_joint
C = 1.5


@pytest.mark.parametrize("torque_Nm", [2.0, 7.3, -4.0])
@pytest.mark.parametrize("step_ns", [MS, 333 * US])
def test_stop_angle_is_that_of_the_closed_form(one_joint, torque_Nm, step_ns):
    on_ns, off_ns = 462_123, 77_777_777
    robot = Robot(one_joint(), (0.0,), max_step_ns=step_ns)
    robot.set_external_torque(1, torque_Nm, on_ns)
    robot.set_external_torque(1, 0.0, off_ns)
    robot.advance_to(2 * S)
    span_s = (off_ns - on_ns) * 1e-9
    a = (abs(torque_Nm) - C) / J
    expected = a * span_s**2 / 2 + (a * span_s) ** 2 / (2 * C / J)
    assert abs(abs(robot.q[0]) - expected) <= 1e-12
    assert robot.w == (0.0,)
    assert robot.friction() == (0.0,)


def test_stop_angle_with_viscosity(one_joint):
    D, torque_Nm, span_s = 0.7, 6.0, 0.25
    robot = Robot(one_joint(viscosity_Nms=(D,)), (0.3,))
    robot.set_external_torque(1, torque_Nm, 0)
    robot.set_external_torque(1, 0.0, 250 * MS)
    robot.advance_to(3 * S)
    T, w_end = J / D, (torque_Nm - C) / D
    w = w_end * (1 - exp(-span_s / T))
    stop_s = T * log(1 + w * D / C)
    expected = 0.3 + w_end * span_s - T * w + T * w - C / D * stop_s
    assert abs(robot.q[0] - expected) <= 1e-12
    assert robot.w == (0.0,)


def test_reversal_passes_through_standstill(one_joint):
    """A torque beyond the limit turns the joint around at once: friction changes its sign, the joint does not rest."""
    robot = Robot(one_joint(), (0.0,))
    robot.set_external_torque(1, 4.0, 0)
    robot.set_external_torque(1, -4.0, 100 * MS)
    robot.advance_to(300 * MS)
    w = (4.0 - C) / J * 0.1
    braking_s = w * J / (4.0 + C)
    back_s = 0.2 - braking_s
    expected_w = -(4.0 - C) / J * back_s
    expected_q = w * 0.1 / 2 + w * braking_s / 2 + expected_w * back_s / 2
    assert abs(robot.w[0] - expected_w) <= 1e-12
    assert abs(robot.q[0] - expected_q) <= 1e-12


def limited_to(factor, joint=None):
    """The default arm in a pose, its Coulomb friction `factor` times what holds it there (joint: only of that one)."""
    pose = (0.4, 0.9, -0.5)
    g = RigidBody(DEFAULT_ARM).terms(pose, (0.0, 0.0, 0.0))[2]
    limits = tuple(abs(x) * (factor if joint in (None, j) else 1.5) for j, x in enumerate(g, start=1))
    robot = Robot(replace(DEFAULT_ARM, coulomb_Nm=limits), pose)
    robot.release_brakes(0)
    return robot, pose


def test_friction_above_what_gravity_needs_holds_without_any_drift():
    robot, pose = limited_to(1.001)
    robot.advance_to(5 * S)
    assert (robot.q, robot.w) == (pose, (0.0, 0.0, 0.0))


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_friction_below_what_gravity_needs_lets_go(joint):
    robot, pose = limited_to(0.999, joint)
    robot.advance_to(100 * MS)
    assert robot.q[joint - 1] < pose[joint - 1]
    assert all(robot.q[j] == pose[j] for j in range(3) if j != joint - 1)


def test_friction_of_exactly_what_is_needed_holds(one_joint):
    robot = Robot(one_joint(), (0.0,))
    robot.set_external_torque(1, C, 0)
    robot.advance_to(S)
    assert (robot.q, robot.friction()) == ((0.0,), (C,))


def test_release_inside_a_step_is_located(one_joint):
    """The lagging current reaches the limit between two steps; closed form of what follows."""
    lag_s, reference_A = 5e-3, 2.0
    robot = Robot(one_joint(amplifier_lag_s=lag_s), (0.0,), max_step_ns=100 * US)
    robot.set_current(1, int(reference_A * 2048), 0)
    robot.advance_to(20 * MS)
    release_s = -lag_s * log(1 - C / (2.0 * reference_A))
    t = 0.020 - release_s
    peak, left = 2.0 * reference_A - C, C - 2.0 * reference_A
    w = (peak * t + left * lag_s * (1 - exp(-t / lag_s))) / J
    q = (peak * t**2 / 2 + left * lag_s * (t - lag_s * (1 - exp(-t / lag_s)))) / J
    assert abs(robot.w[0] - w) <= 1e-9
    assert abs(robot.q[0] - q) <= 1e-10


def driven(arm, seed, max_step_ns, every_ns=5 * MS, steps=100):
    """Random currents around those that hold the pose, often enough for every joint to stick and to turn."""
    draw = Random(seed)
    n = arm.joints
    pose = tuple(draw.uniform(-1.0, 1.0) for _ in range(n))
    g = RigidBody(arm).terms(pose, (0.0,) * n)[2]
    robot = Robot(arm, pose, max_step_ns=max_step_ns)
    robot.release_brakes(0)
    for k in range(steps):
        for joint in range(1, n + 1):
            K = arm.torque_constant_Nm_A[joint - 1]
            asked_A = (g[joint - 1] + draw.uniform(-2.5, 2.5) * arm.coulomb_Nm[joint - 1]) / K
            robot.set_current(joint, int(asked_A * 2048), k * every_ns)
        robot.advance_to((k + 1) * every_ns)
        yield robot


def equation_of_motion_holds(robot):
    arm, body = robot.parameters, RigidBody(robot.parameters)
    c, a = robot.friction(), robot.acceleration()
    needed = np.array(body.inverse_dynamics(robot.q, robot.w, a)) + c
    given = np.array(arm.torque_constant_Nm_A) * robot.current_A
    assert np.abs(needed - given).max() <= 1e-11
    for limit, friction, speed in zip(arm.coulomb_Nm, c, robot.w, strict=True):
        assert abs(friction) <= limit * (1 + 3e-12)
        if speed != 0.0 and limit > 0.0:
            assert friction == np.sign(speed) * limit


@pytest.mark.parametrize("joints", [1, 2, 3, 4, 6])
def test_equation_of_motion_holds_through_sticks_and_releases(joints, random_arm):
    arm = replace(random_arm(joints, 40 + joints), amplifier_lag_s=1e-3, current_limit_A=1e3)
    stood = turned = 0
    for robot in driven(arm, joints, MS, steps=60):
        equation_of_motion_holds(robot)
        stood += robot.w.count(0.0)
        turned += joints - robot.w.count(0.0)
    assert stood > 5
    assert turned > 5


@pytest.mark.parametrize("seed", range(6))
def test_result_hardly_depends_on_the_substep(seed):
    """Located changes keep the order of Runge-Kutta: twenty times smaller steps change nothing above 1e-9."""
    arm = replace(DEFAULT_ARM, current_limit_A=20.0)
    *_, coarse = driven(arm, seed, MS)
    *_, fine = driven(arm, seed, 50 * US)
    assert np.abs(np.array(coarse.q) - fine.q).max() <= 1e-9
    assert np.abs(np.array(coarse.w) - fine.w).max() <= 1e-8


def test_speed_that_turns_twice_within_a_step_is_seen(one_joint):
    """The lagging current stops the joint and sets it off again within one step; at both ends it moves forwards."""
    lag_s, span_s, P = 2e-3, 1e-3, 2.0 * 4.0 - C
    release_s = 0.5e-3
    Q = P * exp(release_s / lag_s)  # K i(t) - c = P - Q exp(-t / lag), zero at release_s
    arm = one_joint(amplifier_lag_s=lag_s)
    amplifiers = Amplifiers(arm)
    amplifiers.current_A, amplifiers.reference_A = ((P - Q + C) / 2.0,), (4.0,)
    motion = StickSlip(RigidBody(arm), amplifiers, (0.0,))
    motion.w = (4.5e-4,)
    motion.advance(span_s)
    expected = (P * (span_s - release_s) - Q * lag_s * (exp(-release_s / lag_s) - exp(-span_s / lag_s))) / J
    assert abs(motion.w[0] - expected) <= 1e-8  # 8e-5 off if the standstill is missed


def test_endless_changes_are_an_error_that_names_the_state(one_joint, monkeypatch):
    monkeypatch.setattr("plant.stick_slip.MOST_PARTS", 0)
    motion = StickSlip(RigidBody(one_joint()), Amplifiers(one_joint()), (0.25,))
    motion.w = (0.1,)
    with pytest.raises(ArithmeticError, match=r"more than 0 changes within 0\.001 s at q = \(0\.25,\) rad"):
        motion.advance(1e-3)
