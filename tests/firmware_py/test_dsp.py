"""The DSP as a transcript of the bus, with joint CPUs to set up and a controller of the test's own."""

from math import pi

import pytest

from dbc.status import Status
from firmware_py.dsp import cpu
from firmware_py.dsp.control import position_control
from firmware_py.dsp.cpu import DSP, DSPSettings
from firmware_py.dsp.kinematics import SingularPoint, tip
from firmware_py.dsp.trajectory import Circle

T_NS = 1_000_000
RAD = 2 * pi / 819_200
ZERO_RAD = (0.4, 0.9, -0.5)
SETUP_CYCLES = 60
COMPUTE_NS = 200_000
END, NOT_READY, SINGULAR, ENCODER_LOST = 0, 3, 4, 6


class Told:
    """A controller that says what the test wants and keeps what it was asked."""

    def __init__(self, answer=(0.0, 0.0, 0.0)):
        self.answer = answer
        self.asked = []

    def step(self, cycle, q):
        self.asked.append((cycle, q))
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


class Rig:
    """Plays plant, joints and clock to one DSP."""

    def __init__(self, codec, tables, make_bench, control, cycles=1000):
        self.codec = codec
        self.control = control
        self.joints = [make_bench(n).cpu for n in (1, 2, 3)]
        settings = DSPSettings(
            joints=3,
            period_ns=T_NS,
            cycles=cycles,
            setup_cycles=SETUP_CYCLES,
            compute_ns=COMPUTE_NS,
            tables=tables,
            zero_rad=ZERO_RAD,
            rad_per_count=RAD,
            counts_per_rad_s2=128.0,
        )
        self.dsp = DSP(settings, control, codec, Status(codec, 7, 4, 5, T_NS, 160_000))
        self.timer_ns = None
        self.dead = set()
        self.lost_answers = 0
        self.cycle = -SETUP_CYCLES
        self.wishes = self.dsp.on_start(self.cycle * T_NS)[1]

    def named(self, reaction):
        """Return a reaction's frames as (name, delay, fields)."""
        return [
            (self.codec.by_identifier[number].name, delay_ns, self.codec.by_identifier[number].unpack(data))
            for delay_ns, number, data in reaction[2]
        ]

    def frame(self, name, *values, corrupt=False):
        message = self.codec[name]
        data = bytearray(message.pack(*values))
        data[0] ^= corrupt
        return message.identifier, bytes(data)

    def next(self, counts=(0, 0, 0), missing=(), corrupt=()):
        """Play one cycle; return the DSP's frames but State and Heartbeat."""
        cycle, now_ns = self.cycle, self.cycle * T_NS
        assert self.wishes == now_ns
        reaction = self.dsp.on_timer(now_ns)
        self.wishes = reaction[1]
        frames = self.named(reaction)
        self.cycle += 1
        if self.dsp.finished:
            return frames
        for n, count in enumerate(counts, start=1):
            if n in missing:
                continue
            identifier, data = self.frame(f"Encoder_{n}", count & 0xFFFF, cycle & 0xFF, corrupt=n in corrupt)
            if n not in self.dead:
                self._joint(n, identifier, data, now_ns)
            if n < 3:
                self.dsp.store(identifier, data, now_ns + 100_000 * n)
            else:
                reaction = self.dsp.on_frame(identifier, data, now_ns + 350_000)
                self.wishes = reaction[1]
                frames += self.named(reaction)
                self._deliver(reaction)
        return [frame for frame in frames if not frame[0].startswith(("State", "Heartbeat"))]

    def _joint(self, n, identifier, data, now_ns):
        """Let a joint answer; carry its acknowledgement to the DSP."""
        _, _, sends = self.joints[n - 1].on_frame(identifier, data, now_ns + 100_000 * n)
        for _, number, answer in sends:
            if number == self.codec[f"Acknowledge_{n}"].identifier:
                if self.lost_answers:
                    self.lost_answers -= 1
                else:
                    self.dsp.store(number, answer, now_ns + 800_000)

    def _deliver(self, reaction):
        for _, number, data in reaction[2]:
            for joint in self.joints:
                if number in joint.stores:
                    joint.store(number, data, 0)

    def set_up(self):
        """Play the cycles before 0; return their frames, a list a cycle."""
        return [self.next() for _ in range(-self.cycle)]


