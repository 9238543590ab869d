"""Brakes: their states, what they hold, and what falls without them."""

from math import degrees

import pytest

from plant.brake import Brake
from plant.parameters import DEFAULT_ARM
from plant.rigid_body import RigidBody
from plant.robot import Robot

S, MS = 1_000_000_000, 1_000_000
START = (0.4, 0.9, -0.5)
STILL = (0.0, 0.0, 0.0)


def test_brake_engages_late_and_releases_at_once():
    brake = Brake(60.0, 30 * MS)
    assert (brake.state(-5), brake.torque_at(-5)) == ("engaged", 60.0)
    brake.release()
    assert (brake.state(0), brake.torque_at(0)) == ("released", 0.0)
    assert brake.engage(100) == 100 + 30 * MS
    assert (brake.state(99 + 30 * MS), brake.torque_at(99 + 30 * MS)) == ("engaging", 0.0)
    assert (brake.state(100 + 30 * MS), brake.torque_at(100 + 30 * MS)) == ("engaged", 60.0)


def test_second_command_does_not_put_the_first_off():
    brake = Brake(60.0, 30 * MS)
    assert brake.engage(5) == 5  # engaged from the start
    brake.release()
    brake.engage(0)
    assert brake.engage(10 * MS) == 30 * MS
    assert brake.engage(40 * MS) == 40 * MS


def test_release_while_engaging_cancels_it():
    robot = Robot(DEFAULT_ARM, START)
    robot.release_brakes(0)
    robot.engage_brakes(10 * MS)
    robot.release_brakes(20 * MS)
    robot.engage_brakes(35 * MS)
    states = {}
    for t_ms in (5, 15, 25, 45, 64, 65):
        robot.advance_to(t_ms * MS)
        states[t_ms] = robot.brake_states[0]
    assert states == {
        5: "released", 15: "engaging", 25: "released", 45: "engaging", 64: "engaging", 65: "engaged"
    }  # fmt: skip


def test_brakes_hold_the_outstretched_arm_with_3_kg():
    outstretched = (0.0, 0.0, 0.0)
    robot = Robot(DEFAULT_ARM, outstretched, payload_kg=3.0)
    robot.advance_to(2 * S)
    assert (robot.q, robot.w) == (outstretched, STILL)
    g = RigidBody(DEFAULT_ARM, 3.0).terms(outstretched, STILL)[2]
    assert robot.friction() == pytest.approx([-x for x in g], rel=1e-14)
    assert [abs(x) < torque for x, torque in zip(g, DEFAULT_ARM.brake_torque_Nm, strict=True)] == [True] * 3


def test_arm_without_brakes_and_current_falls():
    robot = Robot(DEFAULT_ARM, START)
    robot.release_brakes(0)
    robot.advance_to(300 * MS)
    assert 9.0 < degrees(START[0] - robot.q[0]) < 9.4  # Coulomb friction holds joints 2 and 3
    assert robot.q[1:] == START[1:]


def test_brake_stops_a_moving_joint_from_its_instant_on(one_joint):
    """Closed form: 2 N m for 100 ms, then nothing for the delay of 30 ms, then 1.5 + 20 N m against the motion."""
    J = 0.5 + 1 / 3
    robot = Robot(one_joint(brake_torque_Nm=(20.0,)), (0.0,))
    robot.release_brakes(0)
    robot.set_external_torque(1, 11.5, 0)
    robot.set_external_torque(1, 0.0, 100 * MS)
    robot.engage_brakes(100_000_321)
    robot.advance_to(S)
    w = 10.0 / J * 0.1
    gliding_s = 0.030000321
    w_brake = w - 1.5 / J * gliding_s
    expected = w * 0.05 + (w + w_brake) / 2 * gliding_s + w_brake**2 * J / (2 * 21.5)
    assert abs(robot.q[0] - expected) <= 1e-12
    assert robot.w == (0.0,)
