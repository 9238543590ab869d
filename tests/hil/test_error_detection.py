"""Which error is detected in which bit, by whom, and when the frame is repeated: every bit time by hand.

Ref: ISO 11898-1:2015, 10.11 (error detection, error signalling); Bosch, CAN Specification 2.0 (1991), part B, 3.1.3
(error frame), 5 (coding), 6 (error handling).
"""

import pytest

from hil.wire.duration import plan_of
from hil.wire.fault import BitError

IDENTIFIER, DATA = 0x2AA, b"\x55\x33"
LEVELS = "00101010101000001010010101010011001100101111101101011111111111"
# SOF 0, ID 1, RTR 12, IDE 13, r0 14, DLC 15 (stuff bit 16), data 20, CRC 36 (stuff bit 45),
# CRC delimiter 52, ACK slot 53, ACK delimiter 54, EOF 55 to 61; intermission 62 to 64.
LENGTH = 62


def flip(bit, *at, **kwargs):
    return BitError(identifier=IDENTIFIER, bit=bit, at=at, **kwargs)


@pytest.fixture
def disturbed(wire):
    """A bus of a, b and c on which a sends this frame from bit 0 on, disturbed by a script."""

    def start(*script, bits=300):
        return wire("abc", script).send("a", IDENTIFIER, DATA).run(bits)

    return start


def kinds(bus):
    return [error[:3] for error in bus.errors]


def test_the_frame_is_the_one_that_is_counted_by_hand():
    plan = plan_of(IDENTIFIER, DATA)
    assert "".join(map(str, plan.levels)) == LEVELS
    assert [bit for bit, stuff in enumerate(plan.stuff) if stuff] == [16, 45]
    assert [plan.fields.index(name) for name in ("data", "CRC", "CRC delimiter", "EOF")] == [20, 36, 52, 55]


def test_undisturbed(disturbed):
    bus = disturbed()
    assert (bus.ends(), bus.got("b"), bus.got("c"), bus.errors) == ([62], [62], [62], [])


def test_bit_error_begins_a_flag_in_the_next_bit(disturbed):
    """a sees 1 for its 0 in bit 22 and flags in 23 to 28; for the others the sixth 0 since bit 22 is bit 27."""
    bus = disturbed(flip(22, "a"))
    assert kinds(bus) == [(23, "a", "bit"), (28, "b", "stuff"), (28, "c", "stuff")]
    # flags 23 to 33, delimiter 34 to 41, intermission 42 to 44, again from 45
    assert bus.ends() == bus.got("b") == bus.got("c") == [45 + LENGTH]
    assert [bus.counters(name) for name in "abc"] == [(8 - 1, 0), (0, 1 - 1), (0, 1 - 1)]


def test_bit_error_of_a_recessive_bit(disturbed):
    """a sees 0 for its 1 in bit 23; the true level is 1, so the others count six 0 from bit 24 to 29."""
    bus = disturbed(flip(23, "a"))
    assert kinds(bus) == [(24, "a", "bit"), (30, "b", "stuff"), (30, "c", "stuff")]
    # flags 24 to 35 (twelve, the most that flags superpose to), delimiter 36 to 43, intermission 44 to 46
    assert bus.ends() == [47 + LENGTH]


def test_bit_error_in_sof(disturbed):
    """a sends SOF and sees 1: it flags from bit 1; the others take SOF and flag for a run of six 0 (0 to 5)."""
    bus = disturbed(flip(0, "a"))
    assert kinds(bus) == [(1, "a", "bit"), (6, "b", "stuff"), (6, "c", "stuff")]
    # flags 1 to 11, delimiter 12 to 19, intermission 20 to 22
    assert bus.ends() == [23 + LENGTH]


def test_a_dominant_identifier_bit_seen_recessive_is_a_bit_error(disturbed):
    """Only a recessive bit may be overwritten in the arbitration field; bit 3 is dominant."""
    bus = disturbed(flip(3, "a"))
    assert kinds(bus)[0] == (4, "a", "bit")
    assert bus.counters("a") == (7, 0)


