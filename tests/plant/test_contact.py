"""Contact of the tip with compliant surfaces: closed forms, the same formulas in numpy, and DOP853."""

from dataclasses import replace
from math import cos, hypot, pi, sin, sqrt

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plant import array_form
from plant.contact import Compliance
from plant.disturbance import disturbance_terms
from plant.drive import Amplifiers
from plant.kinematics import tip, tip_jacobian, tip_velocity
from plant.parameters import DEFAULT_ARM
from plant.rigid_body import RigidBody
from plant.robot import Robot
from plant.stick_slip import StickSlip
from plant.touching import LONGEST_S, Touching
from plant.world import Wall, World

MS = 1_000_000
START = (0.4, 0.9, -0.5)
J = 0.5 + 1 / 3  # of the fixture one_joint, whose link is 1 m long: the tip feels J kg
SPRING = Compliance(1e4)


def ahead_of(arm, q, gap_m, direction, compliance):
    """A wall gap_m in front of the tip at q, in this direction."""
    x, y, _ = tip(arm, q)
    nx, ny = direction
    return Wall((x + gap_m * nx, y + gap_m * ny), (-nx, -ny), compliance)


def force_on_tip(surfaces, arm, q, w):
    """The module's formulas, in numpy: total force, and (depth, F_n, F_t) of each surface."""
    point, velocity = np.array(tip(arm, q)[:2]), np.array(tip_velocity(arm, q, w)[:2])
    total, each = np.zeros(2), []
    for s in surfaces:
        normal, tangent = np.array([s.normal_x, s.normal_y]), np.array([-s.normal_y, s.normal_x])
        depth = -normal @ (point - [s.x_m, s.y_m])
        relative = velocity - [s.speed_x_m_s, s.speed_y_m_s]
        push = max(0.0, s.stiffness_N_m * depth - s.damping_N_s_m * (normal @ relative)) if depth > 0 else 0.0
        slip = tangent @ relative
        rub = -s.friction * push * np.clip(slip / s.sliding_speed_m_s, -1.0, 1.0)
        total += push * normal + rub * tangent
        each.append((max(0.0, depth), push, rub))
    return total, each


@pytest.mark.parametrize("joints", range(1, 7))
@pytest.mark.parametrize("surfaces", [1, 2])
def test_the_text_says_what_the_formulas_say(random_arm, joints, surfaces):
    """Torque, acceleration and holding torque of arms of 1 to 6 joints, against numpy; only rounding differs."""
    arm = random_arm(joints, joints)
    draw = np.random.default_rng(joints)
    body = RigidBody(arm, 0.7)
    for _ in range(5):
        q, w = tuple(draw.uniform(-3, 3, joints)), tuple(draw.uniform(-2, 2, joints))
        near = []
        for _ in range(surfaces):
            angle = draw.uniform(-pi, pi)
            compliance = Compliance(*draw.uniform((1e3, 0.0, 0.0, 1e-3), (1e5, 200.0, 1.0, 3.0)))
            wall = ahead_of(arm, q, draw.uniform(-5e-3, 1e-3), (cos(angle), sin(angle)), compliance)
            near.append(wall.surface()._replace(speed_x_m_s=draw.uniform(-1, 1), speed_y_m_s=draw.uniform(-1, 1)))
        touching = Touching(body, tuple(near))
        force, each = force_on_tip(near, arm, q, w)
        np.testing.assert_allclose(touching.touches(q, w), each, rtol=1e-9, atol=1e-9)
        torque = np.array(tip_jacobian(arm, q)).T @ force
        np.testing.assert_allclose(touching.torque(q, w), torque, rtol=1e-9, atol=1e-9)

        zero = (0.0,) * joints
        outside = body.acceleration(q, w, tuple(torque))
        np.testing.assert_allclose(touching.balance(body.all_joints)(q, w, zero, zero)[0], outside, rtol=1e-8)
        held = touching.balance(())(q, w, zero, zero)[1]
        bare = body.balance(())(q, w, zero, zero)[1]
        np.testing.assert_allclose(held, np.array(bare) + torque, rtol=1e-9, atol=1e-9)


