"""The error counters, rule by rule, and the states that they make.

Ref: ISO 11898-1:2015, 12.1.4 (fault confinement); Bosch, CAN Specification 2.0 (1991), part B, 8, whose rules are
numbered here. The frame and its bits are those of test_error_detection.py.
"""

import pytest

from hil.wire.bit_level import BitLevel
from hil.wire.confinement import BUS_OFF, ERROR_ACTIVE, ERROR_PASSIVE, Confinement
from hil.wire.duration import plan_of
from hil.wire.fault import BitError, StuckDominant

IDENTIFIER, DATA, LENGTH = 0x2AA, b"\x55\x33", 62


def flip(bit, *at, identifier=IDENTIFIER, **kwargs):
    return BitError(identifier=identifier, bit=bit, at=at, **kwargs)


def held(first, bits):
    return StuckDominant(node="d", from_s=first * 1e-6, to_s=(first + bits) * 1e-6)


def of(bus, names="abc"):
    return [bus.counters(name) for name in names]


# -- rules 1 and 2: receivers --


def test_rule_1_a_receiver_that_detects_an_error_counts_one(wire):
    """b and c see a's error flag: a stuff error."""
    bus = wire("abc", [flip(22, "a")]).set("b", rec=20).send("a", IDENTIFIER, DATA).run(44)
    assert of(bus) == [(8, 0), (0, 21), (0, 1)]


def test_rule_2_a_receiver_whose_flag_was_the_first_counts_eight_more(wire):
    """c sees its flag end with everybody's, b sees a dominant bit behind its own."""
    bus = wire("abc", [flip(16, "b")]).send("a", IDENTIFIER, DATA).run(39)
    assert of(bus) == [(8, 0), (0, 9), (0, 1)]


def test_rule_2_holds_for_a_passive_flag_too(wire):
    """b is passive; its flag is the six 0 of d's stuck transceiver in 17 to 22, and bit 23 is dominant yet."""
    bus = wire("abcd", [flip(16, "b"), held(17, 40)]).set("b", rec=128).send("a", IDENTIFIER, DATA).run(23)
    assert bus.counters("b") == (0, 129)
    assert bus.run(24).counters("b") == (0, 129 + 8)


# -- rules 3 and 7: senders --


def test_rule_3_a_sender_that_flags_counts_eight_and_rule_7_takes_one_off(wire):
    bus = wire("abc", [flip(22, "a")]).set("a", tec=10).send("a", IDENTIFIER, DATA).run(44)
    assert bus.counters("a") == (18, 0)
    assert bus.run(300).counters("a") == (17, 0)


def test_rule_7_takes_one_off_for_each_frame_but_not_from_0(wire):
    bus = wire("ab").set("a", tec=2)
    for _ in range(4):
        bus.send("a", IDENTIFIER, DATA)
    assert [bus.run(bits).counters("a")[0] for bits in (61, 62, 127, 192, 257)] == [2, 1, 0, 0, 0]


def test_rule_3_exception_1_a_passive_sender_does_not_count_a_missing_acknowledgement(wire):
    bus = wire("a").set("a", tec=128).send("a", IDENTIFIER, DATA).run(5000)
    assert bus.counters("a") == (128, 0)
    assert bus["a"].errors["ACK"] > 10


def test_rule_3_exception_1_but_it_counts_if_it_sees_a_dominant_bit_in_its_flag(wire):
    """b has a CRC error: no acknowledgement in 53, and b's active flag from 55 on; a's passive flag began in 54."""
    bus = wire("ab", [flip(22, "b")]).set("a", tec=130).send("a", IDENTIFIER, DATA).run(78)
    assert bus.errors[0][:3] == (54, "a", "ACK")
    assert bus.counters("a") == (138, 0)
    # b's flag 55 to 60 is a's six equal bits; delimiter 61 to 68, intermission 69 to 71, suspension 72 to 79
    assert bus.run(300).ends() == [80 + LENGTH]


def test_rule_3_exception_1_is_for_acknowledgements_only(wire):
    """A passive sender counts a bit error, whatever it sees in its flag: bit 60 is recessive, and nobody notices."""
    bus = wire("ab", [flip(60, "a")]).set("a", tec=130).send("a", IDENTIFIER, DATA).run(70)
    assert bus.counters("a") == (138, 0)


def test_rule_3_exception_2_stuff_error_in_arbitration(wire):
    """0x100 has a recessive stuff bit in bit 9, in its identifier: a sees it dominant, flags, and does not count."""
    bus = wire("ab", [flip(9, "a", identifier=0x100)]).send("a", 0x100).run(30)
    assert bus.errors[0][:3] == (10, "a", "stuff")
    assert bus.counters("a") == (0, 0)
    assert bus["a"].repeated == 1
    # b: bit 9 is a 1, then six 0 in 10 to 15; flags 10 to 21, delimiter 22 to 29, intermission 30 to 32
    assert bus.run(300).ends() == [33 + 48]


