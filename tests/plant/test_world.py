"""What lies in the world: at rest, pushed, hit, grasped and dropped, against closed forms."""

from math import cos, hypot, sqrt

import pytest

from plant.contact import Compliance
from plant.kinematics import tip, tip_velocity
from plant.parameters import DEFAULT_ARM
from plant.robot import Robot
from plant.world import SLOP_M, SUBSTEP_S, Box, Payload, Wall, World

S, MS = 1_000_000_000, 1_000_000
G = 9.80665
START = (0.4, 0.9, -0.5)
SPRING = Compliance(1e4, 50.0)
FLOOR = Wall((0.0, 0.0), (0.0, 1.0), SPRING)
J = 0.5 + 1 / 3  # of the fixture one_joint, whose link is 1 m long: the tip feels J kg


def box(friction=0.4, mass_kg=2.0, position_m=(1.0, 0.05), compliance=SPRING):
    return Box(position_m, (0.1, 0.1), mass_kg, friction, compliance)


def test_a_body_falls_by_the_parabola_and_pymunk_s_known_error():
    """Positions first, then velocities: sum of v_k h = g t^2 / 2 - g t h / 2, which is 0.15 mm after 0.3 s."""
    world = World(payloads=[Payload((0.2, 0.5), 0.04, 1.5, 0.5)])
    for k in range(1, 301):
        world.advance(1e-3)
        x, y, angle = world.place("payload1", 9.0, 9.0)
        t = k * 1e-3
        assert 0.5 - y == pytest.approx(G * t * t / 2 - G * t * SUBSTEP_S / 2, abs=1e-12)
        assert (x, angle) == (0.2, 0.0)


def test_a_box_at_rest_stays_where_it_is():
    """It sinks in by pymunk's slop, and turns by nothing but rounding of where its two corners stand."""
    world = World([FLOOR], box())
    for _ in range(1000):
        world.advance(1e-3)
    x, y, angle = world.place("box", 0.0, 0.0)
    assert abs(y - 0.05) <= 2 * SLOP_M
    assert abs(x - 1.0) <= 1e-6
    assert abs(angle) <= 1e-6


@pytest.mark.parametrize("share", [0.95, 1.2])
def test_the_floor_holds_a_box_up_to_mu_times_its_weight(share):
    friction_N = 0.4 * 2.0 * G
    world = World([FLOOR], box())
    world.advance(0.1)
    start = world.place("box", 0.0, 0.0)[0]
    for _ in range(2000):
        world.push("box", 0.95, 0.0, share * friction_N, 0.0)  # low, so that it does not tip
        world.advance(SUBSTEP_S)
    moved = world.place("box", 0.0, 0.0)[0] - start
    expected = max(0.0, share - 1.0) * friction_N / 2.0 * 0.2**2 / 2
    assert moved == pytest.approx(expected, rel=2e-2, abs=1e-5)


def test_pushing_a_box_at_constant_speed_takes_mu_times_its_weight():
    """A tip that is moved at 5 cm/s feels the floor's friction through the spring, once that is compressed."""
    world, forces = World([FLOOR], box()), []
    world.advance(0.1)
    x = 0.9495
    for _ in range(10_000):
        x += 0.05 * SUBSTEP_S
        surface = world.near(x, 0.04, 1e-3).get("box")
        force = 0.0
        if surface is not None:
            gap = surface.normal_x * (x - surface.x_m) + surface.normal_y * (0.04 - surface.y_m)
            rate = surface.normal_x * (0.05 - surface.speed_x_m_s)
            force = max(0.0, -1e4 * gap - 50.0 * rate) if gap < 0.0 else 0.0
        world.push("box", x, 0.04, force, 0.0)
        world.advance(SUBSTEP_S)
        forces.append(force)
    steady = forces[-2000:]
    assert sum(steady) / len(steady) == pytest.approx(0.4 * 2.0 * G, rel=1e-3)
    assert max(steady) - min(steady) <= 0.05


