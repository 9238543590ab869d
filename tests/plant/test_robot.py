"""The robot as the bench uses it: exact instants, events in order, repeatability, refusals."""

from dataclasses import replace

import numpy as np
import pytest

from plant.kinematics import tip_velocity
from plant.parameters import DEFAULT_ARM
from plant.rigid_body import RigidBody
from plant.robot import Robot

S, MS = 1_000_000_000, 1_000_000
START = (0.4, 0.9, -0.5)
J = 0.5 + 1 / 3  # of the fixture one_joint


@pytest.mark.parametrize("at_ns", [1, 462_000, 999_999, 1_000_000, 1_000_001])
def test_current_acts_from_its_very_nanosecond(one_joint, at_ns):
    robot = Robot(one_joint(), (0.0,))
    robot.set_current(1, 4096, at_ns)
    robot.advance_to(at_ns - 1)
    assert (robot.q, robot.w, robot.current_A) == ((0.0,), (0.0,), (0.0,))
    robot.advance_to(5 * MS)
    t, a = (5 * MS - at_ns) * 1e-9, (4.0 - 1.5) / J
    assert robot.w[0] == pytest.approx(a * t, rel=1e-12)
    assert robot.q[0] == pytest.approx(a * t * t / 2, rel=1e-12)
    assert robot.acceleration()[0] == pytest.approx(a, rel=1e-14)


def test_events_act_in_the_order_of_time_then_of_the_calls(one_joint):
    robot = Robot(one_joint(), (0.0,), start_ns=-10)
    robot.set_current(1, 300, 20)
    robot.set_current(1, 100, 10)
    robot.set_current(1, 200, 10)
    robot.set_current(1, 50, -10)
    seen = [robot.current_A[0] * 2048]
    for t_ns in (9, 10, 19, 20):
        robot.advance_to(t_ns)
        seen.append(robot.current_A[0] * 2048)
    assert seen == [50, 50, 200, 200, 300]


def drive(read_ns=()):
    """Half a second of the default arm with everything that can act on it."""
    robot = Robot(replace(DEFAULT_ARM, ripple=(0.01, 0.02, 0.01), ripple_order=(6.0, 6.0, 6.0)), START, start_ns=-MS)
    robot.release_brakes(0)
    robot.set_payload(1.0, 100_000_123)
    robot.set_external_torque(2, 3.0, 200 * MS)
    robot.engage_brakes(450 * MS)
    for k in range(500):
        for joint, delay_ns in ((1, 462_000), (2, 577_000), (3, 692_000)):
            counts = int((2.2, 1.5, 0.5)[joint - 1] * 2048 * (1 + np.sin(0.05 * k * joint)))
            robot.set_current(joint, counts, k * MS + delay_ns)
        robot.advance_to((k + 1) * MS)
        if k in read_ns:
            robot.acceleration(), robot.friction(), robot.counts()
    return robot


def test_runs_are_equal_bit_for_bit_and_reading_changes_nothing():
    first, second = drive(), drive(read_ns=range(0, 500, 3))
    assert (first.q, first.w) == (second.q, second.w)
    assert (first.counts(), first.friction()) == (second.counts(), second.friction())
    assert first.brake_states == ("engaged",) * 3


def test_preparing_changes_no_result():
    plain, prepared = Robot(DEFAULT_ARM, START), Robot(DEFAULT_ARM, START)
    prepared.prepare()
    for robot in (plain, prepared):
        robot.release_brakes(0)
        robot.advance_to(100 * MS)
    assert (plain.q, plain.w) == (prepared.q, prepared.w)


def test_payload_put_on_at_speed_keeps_the_velocity():
    robot = Robot(DEFAULT_ARM, START)
    robot.release_brakes(0)
    robot.advance_to(100 * MS)
    before = robot.w
    assert before[0] < -0.1
    a_before = robot.acceleration()
    robot.set_payload(0.2, 100 * MS)
    assert (robot.w, robot.payload_kg) == (before, 0.2)
    assert tip_velocity(DEFAULT_ARM, robot.q, robot.w) == tip_velocity(DEFAULT_ARM, robot.q, before)
    assert robot.acceleration() != a_before
    free = tuple(j for j, v in enumerate(robot.w, start=1) if v)
    torque = tuple(-np.sign(v) * c for v, c in zip(robot.w, DEFAULT_ARM.coulomb_Nm, strict=True))
    assert robot.acceleration() == RigidBody(DEFAULT_ARM, 0.2).acceleration(robot.q, robot.w, torque, free)


def test_torque_from_outside_pushes_towards_larger_angles(one_joint):
    robot = Robot(one_joint(), (0.0,))
    robot.set_external_torque(1, 2.5, 0)
    assert robot.external_Nm == (2.5,)
    assert robot.acceleration()[0] == pytest.approx(1.0 / J, rel=1e-14)
    assert robot.friction() == (1.5,)


def test_saturated_references_are_counted_by_joint():
    robot = Robot(DEFAULT_ARM, START)
    robot.set_current(1, 20_000, 0)
    robot.set_current(3, -20_000, MS)
    robot.set_current(3, -20_000, 2 * MS)
    robot.advance_to(3 * MS)
    assert robot.saturations == (1, 0, 2)
    assert robot.current_A == (8.0, 0.0, -8.0)


def test_long_spans_are_cut_into_substeps_of_equal_length(frictionless):
    long, short = Robot(frictionless, START), Robot(frictionless, START)
    long.advance_to(10 * MS)
    for k in range(1, 11):
        short.advance_to(k * MS)
    assert np.abs(np.array(long.q) - short.q).max() <= 1e-15
    odd = Robot(frictionless, START, max_step_ns=3 * MS)
    odd.advance_to(10 * MS)
    assert np.abs(np.array(odd.q) - long.q).max() <= 1e-10


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda robot: robot.advance_to(4 * MS), r"advance_to\(4000000 ns\): the robot is at 5000000 ns already"),
        (lambda robot: robot.set_current(1, 0, MS), r"event at 1000000 ns: the robot is at 5000000 ns already"),
        (lambda robot: robot.set_current(0, 0, S), r"joint 0: the arm has joints 1 to 3"),
        (lambda robot: robot.set_external_torque(4, 0.0, S), r"joint 4: the arm has joints 1 to 3"),
        (lambda robot: robot.set_external_torque(1, float("nan"), S), r"external torque of joint 1: nan N m"),
        (lambda robot: robot.set_payload(-1.0, S), r"payload mass_kg: -1\.0"),
        (lambda _: Robot(DEFAULT_ARM, (0.0, 0.0)), r"start pose \(0\.0, 0\.0\): give one finite angle"),
        (lambda _: Robot(DEFAULT_ARM, (0.0, 0.0, float("inf"))), r"start pose .*: give one finite angle"),
        (lambda _: Robot(DEFAULT_ARM, START, max_step_ns=0), r"max_step_ns: 0, but a step has at least 1 ns"),
    ],
)
def test_what_does_not_fit_is_refused(call, message):
    robot = Robot(DEFAULT_ARM, START)
    robot.advance_to(5 * MS)
    with pytest.raises(ValueError, match=message):
        call(robot)


def test_reference_must_be_whole_counts():
    with pytest.raises(TypeError, match=r"current of joint 3: 1\.5 is not a whole number of counts"):
        Robot(DEFAULT_ARM, START).set_current(3, 1.5, MS)
