"""Active and passive error flags, overload frames, intermission and the suspension of an error-passive sender.

Ref: ISO 11898-1:2015, 10.4.4 to 10.4.6 (error frame, overload frame, interframe space); Bosch, CAN Specification 2.0
(1991), part B, 3.1.3 to 3.1.5.
"""

import pytest

from hil.wire.bits import frame_bits
from hil.wire.fault import BitError, StuckDominant

IDENTIFIER, DATA, LENGTH = 0x2AA, b"\x55\x33", 62
"""The frame whose bits test_error_detection.py counts: stuff bits 16 and 45, data 20, CRC delimiter 52, EOF 55."""
SHORT, SHORT_LENGTH = 0x555, 45
"""A frame of lower priority, without data."""


def flip(bit, *at, identifier=IDENTIFIER, **kwargs):
    return BitError(identifier=identifier, bit=bit, at=at, **kwargs)


def kinds(bus):
    return [error[:3] for error in bus.errors]


def held(first, bits=1):
    """d holds the bus dominant for whole bits."""
    return StuckDominant(node="d", from_s=first * 1e-6, to_s=(first + bits) * 1e-6)


# -- error-passive nodes --


def test_passive_receiver_does_not_disturb_the_others(wire):
    """b's flag is recessive: a and c end their frame as if nothing were, and b has nothing."""
    bus = wire("abc", [flip(16, "b")]).set("b", rec=128).send("a", IDENTIFIER, DATA).run(200)
    assert kinds(bus) == [(17, "b", "stuff")]
    assert (bus.ends(), bus.got("b"), bus.got("c")) == ([62], [], [62])
    assert [bus.counters(name) for name in "abc"] == [(0, 0), (0, 129), (0, 0)]


def test_other_bits_of_the_frame_are_disturbed_all_the_same(wire):
    """What one passive receiver makes of its bit does not spare another its own."""
    bus = wire("abc", [flip(16, "b"), flip(57, "c")]).set("b", rec=128).send("a", IDENTIFIER, DATA).run(80)
    assert kinds(bus)[:2] == [(17, "b", "stuff"), (58, "c", "form")]


def test_passive_flag_ends_with_six_equal_bits_so_that_a_frame_close_behind_is_missed(wire):
    """Its six equal bits are 54 to 59, its delimiter is 60 to 67: the SOF in 65 is a form error there."""
    bus = wire("abc", [flip(16, "b")]).set("b", rec=128)
    bus.send("a", IDENTIFIER, DATA).send("a", SHORT).send("a", IDENTIFIER, DATA, at=200).run(400)
    assert kinds(bus) == [(17, "b", "stuff"), (66, "b", "form")]
    assert (bus.got("b"), bus.got("c")) == ([262], [62, 65 + SHORT_LENGTH, 262])


@pytest.mark.parametrize("sof", [70, 71])
def test_passive_flag_and_delimiter_end_before_a_frame_that_is_late_enough(wire, sof):
    """Delimiter 60 to 67, intermission 68 to 70; a SOF in its third bit is one."""
    bus = wire("abc", [flip(16, "b")]).set("b", rec=128)
    bus.send("a", IDENTIFIER, DATA).send("a", SHORT, at=sof).run(400)
    assert kinds(bus) == [(17, "b", "stuff")]
    assert bus.got("b") == bus.got("c")[1:] == [sof + SHORT_LENGTH]


def test_passive_receiver_in_intermission_answers_a_frame_by_an_overload_flag(wire):
    """For b bit 68 is the first of intermission; its overload flag is dominant even so, and nobody's counters move."""
    bus = wire("abc", [flip(16, "b")]).set("b", rec=128)
    bus.send("a", IDENTIFIER, DATA).send("a", SHORT, at=68).run(400)
    assert kinds(bus)[1] == (69, "b", "overload")
    assert bus.got("b") == bus.got("c")[1:]


def test_passive_sender_flags_with_recessive_bits(wire):
    """a sends 1 from 23 on: the others have their sixth equal bit in 28, one later than of an active flag."""
    bus = wire("abc", [flip(22, "a")]).set("a", tec=128).send("a", IDENTIFIER, DATA).run(54)
    assert kinds(bus) == [(23, "a", "bit"), (29, "b", "stuff"), (29, "c", "stuff")]
    # their flags 29 to 34, delimiter 35 to 42, intermission 43 to 45, suspension 46 to 53
    bus.run(300)
    assert bus.ends() == [54 + LENGTH]
    assert bus.counters("a") == (128 + 8 - 1, 0)


def test_passive_sender_is_suspended_for_eight_bits_behind_a_good_frame(wire):
    bus = wire("ab").set("a", tec=140).send("a", IDENTIFIER, DATA).send("a", SHORT).run(300)
    assert bus.ends() == [62, 62 + 3 + 8 + SHORT_LENGTH]


def test_sender_that_is_no_longer_passive_is_not_suspended(wire):
    """The good frame takes its counter to 127."""
    bus = wire("ab").set("a", tec=128).send("a", IDENTIFIER, DATA).send("a", SHORT).run(300)
    assert bus.ends() == [62, 62 + 3 + SHORT_LENGTH]


def test_passive_receiver_is_not_suspended(wire):
    bus = wire("ab").set("b", tec=140).send("a", IDENTIFIER, DATA).send("b", SHORT).run(300)
    assert bus.ends() == [62, 62 + 3 + SHORT_LENGTH]


