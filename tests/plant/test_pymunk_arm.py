"""pymunk's arm against the closed form, MuJoCo and its own repetition; what it refuses."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from plant import pymunk_links
from plant.closed_form import constants
from plant.parameters import DEFAULT_ARM, ArmParameters
from plant.rigid_body import RigidBody
from plant.robot import Robot

S, MS, US = 1_000_000_000, 1_000_000, 1000
ZERO = (0.0, 0.0, 0.0)
DIRECT = ArmParameters((0.30, 0.25, 0.15), (1.2, 0.9, 0.5), ZERO, ZERO, ZERO, (4.0, 1.5, 0.3), ZERO)
DAMPED = replace(DIRECT, viscosity_Nms=(0.3, 0.1, 0.02))
HANGING = (-1.3, 0.2, -0.1)
LIFTED = (-0.6, 0.0, 0.0)  # and let go: wild, and not yet chaotic
START = (0.4, 0.9, -0.5)
AS_SHIPPED = (1.0 - 0.1) ** 60


def robots(arm, start, **settings):
    return Robot(arm, start, **settings), Robot(arm, start, backend="pymunk", **settings)


def apart(one, other):
    return np.abs(np.array(one.q) - other.q).max()


def swing(arm, start, duration_ns, step_us=100):
    closed, pymunk = Robot(arm, start), Robot(arm, start, max_step_ns=step_us * US, backend="pymunk")
    closed.advance_to(duration_ns)
    pymunk.advance_to(duration_ns)
    return apart(closed, pymunk)


@pytest.mark.parametrize("start", [HANGING, LIFTED])
def test_a_swing_of_2_s_is_that_of_the_closed_form(start):
    assert swing(DIRECT, start, 2 * S) <= 3e-6


@pytest.mark.parametrize(("setting", "value"), [("ERROR_BIAS", AS_SHIPPED), ("MAX_BIAS", 0.0)])
def test_a_lost_setting_would_show_and_ends_the_run(setting, value, monkeypatch):
    monkeypatch.setattr(pymunk_links, setting, value)
    with pytest.raises(ArithmeticError, match="the joints stand open by"):
        swing(DIRECT, LIFTED, 2 * S)
    monkeypatch.setattr(pymunk_links, "MOST_OPEN", np.inf)
    assert swing(DIRECT, LIFTED, 2 * S) > 2e-4


@pytest.mark.parametrize("arm", [DIRECT, DAMPED])
def test_the_error_falls_with_the_square_of_the_step(arm):
    coarse, middle, fine = (swing(arm, HANGING, S // 2, step_us) for step_us in (100, 50, 25))
    assert 3.6 <= coarse / middle <= 4.4
    assert 3.6 <= middle / fine <= 4.4


@pytest.mark.parametrize("payload_kg", [0.0, 2.0])
def test_a_swing_agrees_with_mujoco(payload_kg, mujoco_arm):
    robot = Robot(DAMPED, HANGING, payload_kg=payload_kg, backend="pymunk")
    model, data = mujoco_arm(DAMPED, payload_kg, step_s=5e-4)
    data.qpos[:] = robot.q
    for k in range(1, 11):
        robot.advance_to(k * S // 10)
        for _ in range(200):
            mujoco.mj_step(model, data)
        assert np.abs(np.array(robot.q) - data.qpos).max() <= 3e-6
        assert np.abs(np.array(robot.w) - data.qvel).max() <= 3e-5


@pytest.mark.parametrize("joints", [1, 2, 3, 4, 5, 6])
def test_arms_of_1_to_6_joints_follow_the_closed_form(joints, random_arm):
    """The rotor of joint 1 turns with its link, so it may be there."""
    none = (0.0,) * joints
    arm = replace(random_arm(joints, 7), coulomb_Nm=none, viscosity_Nms=none, brake_torque_Nm=none)
    arm = replace(arm, rotor_inertia_kgm2=(arm.rotor_inertia_kgm2[0], *none[1:]))
    start = (-1.3, *(0.2 * (-1) ** j for j in range(joints - 1)))
    assert swing(arm, start, S // 2) <= 3e-6


def energy(arm, robot):
    M = np.array(RigidBody(arm).terms(robot.q, robot.w)[0])
    heights = np.sin(np.cumsum(robot.q))
    potential = sum(constants(arm, 0.0)[f"G{i}"] * height for i, height in enumerate(heights, start=1))
    return 0.5 * np.array(robot.w) @ M @ np.array(robot.w) + potential


def test_a_swing_without_friction_keeps_its_energy():
    robot = Robot(DIRECT, HANGING, backend="pymunk")
    at_start = energy(DIRECT, robot)
    for k in range(1, 21):
        robot.advance_to(k * S // 10)
        assert abs(energy(DIRECT, robot) / at_start - 1.0) <= 1e-7


def test_it_stands_under_the_torque_that_gravity_needs():
    robot = Robot(DIRECT, START, backend="pymunk")
    held = RigidBody(DIRECT).terms(START, ZERO)[2]
    for joint, torque_Nm in enumerate(held, start=1):
        robot.set_external_torque(joint, torque_Nm, 0)
    robot.advance_to(100 * MS)
    assert np.abs(np.array(robot.q) - START).max() <= 1e-12
    assert np.abs(robot.w).max() <= 1e-11
    assert np.abs(robot.acceleration()).max() <= 1e-9
    assert robot.friction() == ZERO


BRAKED = replace(DAMPED, brake_torque_Nm=(60.0, 30.0, 8.0))


def act(robot, read=()):
    """A third of a second with everything that may act on it, at odd instants."""
    robot.release_brakes(0)
    robot.set_payload(0.5, 100_000_123)
    robot.set_payload(0.0, 200_033_000)
    robot.set_external_torque(2, 1.0, 50_049_999)
    for k in range(300):
        for joint, delay_us in ((1, 462), (2, 577), (3, 692)):
            counts = int((1.8, 1.0, 0.6)[joint - 1] * 2048 * (1 + 0.3 * np.sin(0.05 * k * joint)))
            robot.set_current(joint, counts, k * MS + delay_us * US)
        if k in read:
            robot.advance_to(k * MS + 333_333)
            robot.balance(), robot.counts()
        robot.advance_to((k + 1) * MS)
        yield k


def test_what_acts_at_odd_instants_acts_as_in_the_closed_form():
    """Angles, and speeds and accelerations as they are read, at every ms; a payload comes and goes between kicks."""
    closed, pymunk = robots(BRAKED, START, start_ns=-MS)
    for _ in zip(act(closed), act(pymunk), strict=True):
        assert apart(closed, pymunk) <= 1e-6
        assert np.abs(np.array(closed.w) - pymunk.w).max() <= 2e-5
        assert np.abs(np.array(closed.acceleration()) - pymunk.acceleration()).max() <= 1e-3
    assert max(np.abs(closed.w)) > 0.3


@pytest.mark.parametrize("at_us", [0, 1, 49, 50, 51, 99, 100, 462])
def test_a_torque_that_jumps_within_a_step_leaves_the_exact_speed(at_us, one_joint):
    arm = one_joint(coulomb_Nm=(0.0,))
    closed, pymunk = robots(arm, (0.0,))
    for robot in (closed, pymunk):
        robot.set_external_torque(1, 2.5, at_us * US)
        robot.advance_to(MS)
    assert pymunk.w[0] == pytest.approx(closed.w[0], rel=1e-12)
    assert pymunk.q[0] == pytest.approx(closed.q[0], abs=3.1 * 1e-8 / 8)  # q" step^2 / 8


def test_torque_ripple_is_taken_where_the_kick_is(one_joint):
    arm = one_joint(coulomb_Nm=(0.0,), ripple=(0.1,), ripple_order=(60.0,))
    closed, pymunk = robots(arm, (0.0,))
    for robot in (closed, pymunk):
        robot.set_current(1, 2048, 0)
        robot.advance_to(S // 2)
    assert apart(closed, pymunk) <= 1e-7


@pytest.mark.parametrize("instants_us", [(10, 30, 50, 80, 100), (7, 149, 150, 151, 260)])
def test_what_is_read_between_kicks_is_the_motion_of_that_instant(instants_us):
    closed, pymunk = robots(DIRECT, START)
    for at_us in instants_us:
        closed.advance_to(at_us * US)
        pymunk.advance_to(at_us * US)
        assert apart(closed, pymunk) <= 1e-10
        assert np.abs(np.array(closed.w) - pymunk.w).max() <= 1e-7


def test_runs_are_equal_bit_for_bit_and_reading_changes_nothing_but_the_last_digits():
    first, second, read = (Robot(BRAKED, START, start_ns=-MS, backend="pymunk") for _ in range(3))
    for _ in zip(act(first), act(second), act(read, read=range(0, 300, 7)), strict=True):
        assert (first.q, first.w) == (second.q, second.w)
        assert first.counts() == second.counts()
        assert apart(first, read) <= 1e-12


def test_brakes_hold_it_where_it_starts_and_after_the_run():
    closed, pymunk = robots(BRAKED, START, start_ns=-200 * MS)
    for robot in (closed, pymunk):
        robot.release_brakes(0)
        robot.advance_to(-1)
        assert (robot.q, robot.w, robot.counts()) == (START, ZERO, (0, 0, 0))
    assert pymunk.friction() == closed.friction()
    for robot in (closed, pymunk):
        robot.advance_to(0)
        assert (robot.q, robot.counts()) == (START, (0, 0, 0))
        robot.set_external_torque(1, 5.0, 50 * MS)
        robot.engage_brakes(100 * MS)
        robot.advance_to(400 * MS)
    assert pymunk.brake_states == ("engaged",) * 3
    assert pymunk.w == ZERO
    assert apart(closed, pymunk) <= 1e-6
    assert pymunk.friction() == pytest.approx(closed.friction(), abs=1e-5)


def test_preparing_changes_no_result():
    plain, prepared = (Robot(DAMPED, START, backend="pymunk") for _ in range(2))
    prepared.prepare()
    for robot in (plain, prepared):
        robot.advance_to(10 * MS)
    assert (plain.q, plain.w) == (prepared.q, prepared.w)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rotor_inertia_kgm2": (1.2, 0.5, 0.0)}, r"rotor inertia of joint 2: 0\.5 kg m\^2, but pymunk takes 0 there"),
        ({"coulomb_Nm": (0.0, 0.0, 0.4)}, r"Coulomb friction of joint 3: 0\.4 N m, but pymunk takes 0: .*backend"),
        ({"amplifier_lag_s": 0.001}, r"amplifier lag: 0\.001 s, but pymunk takes 0: .*; set it to 0, or take"),
        ({"viscosity_Nms": (0.1, 0.1, 2.0)}, r"viscosity of joint 3: 2 N m s, but pymunk takes at most 0\.\d+ with"),
    ],
)
def test_an_arm_that_it_cannot_carry_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        Robot(replace(DIRECT, **changes), START, backend="pymunk")
    Robot(replace(DIRECT, **changes), START)


def test_impulses_that_are_not_found_end_the_run(monkeypatch, random_arm):
    """Six joints and 50 kg on the hand: 30 iterations are too few."""
    none = (0.0,) * 6
    arm = replace(random_arm(6, 3), coulomb_Nm=none, viscosity_Nms=none, brake_torque_Nm=none, rotor_inertia_kgm2=none)
    start = (-1.3, 0.2, -0.2, 0.2, -0.2, 0.2)
    Robot(arm, start, payload_kg=50.0, backend="pymunk").advance_to(MS)
    monkeypatch.setattr(pymunk_links, "ITERATIONS", 30)
    with pytest.raises(ArithmeticError, match=r"the joints stand open by .* m in sum, .*: 30 iterations do not find"):
        Robot(arm, start, payload_kg=50.0, backend="pymunk").advance_to(MS)


def test_a_backend_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match=r"backend: 'bullet', but there are closed and pymunk"):
        Robot(DEFAULT_ARM, START, backend="bullet")


def test_pymunk_is_imported_by_its_own_backend_alone():
    program = (
        "import sys\nfrom plant.parameters import DEFAULT_ARM\nfrom plant.robot import Robot\n"
        "Robot(DEFAULT_ARM, (0.4, 0.9, -0.5)).advance_to(1000000)\nassert 'pymunk' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True, cwd=Path(__file__).parents[2])