def test_jacobian_is_the_derivative_of_the_tip(random_arm):
    arm = random_arm(5, 1)
    q, w = (0.3, -0.7, 1.1, 0.2, -2.0), (1.0, -2.0, 0.5, 0.3, 0.7)
    np.testing.assert_allclose(np.array(tip_jacobian(arm, q)) @ w, tip_velocity(arm, q, w)[:2], rtol=1e-12)


def pushing(one_joint, **changes):
    """One joint at 0 whose tip pushes upwards with 20 N against a wall 1 mm ahead."""
    arm = one_joint(coulomb_Nm=(0.0,), **changes)
    robot = Robot(arm, (0.0,), world=World([ahead_of(arm, (0.0,), 1e-3, (0.0, 1.0), Compliance(1e4, 100.0))]))
    robot.set_external_torque(1, 20.0, 0)
    return arm, robot


def test_a_steady_push_of_20_newton_reads_as_stiffness_times_depth(one_joint):
    """Equilibrium: F = torque / (l cos q). It decays by 60 / s, so after 2 s only rounding is left (1e-10 N)."""
    arm, robot = pushing(one_joint)
    read = []
    for k in range(2000, 2100):
        robot.advance_to(k * MS)
        read.append(robot.encounter.touches()["wall1"])
    force, depth_m = read[-1].normal_N, tip(arm, robot.q)[1] - 1e-3
    assert abs(force - 1e4 * depth_m) <= 1e-9
    assert abs(force - 20.0 / cos(robot.q[0])) <= 1e-9
    assert max(touch.normal_N for touch in read) - min(touch.normal_N for touch in read) <= 1e-9


def test_an_arm_whose_joints_stand_against_a_wall_does_not_move_at_all():
    """Coulomb friction holds the pose: the force does not chatter by a single bit."""
    wall = ahead_of(DEFAULT_ARM, START, 1e-3, (1.0, 0.0), Compliance(1e4, 100.0, 0.3))
    robot = Robot(DEFAULT_ARM, START, world=World([wall]))
    robot.release_brakes(0)
    g = RigidBody(DEFAULT_ARM).terms(START, (0.0,) * 3)[2]
    push = np.array(tip_jacobian(DEFAULT_ARM, START)).T @ [20.0, 0.0]
    for joint, torque in enumerate(np.array(g) + push, start=1):
        robot.set_current(joint, round(torque / DEFAULT_ARM.torque_constant_Nm_A[joint - 1] * 2048), 0)
    robot.advance_to(2000 * MS)
    before = robot.q, robot.encounter.touches()
    assert robot.w == (0.0, 0.0, 0.0)
    assert 1.0 < before[1]["wall1"].normal_N < 40.0
    robot.advance_to(3000 * MS)
    assert (robot.q, robot.encounter.touches()) == before


def bounce(one_joint, compliance, speed=0.1, steps=1000, every_ns=100_000):
    """Time, depth and tip speed of one joint, without friction and gravity, that meets a wall 1 mm ahead at speed."""
    arm = one_joint(coulomb_Nm=(0.0,))
    robot = Robot(arm, (0.0,), world=World([ahead_of(arm, (0.0,), 1e-3, (0.0, 1.0), compliance)]))
    robot.set_external_torque(1, speed * J / 1e-3, 0)
    robot.set_external_torque(1, 0.0, MS)
    rows = []
    for k in range(steps):
        robot.advance_to(MS + k * every_ns)
        rows.append((k * every_ns * 1e-9, tip(arm, robot.q)[1] - 1e-3, robot.w[0], robot.encounter.touches()["wall1"]))
    return rows


