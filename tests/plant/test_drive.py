"""Amplifiers and torque constant against closed forms."""

from dataclasses import replace
from math import cos, exp, sin

import pytest

from plant.drive import Amplifiers, torque_constant
from plant.parameters import DEFAULT_ARM
from plant.robot import Robot

MS = 1_000_000
J = 0.5 + 1 / 3  # of the fixture one_joint


@pytest.mark.parametrize(
    ("counts", "current_A", "saturations"),
    [
        (0, 0.0, 0),
        (1, 1 / 2048, 0),
        (-2048, -1.0, 0),
        (16384, 8.0, 0),
        (16385, 8.0, 1),
        (-16384, -8.0, 0),
        (-16385, -8.0, 1),
        (32767, 8.0, 1),
    ],
)
def test_reference_is_limited_and_counted(counts, current_A, saturations):
    amplifiers = Amplifiers(DEFAULT_ARM)
    amplifiers.command(1, counts)
    assert amplifiers.current_A == (0.0, current_A, 0.0)
    assert amplifiers.saturations == [0, saturations, 0]


def test_lag_is_a_first_order_step_response():
    amplifiers = Amplifiers(replace(DEFAULT_ARM, amplifier_lag_s=2e-3))
    amplifiers.command(0, 4096)
    assert amplifiers.current_A[0] == 0.0
    start, middle, end = amplifiers.during(1e-3)
    assert start[0] == 0.0
    assert middle[0] == pytest.approx(2.0 * (1 - exp(-0.25)), rel=1e-15)
    amplifiers.elapse(1e-3)
    assert amplifiers.current_A == end
    amplifiers.command(0, -2048)
    amplifiers.elapse(5e-3)
    assert amplifiers.current_A[0] == pytest.approx(-1.0 + (end[0] + 1.0) * exp(-2.5), rel=1e-14)


@pytest.mark.parametrize("lag_s", [1e-4, 2e-3, 1e-2])
def test_arm_behind_a_lag_moves_as_the_closed_form(one_joint, lag_s):
    at_ns, end_ns = 462_001, 50 * MS
    robot = Robot(one_joint(amplifier_lag_s=lag_s, coulomb_Nm=(0.0,)), (0.0,))
    robot.set_current(1, 3 * 2048, at_ns)
    robot.advance_to(end_ns)
    t = (end_ns - at_ns) * 1e-9
    left = 1 - exp(-t / lag_s)
    assert robot.current_A[0] == pytest.approx(3.0 * left, rel=1e-13)
    # the lag takes 6 / J lag of speed away; Simpson's rule over a fourth of it is off by (1/4)^4 / 2880 = 1.4e-6
    tolerance = 1.5e-6 * 6.0 / J * lag_s
    assert abs(robot.w[0] - 6.0 / J * (t - lag_s * left)) <= tolerance
    assert abs(robot.q[0] - 6.0 / J * (t * t / 2 - lag_s * t + lag_s**2 * left)) <= tolerance * t


def test_ripple_is_felt_at_every_stage(one_joint):
    """Without friction, the energy that a constant current puts in is the integral of Kt(q) over the path."""
    ripple, order, current_A = 0.05, 12.0, 1.5
    arm = one_joint(coulomb_Nm=(0.0,), ripple=(ripple,), ripple_order=(order,))
    robot = Robot(arm, (0.2,))
    robot.set_current(1, int(current_A * 2048), 0)
    robot.advance_to(700 * MS)

    q = robot.q[0]
    work = 2.0 * current_A * (q - 0.2 + ripple / order * (sin(order * q) - sin(order * 0.2)))
    assert q > 0.8
    assert J * robot.w[0] ** 2 / 2 == pytest.approx(work, rel=1e-10)


def test_torque_constant_is_nominal_times_ripple():
    arm = replace(DEFAULT_ARM, ripple=(0.0, 0.02, 0.1), ripple_order=(1.0, 6.0, 3.0))
    assert torque_constant(arm, (0.3, 0.4, 0.5)) == (10.0, 6.0 * (1 + 0.02 * cos(2.4)), 2.0 * (1 + 0.1 * cos(1.5)))
