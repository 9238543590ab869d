"""The plant on the bus: a wake-up a period, currents at their own instants, brakes by AccelRef and Stop."""

import random

import pytest

from dbc.compiler import load_arm
from dbc.status import Status
from plant.dead_time import DeadTime
from plant.node import Plant
from plant.parameters import DEFAULT_ARM
from plant.robot import Robot

T_NS = 1_000_000
START = (0.4, 0.9, -0.5)
CODEC = load_arm()


@pytest.fixture
def plant():
    return make_plant()


def make_plant(action_delay_ns=(0, 0, 0), payloads=(), dead_time=None):
    status = Status(CODEC, 0, 0, 5, T_NS, 160_000)
    robot = Robot(DEFAULT_ARM, START, -2 * T_NS)
    return Plant(robot, CODEC, status, T_NS, action_delay_ns, payloads, dead_time=dead_time)


def current(plant, joint, cycle, counts, at_ns, corrupt=False):
    frame = CODEC[f"Current_{joint}"]
    data = bytearray(frame.pack(counts, 0, cycle & 0xFF))
    data[0] ^= corrupt
    plant.store(frame.identifier, bytes(data), at_ns)


def accel_ref(plant, cycle, at_ns, corrupt=False):
    frame = CODEC["AccelRef"]
    data = bytearray(frame.pack(0, 0, 0, cycle & 0xFF))
    data[0] ^= corrupt
    plant.store(frame.identifier, bytes(data), at_ns)


def started(plant):
    """Carry the plant to cycle 0, brakes released."""
    assert plant.on_start(-2 * T_NS) == (0, -2 * T_NS, [])
    plant.on_timer(-2 * T_NS)
    plant.on_timer(-T_NS)
    accel_ref(plant, -1, -100_000)
    plant.on_timer(0)
    return plant


def encoders(reaction):
    return [CODEC.by_identifier[i].unpack(data) for _, i, data in reaction[2] if 0x100 < i < 0x110]


def test_it_latches_at_every_period_and_asks_for_the_next(plant):
    busy_ns, timer_ns, sends = plant.on_timer(-2 * T_NS)
    assert (busy_ns, timer_ns) == (0, -T_NS)
    assert [identifier for _, identifier, _ in sends] == [0x101, 0x102, 0x103]
    assert encoders((0, 0, sends)) == [(0, 254), (0, 254), (0, 254)]


def test_brakes_hold_until_the_cycle_after_the_first_accel_ref(plant):
    plant.on_start(-2 * T_NS)
    plant.on_timer(-2 * T_NS)
    accel_ref(plant, -1, -1_100_000, corrupt=True)
    plant.on_timer(-T_NS)
    assert (plant.robot.brake_states, plant.crc_errors, plant.rows) == (("engaged",) * 3, 1, [])
    accel_ref(plant, -1, -100_000)
    plant.on_timer(0)
    assert plant.robot.brake_states == ("released",) * 3
    assert plant.robot.q == START
    assert len(plant.rows) == 1


def test_a_current_acts_from_the_end_of_its_frame():
    """Against the robot itself, told the same by hand."""
    plant = started(make_plant())
    for joint, end_ns in ((1, 461_000), (2, 575_000), (3, 690_001)):
        current(plant, joint, 0, 1000 * joint, end_ns)
    plant.on_timer(T_NS)
    robot = Robot(DEFAULT_ARM, START, 0)
    robot.release_brakes(0)
    for joint, end_ns in ((1, 461_000), (2, 575_000), (3, 690_001)):
        robot.set_current(joint, 1000 * joint, end_ns)
    robot.advance_to(T_NS)
    assert (plant.robot.q, plant.robot.w) == (robot.q, robot.w)