def test_stuff_error_of_one_receiver(disturbed):
    """Twelve dominant bits: b flags from 17, a (its 1 in bit 18) from 19, c (sixth 0 in bit 22) from 23."""
    bus = disturbed(flip(16, "b"))
    assert kinds(bus) == [(17, "b", "stuff"), (19, "a", "bit"), (23, "c", "stuff")]
    # flags 17 to 28, delimiter 29 to 36, intermission 37 to 39
    assert bus.ends() == bus.got("b") == bus.got("c") == [40 + LENGTH]
    assert [bus.counters(name) for name in "abc"] == [(7, 0), (0, 1 + 8 - 1), (0, 0)]


def test_stuff_error_in_the_crc(disturbed):
    bus = disturbed(flip(45, "b"))
    assert kinds(bus)[0] == (46, "b", "stuff")


def test_six_equal_bits_that_one_flip_makes(disturbed):
    """With bit 39 flipped b sees 1 from 38 to 43."""
    assert LEVELS[37:45] == "01011111"
    bus = disturbed(flip(39, "b"))
    assert kinds(bus)[0] == (44, "b", "stuff")


def test_form_error_in_the_crc_delimiter(disturbed):
    """b flags from 53, over the ACK slot; a and c see bit 54 dominant."""
    bus = disturbed(flip(52, "b"))
    assert kinds(bus)[0] == (53, "b", "form")
    assert [(t, name) for t, name, _ in kinds(bus)[1:]] == [(55, "a"), (55, "c")]
    # flags 53 to 60, delimiter 61 to 68, intermission 69 to 71
    assert bus.ends() == bus.got("b") == bus.got("c") == [72 + LENGTH]
    assert [bus.counters(name) for name in "abc"] == [(7, 0), (0, 8), (0, 0)]


def test_form_error_in_the_ack_delimiter(disturbed):
    """b flags from 55, the first bit of EOF; a and c from 56."""
    bus = disturbed(flip(54, "b"))
    assert kinds(bus)[0] == (55, "b", "form")
    assert [(t, name) for t, name, _ in kinds(bus)[1:]] == [(56, "a"), (56, "c")]
    # flags 55 to 61, delimiter 62 to 69, intermission 70 to 72
    assert bus.ends() == [73 + LENGTH]


@pytest.mark.parametrize("bit", range(55, 60))
def test_form_error_in_eof(disturbed, bit):
    """The others see the first bit of b's flag as a dominant bit of EOF."""
    bus = disturbed(flip(bit, "b"))
    assert kinds(bus)[0] == (bit + 1, "b", "form")
    assert [(t, name) for t, name, _ in kinds(bus)[1:]] == [(bit + 2, "a"), (bit + 2, "c")]
    # seven dominant bits, eight of delimiter, three of intermission
    assert bus.ends() == bus.got("b") == bus.got("c") == [bit + 1 + 7 + 8 + 3 + LENGTH]


@pytest.mark.parametrize("bit", [22, 37])
def test_crc_error_begins_a_flag_behind_the_ack_delimiter(disturbed, bit):
    """b does not acknowledge (c does), and flags from 55 on; the others from 56 on."""
    bus = disturbed(flip(bit, "b"))
    assert kinds(bus)[0] == (55, "b", "CRC")
    assert [(t, name) for t, name, _ in kinds(bus)[1:]] == [(56, "a"), (56, "c")]
    # flags 55 to 61, delimiter 62 to 69, intermission 70 to 72
    assert bus.ends() == bus.got("b") == bus.got("c") == [73 + LENGTH]
    assert [bus.counters(name) for name in "abc"] == [(7, 0), (0, 1 + 8 - 1), (0, 0)]