def test_rule_3_exception_2_is_not_for_a_dominant_stuff_bit(wire):
    """0x3E0: five 1 from bit 2 on, a dominant stuff bit in 7, which a sees recessive: a bit error."""
    assert plan_of(0x3E0, b"").stuff.index(True) == 7
    assert plan_of(0x3E0, b"").levels[7] == 0
    bus = wire("ab", [flip(7, "a", identifier=0x3E0)]).send("a", 0x3E0).run(30)
    assert bus.errors[0][:3] == (8, "a", "bit")
    assert bus.counters("a") == (8, 0)


def test_rule_3_exception_2_is_not_for_a_stuff_bit_behind_arbitration(wire):
    """The stuff bit in 16 follows r0 and DLC: a bit error."""
    bus = wire("ab", [flip(16, "a")]).send("a", IDENTIFIER, DATA).run(30)
    assert bus.errors[0][:3] == (17, "a", "bit")
    assert bus.counters("a") == (8, 0)


# -- rules 4 to 6: in and behind flags --


class Few:
    """Controllers on one wire, bit by bit, of which single bits are inverted anywhere, in flags too."""

    def __init__(self, count, inverted):
        self.counters = [Confinement() for _ in range(count)]
        self.sides = [BitLevel(each) for each in self.counters]
        self.inverted = inverted
        self.driven = ["" for _ in range(count)]

    def run(self, bits):
        self.sides[0].begin(plan_of(IDENTIFIER, DATA))
        for bit in range(bits):
            levels = [side.drives for side in self.sides]
            for number, side in enumerate(self.sides):
                self.driven[number] += str(levels[number])
                side.sample(min(levels) ^ ((bit, number) in self.inverted))
        return [(each.tec, each.rec) for each in self.counters]


def test_a_flag_of_six_dominant_bits_begins_behind_the_error():
    few = Few(3, {(22, 0)})
    assert few.run(42) == [(8, 0), (0, 1), (0, 1)]
    assert few.driven[0][23:] == "000000" + 13 * "1"
    assert few.driven[1][23:] == "11111" + "000000" + 8 * "1"


def test_rule_4_a_sender_with_a_bit_error_in_its_active_flag_counts_eight_and_flags_anew():
    """The flag is 23 to 28; bit 25 is seen recessive, so another flag is 26 to 31."""
    few = Few(3, {(22, 0), (25, 0)})
    assert few.run(40) == [(16, 0), (0, 1), (0, 1)]
    assert few.driven[0][23:] == "000" + "000000" + 8 * "1"


def test_rule_5_a_receiver_with_a_bit_error_in_its_active_flag_counts_eight_but_not_one():
    """b's flag is 28 to 33; bit 30 is seen recessive, so another is 31 to 36.

    c sees bit 34 dominant, the first behind its flag; for a, whose flag was 23 to 28, 36 is the eighth dominant bit.
    """
    few = Few(3, {(22, 0), (30, 1)})
    assert few.run(44) == [(8 + 8, 0), (0, 1 + 8), (0, 1 + 8)]
    assert few.driven[1][28:] == "000" + "000000" + 7 * "1"


def test_rule_5_holds_in_an_overload_flag():
    """Bit 62 is seen dominant by b alone, in intermission; in its overload flag 63 to 68 bit 65 is seen recessive."""
    few = Few(3, {(62, 1), (65, 1)})
    few.counters[1].rec = few.counters[2].rec = 1
    few.run(64)
    assert few.counters[1].rec == 0
    few = Few(3, {(62, 1), (65, 1)})
    assert few.run(90)[1][1] >= 8


def test_rule_4_holds_in_an_overload_flag():
    """a, which sent the frame, sees bit 62 dominant, and in its overload flag 63 to 68 bit 65 recessive."""
    few = Few(3, {(62, 0), (65, 0)})
    assert few.run(80)[0] == (8, 0)
    assert few.driven[0][63:] == "000" + "000000" + 8 * "1"


def test_overload_flags_count_nothing_not_even_a_dominant_bit_behind_them():
    """b alone sees bit 62 dominant, so its overload flag is over one bit before the others': rule 2 is for errors."""
    few = Few(3, {(62, 1)})
    assert few.run(100) == [(0, 0)] * 3


@pytest.mark.parametrize(("held_bits", "eights"), [(7, 0), (8, 1), (15, 1), (16, 2), (24, 3)])
def test_rule_6_eight_dominant_bits_behind_an_active_flag_count_eight(wire, held_bits, eights):
    """All flag in 23 to 33 (a: to 28, so 29 to 33 are five of its dominant bits; b and c: to 33)."""
    bus = wire("abcd", [flip(22, "a"), held(30, 4 + held_bits)]).send("a", IDENTIFIER, DATA).run(34 + held_bits + 4)
    a_eights = (5 + held_bits) // 8
    assert bus.counters("a") == (8 + 8 * a_eights, 0)
    assert bus.counters("b") == bus.counters("c") == (0, 1 + 8 + 8 * eights)  # rule 2: bit 34 is dominant