def test_under_functional_it_acts_after_the_action_delay():
    late, early = started(make_plant((0, 0, 0))), started(make_plant((462_000, 577_000, 692_000)))
    for joint, at_ns in ((1, 462_000), (2, 577_000), (3, 692_000)):
        current(late, joint, 0, 500, at_ns)
        current(early, joint, 0, 500, 0)
    late.on_timer(T_NS)
    early.on_timer(T_NS)
    assert late.robot.q == early.robot.q


def test_dead_time_counts_from_the_arrival_and_may_last_for_periods():
    """Against the robot itself, told the same by hand: of three cycles' currents two are on their way at once."""
    dead_ns, arrives_ns = (0, 400_000, 2_300_000), (461_000, 700_000, 690_001)
    plant = started(make_plant(dead_time=DeadTime(dead_ns, (0, 0, 0))))
    robot = Robot(DEFAULT_ARM, START, 0)
    robot.release_brakes(0)
    for cycle in range(4):
        for joint in (1, 2, 3):
            at_ns = cycle * T_NS + arrives_ns[joint - 1]
            current(plant, joint, cycle, 300 * joint + 50 * cycle, at_ns)
            robot.set_current(joint, 300 * joint + 50 * cycle, at_ns + dead_ns[joint - 1])
        plant.on_timer((cycle + 1) * T_NS)
        robot.advance_to((cycle + 1) * T_NS)
        assert (plant.robot.q, plant.robot.w, plant.robot.current_A) == (robot.q, robot.w, robot.current_A)


def test_dead_time_adds_to_the_action_delay():
    early = started(make_plant((462_000, 577_000, 692_000), dead_time=DeadTime((30_000, 40_000, 50_000), (0, 0, 0))))
    late = started(make_plant((492_000, 617_000, 742_000)))
    for plant in (early, late):
        for joint in (1, 2, 3):
            current(plant, joint, 0, 500, 0)
        plant.on_timer(T_NS)
    assert early.robot.q == late.robot.q


def test_dead_time_makes_no_frame_late_and_forgives_none():
    counts = []
    for dead_time in (None, DeadTime((1_500_000,) * 3, (400_000,) * 3)):
        plant = started(make_plant((300_000,) * 3, dead_time=dead_time))
        for cycle in range(4):
            current(plant, 1, cycle, 500, cycle * T_NS)
            current(plant, 2, cycle, 500, cycle * T_NS + 300_001)  # overdue: behind its action delay
            current(plant, 3, cycle - 1, 500, cycle * T_NS)  # late: of the cycle before
            plant.on_timer((cycle + 1) * T_NS)
        counts.append((plant.late_currents, plant.overdue_currents, plant.missed_currents, plant.state))
    assert counts[0] == counts[1]
    assert counts[0][:2] == (3, 4)  # nobody awaits the first that is late: its cycle is before the run


def test_a_late_current_acts_when_it_comes_and_is_counted(plant):
    started(plant)
    plant.on_timer(T_NS)
    current(plant, 1, 0, 500, T_NS + 1000)
    plant.on_timer(2 * T_NS)
    assert plant.late_currents == 1
    assert sum(plant.missed_currents) == 2 + 3  # the others of cycle 0, and all of cycle 1
    assert plant.robot.current_A[0] == 500 / 2048


def test_a_missing_or_damaged_current_is_counted_and_the_last_one_held(plant):
    started(plant)
    for joint in (1, 2, 3):
        current(plant, joint, 0, 500, 500_000)
    plant.on_timer(T_NS)
    assert plant.report()["missed_currents"] == {"joint1": 0, "joint2": 0, "joint3": 0}
    current(plant, 2, 1, 700, 1_500_000, corrupt=True)
    current(plant, 3, 1, 700, 1_600_000)
    plant.on_timer(2 * T_NS)
    assert plant.report()["missed_currents"] == {"joint1": 1, "joint2": 1, "joint3": 0}
    assert plant.report()["crc_errors"] == 1
    assert [round(i * 2048) for i in plant.robot.current_A] == [500, 500, 700]