@pytest.fixture
def make_rig(codec, tables, make_bench):
    return lambda control=None, cycles=1000: Rig(codec, tables, make_bench, control or Told(), cycles)


@pytest.fixture
def rig(make_rig):
    return make_rig()


# -- set-up --


def test_filters(rig, codec):
    assert set(rig.dsp.wakes_on) == {codec["Encoder_3"].identifier, codec["Stop"].identifier}
    stored = ["Encoder_1", "Encoder_2", "Acknowledge_1", "Acknowledge_2", "Acknowledge_3"]
    assert set(rig.dsp.stores) == {codec[name].identifier for name in stored}


@pytest.mark.parametrize(("now_ns", "first_ns"), [(-60 * T_NS, -60 * T_NS), (-T_NS + 1, 0), (0, 0), (1, T_NS)])
def test_begins_at_the_next_multiple_of_the_period(rig, now_ns, first_ns):
    assert rig.dsp.on_start(now_ns) == (0, first_ns, [])


def test_sync_opens_every_cycle_of_set_up_and_run(rig):
    for cycle in range(-SETUP_CYCLES, 300):
        assert rig.next()[0] == ("Sync", 0, (cycle % 256,))


def test_computing_time_and_next_timer(rig):
    rig.set_up()
    reaction = rig.dsp.on_timer(0)
    assert reaction[:2] == (0, T_NS)
    rig.dsp.store(*rig.frame("Encoder_1", 0, 0), 0)
    rig.dsp.store(*rig.frame("Encoder_2", 0, 0), 0)
    reaction = rig.dsp.on_frame(*rig.frame("Encoder_3", 0, 0), 350_000)
    assert reaction[:2] == (COMPUTE_NS, T_NS)
    assert rig.named(reaction)[0][:2] == ("AccelRef", COMPUTE_NS)


def test_one_parameter_at_a_time_until_all_joints_are_ready(rig, tables):
    sent = [frame for frames in rig.set_up() for frame in frames if frame[0].startswith("Parameter")]
    assert [name for name, _, _ in sent] == [f"Parameter_{n}" for n in (1, 2, 3) for _ in range(6)]
    assert [fields[0] for _, _, fields in sent] == list(range(6)) * 3
    assert [tuple(joint.table) for joint in rig.joints] == list(tables)
    assert [joint.state for joint in rig.joints] == [1, 1, 1]
    assert rig.dsp.setup.complete


def test_at_most_one_parameter_a_cycle_and_none_when_complete(rig):
    for frames in rig.set_up():
        assert sum(name.startswith("Parameter") for name, _, _ in frames) <= 1
    assert [name for name, _, _ in rig.next()] == ["Sync", "AccelRef"]


@pytest.mark.parametrize("lost", [1, 2, 3])
def test_lost_acknowledgements_are_repeated_and_counted(rig, lost):
    rig.lost_answers = lost
    rig.set_up()
    assert rig.dsp.setup.complete
    assert rig.dsp.report()["repeated_parameters"] == lost


def test_first_reference_is_that_of_cycle_minus_1_and_zero(make_rig):
    rig = make_rig(Told((5.0, 6.0, 7.0)))
    by_cycle = rig.set_up()
    references = [
        (cycle, fields)
        for cycle, frames in enumerate(by_cycle, start=-SETUP_CYCLES)
        for name, _, fields in frames
        if name == "AccelRef"
    ]
    assert references == [(-1, (0, 0, 0, 255))]
    assert rig.control.asked == []
    assert ("AccelRef", COMPUTE_NS, (640, 768, 896, 0)) in rig.next()
    assert [joint.state for joint in rig.joints] == [2, 2, 2]


def test_state_goes_from_init_to_ready_to_run(rig):
    states = []
    for _ in range(SETUP_CYCLES + 2):
        rig.next()
        states.append(rig.dsp.state)
    assert states == sorted(states)
    assert set(states) == {cpu.INIT, cpu.READY, cpu.RUN}
    assert states[-3:] == [cpu.READY, cpu.RUN, cpu.RUN]


@pytest.mark.parametrize("dead", [1, 2, 3])
def test_joint_that_is_not_ready_ends_the_run_by_its_name(rig, dead):
    rig.dead = {dead}
    by_cycle = rig.set_up()
    assert by_cycle[-2][0][0] == "Sync"
    assert by_cycle[-1] == [("Stop", 0, (NOT_READY,))]
    assert rig.dsp.finished
    assert rig.dsp.state == cpu.FAULT
    assert f"joint{dead} " in rig.dsp.report()["fault"]
    assert rig.wishes is None
    assert not any(name == "AccelRef" for frames in by_cycle for name, _, _ in frames)