def test_a_bounce_takes_half_a_period_and_no_energy(one_joint):
    """The closed form is flat: the tip's arc, depth / 1 m, bends it by 1e-6; onset and end are off by h^2 at most."""
    rows = bounce(one_joint, SPRING)
    inside = [t for t, _, _, touch in rows if touch.normal_N > 0.0]
    period_s = pi * sqrt(J / 1e4)
    assert abs(inside[-1] - inside[0] - period_s) <= 2e-4  # what is sampled at 100 us is known to twice that
    peak = max(touch.normal_N for _, _, _, touch in rows)
    assert peak == pytest.approx(0.1 * sqrt(1e4 * J), rel=1e-4)
    assert rows[0][2] == pytest.approx(0.1, rel=1e-5)
    assert -rows[-1][2] == pytest.approx(rows[0][2], rel=2e-5)


def test_a_damped_wall_takes_energy_and_never_pulls(one_joint):
    """Kelvin-Voigt without pull: the tip leaves where K d = C d', closed form of the damped oscillator."""
    damping, mass = 60.0, J
    rows = bounce(one_joint, Compliance(1e4, damping))
    assert min(touch.normal_N for *_, touch in rows) == 0.0
    decay, w0 = damping / (2 * mass), sqrt(1e4 / mass)
    wd = sqrt(w0**2 - decay**2)
    t = np.linspace(0.0, 2 * pi / wd, 200_001)[1:]
    depth = 0.1 / wd * np.exp(-decay * t) * np.sin(wd * t)
    rate = 0.1 * np.exp(-decay * t) * (np.cos(wd * t) - decay / wd * np.sin(wd * t))
    leaves = np.argmax(1e4 * depth + damping * rate <= 0.0)
    # the damper's force jumps inside a step, which is first order: half a step of it, h C / 2 m
    assert -rows[-1][2] == pytest.approx(-rate[leaves], rel=100e-6 * damping / (2 * mass))


def test_the_error_of_a_bounce_falls_with_the_square_of_the_step(one_joint, monkeypatch):
    """Onset and end lie inside a step: second order, as plain Runge-Kutta over a corner of the force."""
    lost = {}
    for longest_s in (400e-6, 100e-6):
        monkeypatch.setattr("plant.touching.LONGEST_S", longest_s)
        rows = bounce(one_joint, SPRING, every_ns=400_000, steps=250)
        lost[longest_s] = abs(rows[-1][2] + rows[0][2])
    assert lost[100e-6] <= lost[400e-6] / 4


def test_friction_of_a_sliding_tip_is_mu_times_the_normal_force():
    wall = ahead_of(DEFAULT_ARM, START, -1e-3, (1.0, 0.0), Compliance(1e4, 0.0, 0.3, 1e-3))
    touching = Touching(RigidBody(DEFAULT_ARM), (wall.surface(),))
    for vy, expected in ((0.2, 1.0), (-0.2, -1.0), (0.5e-3, 0.5), (0.0, 0.0)):
        w = tuple(np.linalg.pinv(np.array(tip_jacobian(DEFAULT_ARM, START))) @ [0.0, vy])
        (touch,) = touching.touches(START, w)
        # the tangent of a wall that faces -x points down
        assert touch.normal_N == pytest.approx(10.0, rel=1e-9)
        assert touch.tangential_N == pytest.approx(0.3 * 10.0 * expected, rel=1e-9, abs=1e-9)
        torque = np.array(touching.torque(START, w))
        force = np.linalg.pinv(np.array(tip_jacobian(DEFAULT_ARM, START)).T) @ torque
        np.testing.assert_allclose(force, [-10.0, -3.0 * expected], atol=1e-9)


