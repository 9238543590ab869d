"""Free swings against SciPy's DOP853 and MuJoCo's Runge-Kutta: size and order of the integration's error."""

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plant.closed_form import constants
from plant.parameters import DEFAULT_ARM, ArmParameters
from plant.rigid_body import RigidBody
from plant.robot import Robot

ZERO = (0.0, 0.0, 0.0)
# light links in direct drive, which swings wildest
DIRECT = ArmParameters((0.30, 0.25, 0.15), (1.2, 0.9, 0.5), ZERO, ZERO, ZERO, (1.0, 1.0, 1.0), ZERO)
GEARED = replace(DEFAULT_ARM, coulomb_Nm=ZERO, viscosity_Nms=ZERO, brake_torque_Nm=ZERO)
DAMPED = replace(GEARED, viscosity_Nms=DEFAULT_ARM.viscosity_Nms)
HANGING = (-1.3, 0.2, -0.1)
HORIZONTAL = (0.0, 0.0, 0.0)
S = 1_000_000_000


def swing(arm, start, duration_ns, step_ns):
    robot = Robot(arm, start, max_step_ns=step_ns)
    robot.advance_to(duration_ns)
    return robot


@cache
def reference(arm, start, duration_s):
    body = RigidBody(arm)

    def slope(_, state):
        q, w = tuple(state[:3]), tuple(state[3:])
        return (*w, *body.acceleration(q, w, ZERO))

    return solve_ivp(slope, (0.0, duration_s), (*start, *ZERO), method="DOP853", rtol=1e-13, atol=1e-13).y[:3, -1]


@pytest.mark.parametrize(
    ("arm", "start", "duration_s", "limit"),
    [
        (DIRECT, HANGING, 2, 1e-8),
        (GEARED, HANGING, 2, 1e-8),
        (GEARED, (0.4, 0.9, -0.5), 2, 1e-10),
        (DAMPED, (0.4, 0.9, -0.5), 2, 1e-11),
        # from the horizontal a direct-drive swing is chaotic: errors grow 300-fold in the second second
        (DIRECT, HORIZONTAL, 1, 1e-7),
        (GEARED, HORIZONTAL, 1, 1e-11),
    ],
)
def test_swing_at_1_ms_agrees_with_dop853(arm, start, duration_s, limit):
    robot = swing(arm, start, duration_s * S, 1_000_000)
    assert np.abs(np.array(robot.q) - reference(arm, start, duration_s)).max() <= limit


@pytest.mark.parametrize("start", [HANGING, (-0.6, 0.6, 0.4), HORIZONTAL])
def test_error_falls_with_the_fourth_power_of_the_step(start):
    coarse, fine = (
        np.abs(np.array(swing(DIRECT, start, S, step_ns).q) - reference(DIRECT, start, 1)).max()
        for step_ns in (1_000_000, 250_000)
    )
    assert fine <= coarse / 150


@pytest.mark.parametrize("payload_kg", [0.0, 2.0])
def test_swing_agrees_with_mujoco(payload_kg, mujoco_arm):
    robot = Robot(DAMPED, (0.4, 0.9, -0.5), payload_kg=payload_kg)
    model, data = mujoco_arm(DAMPED, payload_kg, step_s=1e-4)
    data.qpos[:] = robot.q
    for k in range(1, 11):
        robot.advance_to(k * S // 10)
        for _ in range(1000):
            mujoco.mj_step(model, data)
        assert np.abs(np.array(robot.q) - data.qpos).max() <= 1e-10


def energy(arm, robot):
    M = np.array(RigidBody(arm).terms(robot.q, robot.w)[0])
    heights = np.sin(np.cumsum(robot.q))
    potential = sum(constants(arm, 0.0)[f"G{i}"] * height for i, height in enumerate(heights, start=1))
    return 0.5 * np.array(robot.w) @ M @ np.array(robot.w) + potential


@pytest.mark.parametrize("arm", [DIRECT, GEARED])
def test_swing_without_friction_keeps_its_energy(arm):
    """2 s at 1 ms, no viscosity, no Coulomb friction."""
    robot = Robot(arm, HANGING)
    at_start = energy(arm, robot)
    for k in range(1, 21):
        robot.advance_to(k * S // 10)
        assert abs(energy(arm, robot) / at_start - 1.0) <= 1e-10