def test_joint_of_another_database_ends_the_set_up_at_once(rig):
    for _ in range(3):
        rig.next()
    rig.dsp.store(*rig.frame("Acknowledge_1", 0, 0, 9, 0), 0)
    identifiers = [identifier for _, identifier, _ in rig.dsp.on_timer(rig.cycle * T_NS)[2]]
    assert identifiers == [rig.codec["Stop"].identifier]
    assert "joint1 was made from version 9 of arm.dbc, the DSP from version 1" in rig.dsp.report()["fault"]


def test_acknowledgement_with_wrong_crc_is_counted(rig):
    identifier, data = rig.frame("Acknowledge_1", 0, 0, 0, 0, corrupt=True)
    rig.dsp.store(identifier, data, 0)
    assert rig.dsp.report()["crc_errors"] == 1


# -- the end --


@pytest.mark.parametrize("cycles", [1, 3, 300])
def test_stop_in_place_of_sync_k(make_rig, cycles):
    rig = make_rig(cycles=cycles)
    rig.set_up()
    for _ in range(cycles):
        assert rig.next()[0][0] == "Sync"
    assert not rig.dsp.finished
    assert rig.next() == [("Stop", 0, (END,))]
    assert rig.dsp.finished
    assert rig.wishes is None
    assert rig.dsp.report()["fault"] == ""
    assert [cycle for cycle, _ in rig.control.asked] == list(range(cycles))


def test_stop_of_another_finishes(rig):
    rig.set_up()
    assert rig.dsp.on_frame(*rig.frame("Stop", 2), 5) == (0, None, [])
    assert rig.dsp.finished


def test_singular_reference_stops_with_its_reason(make_rig):
    rig = make_rig(Told(SingularPoint("q2 = 0.0100 rad: keep away")))
    rig.set_up()
    assert rig.next() == [("Sync", 0, (0,)), ("Stop", 0, (SINGULAR,))]
    assert rig.dsp.finished
    assert rig.dsp.state == cpu.FAULT
    assert "q2 = 0.0100 rad" in rig.dsp.report()["fault"]
    assert rig.wishes is None


def test_singular_pose_of_the_real_controller_stops(make_rig):
    lengths = (0.30, 0.25, 0.15)
    path = Circle(tip(lengths, ZERO_RAD), 0.05, 1.0)
    rig = make_rig(position_control("task", path, True, ZERO_RAD, lengths, (90.0, 2000.0), 1000, T_NS))
    rig.set_up()
    moved = 0
    while not rig.dsp.finished:
        moved -= 20_000
        frames = rig.next((0, moved, 0))
    assert frames[-1] == ("Stop", 0, (SINGULAR,))
    assert "q2 = " in rig.dsp.report()["fault"]
    assert abs(ZERO_RAD[1] + moved * RAD) < 0.16


# -- counters --


@pytest.mark.parametrize("rates", [(7, -7, 0), (1304, -1304, 20_000), (32_767, -32_768, 32_767)])
def test_counters_unwrap_in_both_directions(rig, rates):
    """Angles are single precision: 2^-24 of some hundred rad."""
    rig.set_up()
    for cycle in range(200):
        rig.next(tuple(rate * cycle for rate in rates))
    for cycle, q in rig.control.asked:
        expected = [zero + rate * cycle * RAD for zero, rate in zip(ZERO_RAD, rates, strict=True)]
        assert q == pytest.approx(expected, rel=2**-24, abs=1e-9)
    assert rig.dsp.counts == [rate * 199 for rate in rates]


def test_there_and_back_is_the_same_angle(rig):
    rig.set_up()
    path = [*range(0, 200_000, 9_000), *range(200_000, -200_000, -11_000), *range(-200_000, 1, 10_000)]
    for count in path:
        rig.next((count, -count, count))
    assert rig.dsp.counts == [0, 0, 0]
    assert rig.control.asked[-1][1] == rig.control.asked[0][1]