def test_an_arm_that_falls_onto_a_rough_floor_follows_dop853(frictionless):
    """0.25 s of free fall, impact and sliding; DOP853 at 1e-9 meets the same corners of the force by shorter steps."""
    floor = ahead_of(frictionless, START, 0.02, (-0.28, -0.96), Compliance(2e4, 40.0, 0.3, 1e-2))
    robot = Robot(frictionless, START, world=World([floor]))
    robot.advance_to(250 * MS)
    assert robot.encounter.touches()["wall1"].normal_N > 0.0

    surface, none = (floor.surface(),), np.zeros(1)

    def rate(_t, state):
        q, w = state[:3], state[3:]
        row_q, row_w = q[None, :], w[None, :]
        M = array_form.inertia(frictionless, row_q, none)[0]
        bias = (
            array_form.coriolis(frictionless, row_q, row_w, none)[0] + array_form.gravity(frictionless, row_q, none)[0]
        )
        torque = np.array(tip_jacobian(frictionless, q)).T @ force_on_tip(surface, frictionless, q, w)[0]
        return np.concatenate([w, np.linalg.solve(M, torque - bias)])

    exact = solve_ivp(rate, (0.0, 0.25), [*START, 0.0, 0.0, 0.0], "DOP853", rtol=1e-9, atol=1e-11).y[:, -1]
    np.testing.assert_allclose(robot.q, exact[:3], atol=5e-6)
    np.testing.assert_allclose(robot.w, exact[3:], atol=1e-4)


def test_a_surface_that_moves_pushes_an_arm_at_rest(one_joint):
    """y'' = K (V t - y) / m has y = V t - V / w sin w t; the tip's arc and Runge-Kutta are below 1e-9 m here."""
    arm = one_joint(coulomb_Nm=(0.0,))
    body, speed = RigidBody(arm), 0.01
    wall = Wall((1.0, 0.0), (0.0, 1.0), SPRING)
    motion = StickSlip(body, Amplifiers(arm), (0.0,))
    motion.change(body=Touching(body, (wall.surface()._replace(speed_y_m_s=speed),)))
    for _ in range(100):
        motion.advance(1e-4)
    natural = sqrt(1e4 / J)
    assert sin(motion.q[0]) == pytest.approx(speed * 0.01 - speed / natural * sin(natural * 0.01), abs=1e-9)


@pytest.mark.parametrize("step_s", [1e-4, 0.37e-4])
def test_a_joint_that_stands_gives_way_when_the_surface_pushes_hard_enough(one_joint, step_s):
    """K V t = C sets it off inside a substep; from then on y = V t - V / w sin w t, as without friction."""
    arm, speed = one_joint(), 0.01
    body = RigidBody(arm)
    wall = Wall((1.0, 0.0), (0.0, 1.0), SPRING)
    motion = StickSlip(body, Amplifiers(arm), (0.0,))
    motion.change(body=Touching(body, (wall.surface()._replace(speed_y_m_s=speed),)))
    release_s, natural = 1.5 / (1e4 * speed), sqrt(1e4 / J)
    for k in range(1, round(0.025 / step_s)):
        motion.advance(step_s)
        t = max(0.0, k * step_s - release_s)
        assert sin(motion.q[0]) == pytest.approx(speed * t - speed / natural * sin(natural * t), abs=1e-10)
    assert motion.w[0] > 0.0