def test_an_arm_that_hits_a_free_box_gives_it_what_it_loses(one_joint):
    """Elastic collision of J kg and 2 kg: v = 2 m / (m + M) V of the box, no momentum lost."""
    arm = one_joint(coulomb_Nm=(0.0,))
    world = World([], box(position_m=(1.0, 0.052), compliance=Compliance(1e4)), gravity_m_s2=0.0)
    robot = Robot(arm, (0.0,), world=world)
    robot.set_external_torque(1, 0.1 * J / 1e-3, 0)
    robot.set_external_torque(1, 0.0, MS)
    robot.advance_to(MS)
    before = robot.w[0]
    robot.advance_to(100 * MS)
    early = robot.encounter.places()["box"][1]
    robot.advance_to(150 * MS)
    speed = (robot.encounter.places()["box"][1] - early) / 0.05
    # the tip's arc and the force of the substep's end: below 1e-3 of the speed
    assert speed == pytest.approx(2 * J / (J + 2.0) * before, rel=1e-3)
    assert robot.w[0] * J + 2.0 * speed == pytest.approx(J * before, rel=1e-3)
    assert robot.encounter.touches()["box"].normal_N == 0.0


def test_a_fast_box_that_hits_an_arm_at_rest_is_seen_in_time(one_joint):
    """3 m/s are 3 mm in a period, here from 1.05 mm before the tip; the same collision from the other side."""
    arm = one_joint(coulomb_Nm=(0.0,))
    world = World([], box(position_m=(1.0, -0.10205), compliance=Compliance(1e5)), gravity_m_s2=0.0)
    world._bodies["box"].velocity = 0.0, 3.0
    robot = Robot(arm, (0.0,), world=world)
    robot.advance_to(50 * MS)
    speed = world._bodies["box"].velocity.y
    assert robot.w[0] == pytest.approx(2 * 2.0 / (J + 2.0) * 3.0, rel=2e-3)
    assert robot.w[0] * J + 2.0 * speed == pytest.approx(2.0 * 3.0, rel=2e-3)


def test_a_box_between_the_hand_and_a_wall_passes_the_push_on(one_joint):
    """20 N through 2 kg: the spring on one side, pymunk's impulses a substep on the other; it settles by 10 / s."""
    arm = one_joint(coulomb_Nm=(0.0,), viscosity_Nms=(5.0,))
    world = World(
        [Wall((0.0, 0.104), (0.0, -1.0), SPRING)],
        box(position_m=(1.0, 0.052), compliance=Compliance(1e4, 100.0)),
        gravity_m_s2=0.0,
    )
    robot = Robot(arm, (0.0,), world=world)
    robot.set_external_torque(1, 20.0, 0)
    read = []
    for k in range(1000, 1100):
        robot.advance_to(k * MS)
        read.append(robot.encounter.touches()["box"].normal_N)
    impulses = []
    world._bodies["box"].each_arbiter(lambda arbiter: impulses.append(arbiter.total_impulse.y))
    assert read[-1] == pytest.approx(20.0 / cos(robot.q[0]), abs=1e-5)
    assert -sum(impulses) / SUBSTEP_S == pytest.approx(read[-1], abs=1e-5)
    assert max(read) - min(read) <= 1e-5


def test_the_nearest_side_or_corner_is_what_the_tip_meets():
    world = World([], box())
    for (x, y), normal in (
        ((0.949, 0.05), (-1.0, 0.0)),
        ((1.0, 0.1005), (0.0, 1.0)),
        ((0.951, 0.05), (-1.0, 0.0)),
        ((0.9497, 0.1004), (-0.6, 0.8)),
    ):
        surface = world.near(x, y, 2e-3)["box"]
        assert (surface.normal_x, surface.normal_y) == pytest.approx(normal, abs=1e-9)
    assert world.near(0.9, 0.05, 2e-3) == {}
    assert world.near(0.94, 0.05, 2e-3) == {}


def grasping(at_ns, world=None):
    """The default arm, held by its brakes, over a payload without gravity around it."""
    x, y, _ = tip(DEFAULT_ARM, START)
    world = world or World(payloads=[Payload((x + 0.01, y), 0.04, 1.5, 0.5)], gravity_m_s2=0.0)
    robot = Robot(DEFAULT_ARM, START, world=world)
    robot.set_payload(0.5, 0)
    robot.grasp(1, at_ns)
    return robot