@pytest.mark.parametrize("joint", [1, 2])
@pytest.mark.parametrize("how", ["missing", "corrupt"])
def test_missing_encoder_of_one_joint_keeps_its_angle_and_is_counted(rig, joint, how):
    rig.set_up()
    rig.next((100, 200, 300))
    before = rig.control.asked[-1][1]
    frames = rig.next((110, 210, 310), **{how: (joint,)})
    assert [name for name, _, _ in frames] == ["Sync", "AccelRef"]
    kept = rig.control.asked[-1][1]
    assert kept[joint - 1] == before[joint - 1]
    assert all(kept[other] > before[other] for other in range(3) if other != joint - 1)
    assert rig.dsp.report()["missed_encoders"] == 1
    assert rig.dsp.report()["crc_errors"] == (how == "corrupt")
    rig.next((120, 220, 320))
    assert rig.dsp.counts == [120, 220, 320]


def test_damaged_last_encoder_still_gives_a_reference(rig):
    rig.set_up()
    rig.next((0, 0, 300))
    assert [name for name, _, _ in rig.next((5, 5, 310), corrupt=(3,))] == ["Sync", "AccelRef"]
    assert rig.dsp.counts == [5, 5, 300]
    report = rig.dsp.report()
    assert (report["crc_errors"], report["missed_encoders"]) == (1, 1)


def test_missing_last_encoder_is_counted_and_the_next_cycle_goes_on(rig):
    rig.set_up()
    for _ in range(4):
        for _ in range(2):
            assert [name for name, _, _ in rig.next(missing=(3,))] == ["Sync"]
        assert [name for name, _, _ in rig.next()] == ["Sync", "AccelRef"]
    assert rig.dsp.report()["missed_encoders"] == 8
    assert not rig.dsp.finished


@pytest.mark.parametrize("before", [0, 5])
def test_last_encoder_missing_for_three_cycles_stops(rig, before):
    rig.set_up()
    for _ in range(before):
        rig.next()
    for _ in range(3):
        assert [name for name, _, _ in rig.next(missing=(3,))] == ["Sync"]
    assert rig.next() == [("Stop", 0, (ENCODER_LOST,))]
    assert rig.dsp.finished
    assert "Encoder" in rig.dsp.report()["fault"]


# -- references --


@pytest.mark.parametrize(
    ("acceleration", "raw", "saturated"),
    [
        (0.0, 0, 0),
        (1.0, 128, 0),
        (-1.0, -128, 0),
        (0.4 / 128, 0, 0),
        (0.6 / 128, 1, 0),
        (-0.6 / 128, -1, 0),
        (32767 / 128, 32767, 0),
        (-256.0, -32768, 0),
        (32767.6 / 128, 32767, 1),
        (-32768.6 / 128, -32768, 1),
        (1e9, 32767, 1),
        (-1e9, -32768, 1),
    ],
)
@pytest.mark.parametrize("joint", [0, 1, 2])
def test_reference_is_rounded_saturates_and_is_counted(make_rig, joint, acceleration, raw, saturated):
    answer = [0.0, 0.0, 0.0]
    answer[joint] = acceleration
    rig = make_rig(Told(answer))
    rig.set_up()
    (reference,) = [fields for name, _, fields in rig.next() if name == "AccelRef"]
    expected = [0, 0, 0]
    expected[joint] = raw
    assert reference == (*expected, 0)
    counted = rig.dsp.report()["saturations"]
    assert counted == {f"AccelRef joint{n}": saturated * (n == joint + 1) for n in (1, 2, 3)}


def test_reference_carries_its_cycle_past_the_wrap(rig):
    rig.set_up()
    for cycle in range(520):
        (reference,) = [fields for name, _, fields in rig.next() if name == "AccelRef"]
        assert reference[-1] == cycle % 256


def test_status_in_its_turn(rig):
    rig.set_up()
    for cycle in range(20):
        rig.dsp.on_timer(cycle * T_NS)
        for n in (1, 2):
            rig.dsp.store(*rig.frame(f"Encoder_{n}", 0, cycle), 0)
        reaction = rig.dsp.on_frame(*rig.frame("Encoder_3", 0, cycle), cycle * T_NS + 350_000)
        status = [frame for frame in rig.named(reaction) if frame[0].startswith(("State", "Heartbeat"))]
        assert len(status) == (cycle % 5 == 4)
        for name, delay_ns, fields in status:
            assert name == ("State_7", "Heartbeat_7")[cycle // 5 % 2]
            assert 350_000 + delay_ns == T_NS - 160_000
            assert (fields[0], fields[-1]) == (cpu.RUN, cycle)