def test_stop_engages_the_brakes_after_their_delay_and_finishes(plant):
    started(plant)
    plant.store(CODEC["Stop"].identifier, b"\x02", 300_000)
    assert not plant.finished
    plant.on_timer(T_NS)
    assert plant.finished
    assert plant.robot.brake_states == ("engaging",) * 3
    accel_ref(plant, 1, 1_900_000)
    for cycle in range(2, 33):
        plant.on_timer(cycle * T_NS)
    assert plant.robot.brake_states == ("engaged",) * 3


def test_loads_are_put_on_and_taken_off_at_their_instants():
    plant = started(make_plant(payloads=[(3.0, 1_500_000), (0.0, 2_500_000)]))
    payloads = []
    for cycle in (1, 2, 3):
        plant.on_timer(cycle * T_NS)
        payloads.append(plant.rows[-1][-1])
    assert payloads == [0.0, 3.0, 0.0]


def test_the_record_names_its_columns(plant):
    started(plant)
    report = plant.report()
    assert len(report["columns"]) == len(report["rows"][0]) == 19
    assert report["rows"][0][:3] == START


def test_it_brakes_where_a_joint_gives_no_current_for_three_periods(plant):
    started(plant)
    for cycle in range(1, 4):
        for joint in (1, 3):
            current(plant, joint, cycle - 1, 100, cycle * T_NS - 300_000)
        reaction = plant.on_timer(cycle * T_NS)
    assert reaction == (0, None, [(0, CODEC["Stop"].identifier, b"\x08")])
    assert plant.robot.brake_states == ("engaging",) * 3
    assert plant.finished
    report = plant.report()
    assert report["fault"] == "no Current of joint2 for 3 periods: brakes engaged"
    assert report["braked_ns"] == 3 * T_NS
    assert len(report["rows"]) == 4


def test_a_current_that_comes_late_every_time_is_a_sign_of_life(plant):
    started(plant)
    for cycle in range(1, 8):
        for joint in (1, 2, 3):
            current(plant, joint, cycle - (2 if joint == 2 and cycle > 1 else 1), 100, cycle * T_NS - 300_000)
        plant.on_timer(cycle * T_NS)
    report = plant.report()
    assert report["fault"] == ""
    assert (report["late_currents"], report["repeated_currents"]) == (5, 1)  # the first of them is cycle 0's again
    assert report["missed_currents"] == {"joint1": 0, "joint2": 1, "joint3": 0}  # cycle 6 still waits


def test_every_current_is_counted_once_and_every_cycle_too(plant):
    """Of whatever comes, in any order: in its cycle, late, once more, or never; judged by a set of cycles."""
    chance = random.Random(7)
    started(plant)
    heard, on_time, late, again = set(), 0, 0, 0
    for period in range(300):
        at_ns = period * T_NS
        for cycle in chance.choice([[period], [period - 1], [period, period], [period - 1, period], [period - 2], []]):
            at_ns += chance.choice([0, 200_000])
            current(plant, 2, cycle, 0, at_ns)
            in_run, known = cycle >= 0, cycle in heard
            again += known or not in_run
            on_time += in_run and not known and cycle == period
            late += in_run and not known and cycle < period
            heard |= {cycle} if in_run else set()
        for joint in (1, 3):
            current(plant, joint, period, 0, at_ns)
        plant.missed_in_a_row[1] = 0  # the brakes are another test's
        plant.on_timer((period + 1) * T_NS)
    report = plant.report()
    assert (report["late_currents"], report["repeated_currents"]) == (late, again)
    assert report["missed_currents"]["joint2"] == 300 - on_time - late
    assert min(on_time, late, again, 300 - on_time - late) > 20


def test_a_current_that_ends_with_its_cycle_is_late_but_not_missing(plant):
    started(plant)
    for joint in (1, 2, 3):
        current(plant, joint, 0, 100, T_NS)
    plant.on_timer(T_NS)
    report = plant.report()
    assert (report["late_currents"], report["repeated_currents"], sum(plant.missed_currents)) == (3, 0, 0)