def test_ack_error_where_nobody_has_a_right_crc(disturbed):
    """a flags in 54, the ACK delimiter, so that b and c have an error before their CRC error shows, with one flag."""
    bus = disturbed(flip(22, "b", "c"))
    assert kinds(bus)[0] == (54, "a", "ACK")
    assert [(t, name) for t, name, _ in kinds(bus)[1:]] == [(55, "b"), (55, "c")]
    # flags 54 to 60, delimiter 61 to 68, intermission 69 to 71
    assert bus.ends() == [72 + LENGTH]
    assert [bus.counters(name) for name in "abc"] == [(7, 0), (0, 0), (0, 0)]


def test_ack_error_where_only_the_sender_does_not_see_it(disturbed):
    """b and c see the flag in the ACK delimiter: a form error."""
    bus = disturbed(flip(53, "a"))
    assert kinds(bus) == [(54, "a", "ACK"), (55, "b", "form"), (55, "c", "form")]
    assert bus.ends() == [72 + LENGTH]


def test_bit_error_of_a_receiver_that_sees_its_acknowledgement_recessive(disturbed):
    """The exception for the ACK slot is for a recessive bit sent; b sends a dominant one. Its flag is from 54 on."""
    bus = disturbed(flip(53, "b"))
    assert kinds(bus)[0] == (54, "b", "bit")
    assert [(t, name) for t, name, _ in kinds(bus)[1:]] == [(55, "a"), (55, "c")]
    assert bus.ends() == bus.got("b") == bus.got("c") == [72 + LENGTH]
    assert bus.counters("b") == (0, 1 + 8 - 1)


def test_a_bit_inverted_for_everybody_is_the_senders_bit_error(disturbed):
    """All see 1 in bit 22, then the flag of a: 0 from 23 on, the sixth in 28."""
    bus = disturbed(flip(22))
    assert kinds(bus) == [(23, "a", "bit"), (29, "b", "stuff"), (29, "c", "stuff")]
    # flags 23 to 34, delimiter 35 to 42, intermission 43 to 45
    assert bus.ends() == [46 + LENGTH]


@pytest.mark.parametrize(
    ("bit", "node", "field"),
    [
        (0, "a", "SOF"),
        (3, "a", "ID 28-21"),
        (9, "a", "ID 20-18"),
        (16, "b", "DLC"),
        (22, "a", "data"),
        (45, "b", "CRC"),
        (52, "b", "CRC delimiter"),
        (53, "a", "ACK slot"),
        (54, "b", "ACK delimiter"),
        (57, "b", "EOF"),
    ],
)
def test_the_field_of_an_error_is_told(disturbed, bit, node, field):
    assert disturbed(flip(bit, node)).errors[0][1::2] == (node, field)


def test_a_second_disturbance_is_a_second_repetition(disturbed):
    bus = disturbed(flip(22, "a"), flip(22, "a", occurrence=2))
    assert kinds(bus)[3] == (45 + 23, "a", "bit")
    assert bus.ends() == [90 + LENGTH]
    assert bus["a"].repeated == 2
    assert bus.counters("a") == (15, 0)
    assert (bus["a"].sent, bus["a"].queued) == (1, 0)


def test_the_repetition_arbitrates_anew(wire):
    """A frame of higher priority that has come in the meantime goes first."""
    bus = wire("abc", [flip(22, "a")]).send("a", IDENTIFIER, DATA).send("b", 0x100, at=30).run(300)
    assert [(end, sender) for end, sender, *_ in bus.frames] == [(45 + 48, "b"), (45 + 48 + 3 + 62, "a")]


def test_a_recessive_identifier_bit_seen_dominant_is_arbitration_lost_to_nobody(disturbed):
    """a reads on from bit 10, a 1, that it sees as 0; for b and c 10 to 15 are six 1, for a 16 to 21 are six 0."""
    bus = disturbed(flip(10, "a"))
    assert kinds(bus) == [(16, "b", "stuff"), (16, "c", "stuff"), (22, "a", "stuff")]
    # flags 16 to 27, delimiter 28 to 35, intermission 36 to 38
    assert bus.ends() == [39 + LENGTH]
    assert [bus.counters(name) for name in "abc"] == [(0, 1), (0, 8), (0, 8)]
    assert bus["a"].repeated == 0