def test_rule_6_behind_a_passive_flag(wire):
    """A passive sender's flag is 23 to 28, six equal bits; 29 to 34 are b's and c's flag, 35 and 36 are held."""
    bus = wire("abcd", [flip(22, "a"), held(30, 6)]).set("a", tec=128).send("a", IDENTIFIER, DATA).run(40)
    assert bus.counters("a") == (136, 0)  # seven dominant bits are tolerated
    bus = wire("abcd", [flip(22, "a"), held(30, 7)]).set("a", tec=128).send("a", IDENTIFIER, DATA).run(40)
    assert bus.counters("a") == (144, 0)


# -- rule 8 --


@pytest.mark.parametrize(("before", "after"), [(0, {0}), (1, {0}), (50, {49}), (127, {126}), (128, range(119, 128))])
@pytest.mark.parametrize("bit_by_bit", [False, True])
def test_rule_8_a_good_frame_takes_one_off(wire, before, after, bit_by_bit):
    script = [flip(22, "c", identifier=0x7FF)] if bit_by_bit else []
    bus = wire("abc", script).set("b", rec=before).send("a", IDENTIFIER, DATA)
    if bit_by_bit:
        bus.call(0, bus.kernel.medium.disturb)
    bus.run(62)
    assert bus.counters("b")[1] in after
    assert bus.counters("a") == (0, 0)


def test_rule_8_counts_with_the_acknowledgement_even_where_eof_is_disturbed(wire):
    """b has acknowledged (5 - 1) when it sees bit 57 dominant (+ 1) and its flag is the first (+ 8)."""
    bus = wire("abc", [flip(57, "b")]).set("b", rec=5).send("a", IDENTIFIER, DATA).run(70)
    assert bus.counters("b") == (0, 5 - 1 + 1 + 8)


def test_rule_8_does_not_hold_without_an_acknowledgement(wire):
    """b has a CRC error."""
    bus = wire("abc", [flip(22, "b")]).set("b", rec=5).send("a", IDENTIFIER, DATA).run(72)
    assert bus.counters("b") == (0, 5 + 1 + 8)


# -- rules 9 to 11: states --


def test_rule_9_the_error_that_makes_passive_is_flagged_actively(wire):
    """a reaches 128 with an active flag, in 23 to 28: b and c have their stuff error in 27, not in 28."""
    bus = wire("abc", [flip(22, "a")]).set("a", tec=120).send("a", IDENTIFIER, DATA).run(44)
    assert bus.counters("a") == (128, 0)
    assert [error[0] for error in bus.errors] == [23, 28, 28]
    assert (23, "a", ERROR_PASSIVE) in bus.states
    # passive now: intermission 42 to 44, suspension 45 to 52; then 127, and so active again
    bus.run(300)
    assert bus.ends() == [53 + LENGTH]
    assert bus.states[-1] == (53 + LENGTH, "a", ERROR_ACTIVE)


def test_rule_9_a_receiver_becomes_passive_at_128(wire):
    bus = wire("abc", [flip(22, "a")]).set("b", rec=127).send("a", IDENTIFIER, DATA).run(44)
    assert bus.counters("b") == (0, 128)
    assert (28, "b", ERROR_PASSIVE) in bus.states


@pytest.mark.parametrize("tec", [127, 128])
def test_rule_11_active_again_only_when_both_counters_are_below_128(wire, tec):
    bus = wire("ab").set("b", tec=tec, rec=128).send("a", IDENTIFIER, DATA).run(100)
    assert bus["b"].confinement.state == (ERROR_ACTIVE if tec == 127 else ERROR_PASSIVE)


@pytest.mark.parametrize("tec", [87, 88])
def test_warning_at_96(wire, tec):
    bus = wire("abc", [flip(22, "a")]).set("a", tec=tec).send("a", IDENTIFIER, DATA).run(44)
    assert bus["a"].confinement.warning == (tec == 88)
    assert [state[:2] for state in bus.states] == ([(23, "a")] if tec == 88 else [])
    assert not bus.run(300)["a"].confinement.warning


def test_warning_of_a_receiver(wire):
    bus = wire("abc", [flip(22, "a")]).set("b", rec=95).send("a", IDENTIFIER, DATA).run(44)
    assert bus["b"].confinement.warning
    assert (28, "b", ERROR_ACTIVE) in bus.states


def test_rule_10_sixteen_errors_in_a_row_make_passive_thirty_two_bus_off(wire):
    """a sees each of its frames disturbed; the period of an active sender is 45, of a passive one 54."""
    bus = wire("abc", [flip(22, "a", every=True)]).send("a", IDENTIFIER, DATA)
    passive, off = 15 * 45 + 23, (16 * 45 + 8) + 15 * 54 + 23
    bus.run(off + 100)
    mine = [(t, code) for t, name, code in bus.states if name == "a"]
    assert mine == [(11 * 45 + 23, ERROR_ACTIVE), (passive, ERROR_PASSIVE), (off, BUS_OFF)]
    assert bus["a"].repeated == 32
    assert (bus["a"].sent, bus["a"].queued) == (0, 1)


def test_a_receiver_never_goes_bus_off(wire):
    bus = wire("abc", [flip(22, "b", every=True)]).set("b", rec=1000).send("a", IDENTIFIER, DATA).run(4000)
    assert bus["b"].confinement.state == ERROR_PASSIVE