def test_a_payload_in_the_hand_is_a_point_mass_at_the_tip():
    robot, plain = grasping(10 * MS), Robot(DEFAULT_ARM, START)
    plain.set_payload(0.5, 0)
    plain.set_payload(2.0, 10 * MS)
    for each in (robot, plain):
        each.release_brakes(5 * MS)
        each.advance_to(40 * MS)
    assert (robot.q, robot.w, robot.payload_kg) == (plain.q, plain.w, 2.0)
    assert robot.encounter.places()["payload1"][:2] == tip(DEFAULT_ARM, robot.q)[:2]


def test_a_dropped_payload_leaves_with_the_hand_s_speed():
    robot = grasping(10 * MS)
    robot.release_brakes(10 * MS)
    robot.drop(1, 60 * MS)
    robot.advance_to(60 * MS)
    x, y, _ = tip(DEFAULT_ARM, robot.q)
    speed_x, speed_y, _ = tip_velocity(DEFAULT_ARM, robot.q, robot.w)
    assert hypot(speed_x, speed_y) > 0.05
    assert robot.payload_kg == 0.5
    robot.advance_to(160 * MS)
    assert robot.encounter.places()["payload1"][:2] == pytest.approx((x + 0.1 * speed_x, y + 0.1 * speed_y), abs=1e-12)


def test_a_hand_that_closes_beside_the_payload_holds_nothing():
    far = World(payloads=[Payload((0.3, 0.3), 0.04, 1.5, 0.5)], gravity_m_s2=0.0)
    robot = grasping(10 * MS, far)
    robot.drop(1, 20 * MS)
    robot.advance_to(30 * MS)
    assert (robot.missed_grasps, robot.payload_kg) == (1, 0.5)
    assert robot.encounter.places()["payload1"] == (0.3, 0.3, 0.0)


def pushing_run():
    """A third of a second in which the arm pushes a box along a floor, and off its edge."""
    x, y, _ = tip(DEFAULT_ARM, START)
    floor = Wall((0.0, y - 0.07), (0.0, 1.0), SPRING)
    world = World([floor], box(position_m=(x - 0.055, y - 0.02), compliance=Compliance(1e4, 50.0, 0.3)))
    robot = Robot(DEFAULT_ARM, START, world=world)
    robot.release_brakes(0)
    rows = []
    for k in range(300):
        for joint, counts in ((1, 5000 + 500 * (k % 7)), (2, 2200), (3, 500)):
            robot.set_current(joint, counts, k * MS + 462_000)
        robot.advance_to((k + 1) * MS)
        rows.append((robot.q, robot.w, robot.encounter.touches(), robot.encounter.places()))
    return rows


def test_the_same_run_gives_the_same_bits():
    first = pushing_run()
    between = World([FLOOR], box())
    between.advance(0.01)
    assert pushing_run() == first
    assert max(touches["box"].normal_N for _, _, touches, _ in first) > 5.0
    assert hypot(*[a - b for a, b in zip(first[-1][3]["box"], first[0][3]["box"], strict=True)]) > 1e-3


def test_reading_more_often_changes_little():
    """Stops inside a period cut the substeps elsewhere: what differs is their error, not the run."""

    def fall(every_ns):
        x, y, _ = tip(DEFAULT_ARM, START)
        robot = Robot(DEFAULT_ARM, START, world=World([Wall((x, y - 0.01), (0.0, 1.0), SPRING)]))
        robot.release_brakes(0)
        for t_ns in range(0, 200 * MS, every_ns):
            robot.advance_to(t_ns + every_ns)
        return robot

    often, seldom = fall(100_000), fall(10 * MS)
    assert often.q == pytest.approx(seldom.q, abs=1e-7)
    assert sqrt(sum(w * w for w in often.w)) == pytest.approx(sqrt(sum(w * w for w in seldom.w)), abs=1e-4)


def test_payloads_that_are_not_there_are_refused():
    with pytest.raises(ValueError, match="payload 1: the world has 0, numbered from 1"):
        Robot(DEFAULT_ARM, START).grasp(1, S)
    with pytest.raises(ValueError, match="payload 2: the world has 1, numbered from 1"):
        grasping(S).drop(2, S)
