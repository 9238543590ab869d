"""The last bits of a frame, where its sender and its receivers disagree on whether it is valid.

Ref: Bosch, CAN Specification 2.0 (1991), part B, 4 (message validation); Rufino et al., "Fault-Tolerant Broadcasts in
CAN" (FTCS 1998), 3 (inconsistent duplicates and omissions).
"""

import pytest

from hil.wire.fault import BitError, CutOff

IDENTIFIER, DATA, LENGTH = 0x2AA, b"\x55\x33", 62
LAST, LAST_BUT_ONE = -1, -2


def flip(bit, *at, **kwargs):
    return BitError(identifier=IDENTIFIER, bit=bit, at=at, **kwargs)


def test_last_but_one_bit_for_one_receiver_gives_the_others_the_frame_twice(wire):
    """b: form error in bit 60, flag 61 to 66. a: its last bit is 0, it repeats. c: valid, overload flag 62 to 67."""
    bus = wire("abc", [flip(LAST_BUT_ONE, "b")]).send("a", IDENTIFIER, DATA).run(300)
    assert bus.errors[0][:3] == (61, "b", "form")
    assert [(t, name) for t, name, *_ in bus.errors[1:]] == [(62, "a"), (62, "c")]
    assert bus.errors[2][2] == "overload"
    # delimiter 68 to 75, intermission 76 to 78
    assert (bus.ends(), bus.got("b"), bus.got("c")) == ([79 + LENGTH], [79 + LENGTH], [62, 79 + LENGTH])
    assert (bus["a"].sent, bus["a"].repeated) == (1, 1)
    assert [bus.counters(name) for name in "abc"] == [(7, 0), (0, 1 + 8 - 1), (0, 0)]


def test_last_but_one_bit_and_a_sender_that_goes_is_an_inconsistent_omission(wire):
    """a is cut off before it repeats the frame: c has it, b never."""
    script = [flip(LAST_BUT_ONE, "b"), CutOff(node="a", from_s=70e-6)]
    bus = wire("abc", script).send("a", IDENTIFIER, DATA).run(1000)
    assert (bus.got("b"), bus.got("c")) == ([], [62])
    assert (bus["a"].sent, bus["a"].queued) == (0, 1)


def test_last_but_one_bit_with_one_shot_is_an_inconsistent_omission(wire):
    bus = wire("abc", [flip(LAST_BUT_ONE, "b")]).set("a", one_shot=True).send("a", IDENTIFIER, DATA).run(1000)
    assert (bus.got("b"), bus.got("c")) == ([], [62])
    assert bus.lost("a") == {"one-shot: disturbed": 1}


def test_last_but_one_bit_for_the_sender_gives_everybody_the_frame_twice(wire):
    """a flags in 61 to 66: dominant in the last bit of EOF, which the others do not care about."""
    bus = wire("abc", [flip(LAST_BUT_ONE, "a")]).send("a", IDENTIFIER, DATA).run(300)
    assert bus.errors[0][:2] == (61, "a")
    assert [error[:3] for error in bus.errors[1:]] == [(62, "b", "overload"), (62, "c", "overload")]
    assert bus.got("b") == bus.got("c") == [62, 79 + LENGTH]
    assert bus.ends() == [79 + LENGTH]
    assert [bus.counters(name) for name in "abc"] == [(7, 0), (0, 0), (0, 0)]


def test_last_but_one_bit_for_all_receivers_gives_each_the_frame_once(wire):
    bus = wire("abc", [flip(LAST_BUT_ONE, "b", "c")]).send("a", IDENTIFIER, DATA).run(300)
    assert [error[:3] for error in bus.errors[:2]] == [(61, "b", "form"), (61, "c", "form")]
    assert bus.got("b") == bus.got("c") == bus.ends() == [79 + LENGTH]


def test_last_bit_for_a_receiver_is_an_overload(wire):
    """b has the frame; its overload flag is in 62 to 67, the others' from 63 on: a dominant bit of intermission."""
    bus = wire("abc", [flip(LAST, "b")]).send("a", IDENTIFIER, DATA).send("a", 0x555).run(300)
    assert [error[:3] for error in bus.errors] == [(62, "b", "overload"), (63, "a", "overload"), (63, "c", "overload")]
    # flags 62 to 68, delimiter 69 to 76, intermission 77 to 79
    assert bus.got("b") == bus.got("c") == bus.ends() == [62, 80 + 45]
    assert bus["a"].repeated == 0
    assert [bus.counters(name) for name in "abc"] == [(0, 0)] * 3


def test_last_bit_for_the_sender_gives_everybody_the_frame_twice(wire):
    """a's error flag in 62 to 67 looks like an overload flag to the others."""
    bus = wire("abc", [flip(LAST, "a")]).send("a", IDENTIFIER, DATA).run(300)
    assert bus.errors[0][:2] == (62, "a")
    assert [error[:3] for error in bus.errors[1:]] == [(63, "b", "overload"), (63, "c", "overload")]
    assert bus.got("b") == bus.got("c") == [62, 80 + LENGTH]
    assert bus.ends() == [80 + LENGTH]
    assert [bus.counters(name) for name in "abc"] == [(7, 0), (0, 0), (0, 0)]


def test_last_bit_for_everybody(wire):
    """The sender holds it invalid, the receivers valid: they get it twice."""
    bus = wire("abc", [flip(LAST)]).send("a", IDENTIFIER, DATA).run(300)
    assert bus.got("b") == bus.got("c") == [62, 62 + 6 + 8 + 3 + LENGTH]


@pytest.mark.parametrize("bit", [LAST_BUT_ONE, LAST])
def test_passive_sender_with_an_error_at_the_end_repeats_what_everybody_has(wire, bit):
    """Its recessive flag shows to nobody. Six equal bits, delimiter 8, intermission 3, suspension 8."""
    bus = wire("abc", [flip(bit, "a")]).set("a", tec=140).send("a", IDENTIFIER, DATA).run(300)
    again = 62 + bit + 1 + 6 + 8 + 3 + 8 + LENGTH
    assert [error[1] for error in bus.errors] == ["a"]
    assert bus.got("b") == bus.got("c") == [62, again]
    assert bus.ends() == [again]
    assert bus.counters("a") == (147, 0)


@pytest.mark.parametrize("bit", [LAST_BUT_ONE, 57])
def test_passive_receiver_with_an_error_at_the_end_misses_the_frame(wire, bit):
    bus = wire("abc", [flip(bit, "b")]).set("b", rec=300, tec=130).send("a", IDENTIFIER, DATA).run(300)
    assert (bus.ends(), bus.got("b"), bus.got("c")) == ([62], [], [62])