def test_the_disturbance_terms_hold_in_contact():
    """t_dis = Ktn i - Jn q" with the contact in the reaction, while the tip slides on a wall and joints set off."""
    arm = replace(DEFAULT_ARM, ripple=(0.02, 0.01, 0.03), ripple_order=(6.0, 6.0, 6.0))
    wall = ahead_of(arm, START, 2e-3, (-0.96, 0.28), Compliance(1e4, 100.0, 0.3))
    robot = Robot(arm, START, world=World([wall]))
    robot.release_brakes(0)
    robot.set_external_torque(3, 0.5, 100 * MS)
    rows, largest_N = [], 0.0
    for k in range(300):
        for joint in (1, 2, 3):
            robot.set_current(joint, int((2.0, 1.3, 0.4)[joint - 1] * 2048 * (1 + sin(0.03 * k))), k * MS + 462_000)
        robot.advance_to((k + 1) * MS)
        a, c = robot.balance()
        rows.append((robot.q, robot.w, a, robot.current_A, c, robot.external_Nm))
        largest_N = max(largest_N, robot.encounter.touches()["wall1"].normal_N)
    assert largest_N > 5.0
    q, w, a, current, c, external = (np.array(column) for column in zip(*rows, strict=True))
    Jn, Ktn = (1.344, 0.537, 0.0832), (10.0, 6.0, 2.0)
    total = disturbance_terms(arm, q, w, a, current, c, Jn, Ktn, 0.0, external).total()
    np.testing.assert_allclose(total, current * Ktn - a * Jn, atol=1e-9)


def test_a_wall_out_of_reach_changes_no_bit():
    def run(world):
        robot = Robot(DEFAULT_ARM, START, world=world)
        robot.release_brakes(0)
        for k in range(200):
            robot.set_current(1, 4000, k * MS + 462_000)
            robot.advance_to((k + 1) * MS)
        return robot.q, robot.w

    assert run(World([Wall((5.0, 0.0), (-1.0, 0.0), SPRING)])) == run(None)


def test_preparing_changes_no_result_of_a_contact():
    def run(prepare):
        robot = Robot(DEFAULT_ARM, START, world=World([ahead_of(DEFAULT_ARM, START, 1e-3, (0.0, -1.0), SPRING)]))
        if prepare:
            robot.prepare()
        robot.release_brakes(0)
        robot.advance_to(100 * MS)
        return robot.q, robot.encounter.touches()

    assert run(True) == run(False)
    assert run(True)[1]["wall1"].normal_N > 1.0


def test_a_substep_is_short_where_the_surface_is_stiff_for_what_it_moves():
    touching = [
        Touching(RigidBody(DEFAULT_ARM), (ahead_of(DEFAULT_ARM, START, -1e-3, (1.0, 0.0), c).surface(),))
        for c in (Compliance(1e4, 100.0), Compliance(1e8), Compliance(1e4, 1e5), Compliance(1e5, 0.0, 1.0, 1e-4))
    ]
    rest = (0.0, 0.0, 0.0)
    longest = [each.longest_s(START, rest) for each in touching]
    assert longest[0] == LONGEST_S
    M = array_form.inertia(DEFAULT_ARM, np.array([START]), np.zeros(1))[0]
    jacobian = np.array(tip_jacobian(DEFAULT_ARM, START))
    mobility = np.trace(jacobian @ np.linalg.solve(M, jacobian.T))
    assert longest[1:] == pytest.approx(
        [0.5 / sqrt(1e8 * mobility), 0.5 / (1e5 * mobility), 0.5 / (1e5 * 1e-3 / 1e-4 * mobility)], rel=1e-9
    )


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((0.0,), r"stiffness_N_m: 0\.0, but it must be more than 0 and finite"),
        ((1e4, -1.0), r"damping_N_s_m: -1\.0, but it must be at least 0 and finite"),
        ((1e4, 0.0, float("nan")), r"friction: nan, but it must be at least 0 and finite"),
        ((1e4, 0.0, 0.0, 0.0), r"sliding_speed_m_s: 0\.0, but it must be more than 0 and finite"),
    ],
)
def test_a_surface_that_cannot_be_is_refused(values, message):
    with pytest.raises(ValueError, match=message):
        Compliance(*values)


def test_a_wall_without_direction_is_refused():
    with pytest.raises(ValueError, match=r"normal: \(0\.0, 0\.0\) has no direction"):
        Wall((0.0, 0.0), (0.0, 0.0), SPRING)
    assert hypot(*Wall((0.0, 0.0), (3.0, 4.0), SPRING).normal) == pytest.approx(1.0)