def test_another_node_uses_the_suspension(wire):
    """What c queues goes first, though it is of lower priority; a receives it, and then is suspended no more."""
    bus = wire("abc").set("a", tec=140).send("a", IDENTIFIER, DATA).send("a", SHORT).send("c", 0x7F0).run(400)
    assert [frame[1] for frame in bus.frames] == ["a", "c", "a"]
    c_end = bus.ends()[1]
    assert bus.got("a") == [c_end]
    assert bus.ends()[2] == c_end + 3 + SHORT_LENGTH


@pytest.mark.parametrize("queued", [66, 69, 72])
def test_another_node_begins_at_once_in_the_suspension(wire, queued):
    """For everybody but a the bus is idle from 65 on."""
    bus = wire("abc").set("a", tec=140).send("a", IDENTIFIER, DATA).send("a", SHORT).send("c", 0x200, at=queued)
    bus.run(400)
    assert [frame[1] for frame in bus.frames] == ["a", "c", "a"]
    assert bus.frames[1][0] == queued + frame_bits(0x200, b"")


@pytest.mark.parametrize("queued", [66, 69, 72])
def test_another_node_begins_at_once_in_the_suspension_behind_an_error(wire, queued):
    """Bit by bit: a's flag as in the test above, the intermission ends with bit 45."""
    late = queued - 20
    bus = wire("abc", [flip(22, "a")]).set("a", tec=128).send("a", IDENTIFIER, DATA).send("c", 0x400, at=late)
    bus.run(400)
    assert [frame[1] for frame in bus.frames] == ["c", "a"]
    assert bus.frames[0][0] == late + frame_bits(0x400, b"")


# -- overload --


@pytest.mark.parametrize("bit", [62, 63])
def test_overload_frame_in_the_first_two_bits_of_intermission(wire, bit):
    """All flag for six bits from the next one on; eight of delimiter, three of intermission; nothing is counted."""
    bus = wire("abcd", [held(bit)]).send("a", IDENTIFIER, DATA).send("a", SHORT).run(300)
    assert kinds(bus) == [(bit + 1, name, "overload") for name in "abcd"]
    assert bus.ends() == [62, bit + 1 + 6 + 8 + 3 + SHORT_LENGTH]
    assert [bus.counters(name) for name in "abcd"] == [(0, 0)] * 4
    assert bus["a"].repeated == 0


def test_dominant_third_bit_of_intermission_is_a_sof(wire):
    """Who wants to send begins with the first bit of the identifier, in 65."""
    bus = wire("abcd", [held(64)]).send("a", IDENTIFIER, DATA).send("a", SHORT).send("b", 0x700).run(150)
    assert kinds(bus) == []
    assert bus.ends()[:2] == [62, 64 + SHORT_LENGTH]
    assert bus.got("c")[:2] == bus.ends()[:2]


def test_dominant_third_bit_of_intermission_without_a_sender(wire):
    """It is a SOF: 65 to 70 are six equal bits, all flag in 71 to 76."""
    bus = wire("abcd", [held(64)]).send("a", IDENTIFIER, DATA).send("a", SHORT, at=75).run(300)
    assert kinds(bus) == [(71, name, "stuff") for name in "abcd"]
    assert bus.ends() == [62, 71 + 6 + 8 + 3 + SHORT_LENGTH]


def test_dominant_bit_on_an_idle_bus_is_a_sof(wire):
    bus = wire("abcd", [held(100)]).run(200)
    assert kinds(bus) == [(107, name, "stuff") for name in "abcd"]  # 101 to 106 are six equal bits
    assert [bus.counters(name) for name in "abcd"] == [(0, 1)] * 4


@pytest.mark.parametrize("delay", range(1, 7))
def test_dominant_bit_in_an_error_delimiter_is_a_form_error(wire, delay):
    """The delimiter behind the flags 23 to 33 is 34 to 41; a new flag begins behind the dominant bit."""
    bit = 34 + delay
    bus = wire("abcd", [flip(22, "a"), held(bit)]).send("a", IDENTIFIER, DATA).run(300)
    assert kinds(bus)[4:] == [(bit + 1, name, "form") for name in "abcd"]
    assert bus.ends() == [bit + 1 + 6 + 8 + 3 + LENGTH]
    assert [bus.counters(name) for name in "abcd"] == [(15, 0), (0, 1), (0, 1), (0, 1)]


def test_dominant_last_bit_of_an_error_delimiter_is_an_overload(wire):
    """The counters do not move: bit 41 is the eighth of the delimiter."""
    bus = wire("abcd", [flip(22, "a"), held(41)]).send("a", IDENTIFIER, DATA).run(300)
    assert kinds(bus)[4:] == [(42, name, "overload") for name in "abcd"]
    assert bus.ends() == [42 + 6 + 8 + 3 + LENGTH]
    assert [bus.counters(name) for name in "abcd"] == [(7, 0), (0, 0), (0, 0), (0, 0)]


def test_dominant_last_bit_of_an_overload_delimiter_is_an_overload(wire):
    """An overload frame follows another: flags 63 to 68, delimiter 69 to 76, flags 77 to 82."""
    bus = wire("abcd", [held(62), held(76)]).send("a", IDENTIFIER, DATA).send("a", SHORT).run(300)
    assert [error[0] for error in bus.errors] == [63] * 4 + [77] * 4
    assert bus.ends() == [62, 77 + 6 + 8 + 3 + SHORT_LENGTH]
