"""The set-up protocol: one entry at a time, again when an answer is lost, complete by the CRC alone."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dbc.crc import crc16
from firmware_py.dsp.setup import CYCLES_TO_REPEAT, Setup, to_int16

TABLES = ((22938, 1478, 17616, 13, 16384), (1, -2, 3, -4, 5), (-32768, 32767, 0, -1, 1))
ENTRIES = 6


def check_of(table):
    return crc16(b"".join((value % 65536).to_bytes(2, "little") for value in table))


class Joints:
    """Three joints as the set-up sees them: they take a value and acknowledge it."""

    def __init__(self, codec):
        self.codec = codec
        self.tables = [[0] * 5 for _ in TABLES]
        self.received = []

    def answer(self, frame, table_crc=None):
        """Take a Parameter frame; return (identifier, data) of its acknowledgement."""
        identifier, data = frame
        joint = identifier - self.codec["Parameter_1"].identifier
        index, value, version = self.codec.by_identifier[identifier].unpack(data)
        self.received.append((joint, index, value, version))
        if index < 5:
            self.tables[joint][index] = value
        message = self.codec[f"Acknowledge_{joint + 1}"]
        crc = check_of(self.tables[joint]) if table_crc is None else table_crc
        return message.identifier, message.pack(index, value, version, crc)


@pytest.fixture
def joints(codec):
    return Joints(codec)


@pytest.fixture
def setup(codec):
    return Setup(codec, TABLES, version=3)


@given(st.integers(0, 65535))
def test_to_int16_is_the_signed_pattern(value):
    assert -32768 <= to_int16(value) <= 32767
    assert to_int16(value) % 65536 == value


def test_every_entry_once_in_order_when_nothing_is_lost(setup, joints):
    while not setup.complete:
        frame = setup.next_frame()
        assert frame is not None
        assert setup.next_frame() is None  # one at a time
        setup.store(*joints.answer(frame))
    expected = []
    for joint, table in enumerate(TABLES):
        values = [*table, to_int16(check_of(table))]
        expected += [(joint, index, value, 3) for index, value in enumerate(values)]
    assert joints.received == expected
    assert joints.tables == [list(table) for table in TABLES]
    assert setup.next_frame() is None
    assert setup.repeats == 0


def test_repeats_the_same_entry_after_so_many_silent_cycles(setup):
    first = setup.next_frame()
    for repeat in range(1, 4):
        assert [setup.next_frame() for _ in range(CYCLES_TO_REPEAT)] == [None] * CYCLES_TO_REPEAT
        assert setup.next_frame() == first
        assert setup.repeats == repeat


def test_answer_in_the_last_silent_cycle_is_no_repeat(setup, joints):
    """An answer that comes just before the repeat makes it needless: nothing was repeated, nothing is to be counted."""
    frame = setup.next_frame()
    for _ in range(CYCLES_TO_REPEAT):
        assert setup.next_frame() is None
    setup.store(*joints.answer(frame))
    following = setup.next_frame()
    assert following is not None
    assert following != frame
    assert setup.repeats == 0


@given(lost=st.lists(st.sampled_from(["frame", "answer", ""]), max_size=40), late=st.integers(1, 3))
def test_completes_whatever_is_lost_and_counts_each_repeat(codec, lost, late):
    setup, joints = Setup(codec, TABLES, version=3), Joints(codec)
    fates = iter(lost)
    sent, pending, cycle = [], [], 0
    while not setup.complete:
        cycle += 1
        assert cycle < 1000
        for due, answer in pending:
            if due == cycle:
                setup.store(*answer)
        frame = setup.next_frame()
        if frame is None:
            continue
        sent.append(frame)
        fate = next(fates, "")
        if fate != "frame":
            answer = joints.answer(frame)
            if fate == "":
                pending.append((cycle + late, answer))
    assert joints.tables == [list(table) for table in TABLES]
    assert setup.repeats == len(sent) - len(TABLES) * ENTRIES


def run_to_last_entry(setup, joints, joint):
    """Go on until the CRC entry of a joint is out, and return its frame."""
    while True:
        frame = setup.next_frame()
        if (setup.joint, setup.index) == (joint, ENTRIES - 1):
            return frame
        setup.store(*joints.answer(frame))


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_wrong_crc_begins_the_joints_table_again(setup, joints, joint):
    frame = run_to_last_entry(setup, joints, joint)
    setup.store(*joints.answer(frame, table_crc=check_of(TABLES[joint]) ^ 1))
    assert not setup.complete
    assert (setup.joint, setup.index) == (joint, 0)
    joints.received.clear()
    while not setup.complete:
        setup.store(*joints.answer(setup.next_frame()))
    assert [entry[:2] for entry in joints.received[:ENTRIES]] == [(joint, index) for index in range(ENTRIES)]


def test_complete_only_by_equality_of_the_last_joints_crc(setup, joints):
    frame = run_to_last_entry(setup, joints, 2)
    assert not setup.complete
    setup.store(*joints.answer(frame))
    assert setup.complete


@pytest.mark.parametrize("wrong", ["index", "value", "version", "joint", "crc8", "length"])
def test_answer_that_is_not_the_awaited_one_changes_nothing(setup, joints, codec, wrong):
    frame = setup.next_frame()
    identifier, data = joints.answer(frame)
    index, value, version, crc = codec.by_identifier[identifier].unpack(data)
    if wrong == "joint":
        identifier += 1
    index, value, version = index + (wrong == "index"), value + (wrong == "value"), version + (wrong == "version")
    data = bytearray(codec.by_identifier[identifier].pack(index, value, version, crc))
    data[0] ^= wrong == "crc8"
    setup.store(identifier, bytes(data[: 3 if wrong == "length" else None]))
    assert (setup.joint, setup.index) == (0, 0)
    assert setup.next_frame() is None
    setup.store(*joints.answer(frame))
    assert (setup.joint, setup.index) == (0, 1)


@pytest.mark.parametrize("version", [0, 2, 255])
def test_joint_of_another_database_is_refused_by_its_name_with_both_versions(setup, joints, codec, version):
    run_to_last_entry(setup, joints, 0)
    assert setup.refusal == ""
    answer = codec["Acknowledge_1"]
    setup.store(answer.identifier, answer.pack(5, 0, version, 0))
    assert setup.refusal.startswith(
        f"joint1 was made from version {version} of arm.dbc, the DSP from version 3: rebuild"
    )
    assert not setup.complete


def test_answers_after_completion_are_ignored(setup, joints):
    while not setup.complete:
        last = joints.answer(setup.next_frame())
        setup.store(*last)
    setup.store(*last)
    assert setup.complete
