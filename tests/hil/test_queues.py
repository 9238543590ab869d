"""Transmit queues and arbitration: who goes first, who gives up, and where frames are refused.

Ref: ISO 11898-1:2015, 10.8 (arbitration); Bosch, CAN Specification 2.0 (1991), part B, 3.1.1; FMI-LS-BUS 1.0 (CAN,
Configuration operation: arbitration lost behaviour).
"""

from itertools import pairwise

import pytest

from hil.wire.bits import frame_bits
from hil.wire.fault import BitError
from hil.wire.frame_reader import ARBITRATION_LOST
from hil.wire.identifier import EXTENDED, REMOTE

NEVER = 10**6


class NothingVisible:
    """Makes every frame be played bit by bit, and disturbs none."""

    def flips(self, _sender, _identifier, _data):
        return {NEVER: None}


@pytest.fixture(params=[False, True], ids=["computed whole", "bit by bit"])
def bus_of(request, wire):
    """Buses whose frames are computed whole, and played bit by bit."""

    def make(names="abc"):
        bus = wire(names)
        if request.param:
            bus.kernel.medium.faults = NothingVisible()
            bus.kernel.medium.assess()
        return bus

    return make


def test_ten_frames_wait_and_the_eleventh_is_refused_and_counted(bus_of):
    bus = bus_of("ab")
    for number in range(12):
        bus.send("a", 0x200 + number)
    bus.run(5)
    assert (bus["a"].queued, bus.lost("a")) == (10, {"transmit queue full": 2})
    bus.run(1000)
    assert [frame[2] for frame in bus.frames] == [0x200 + number for number in range(10)]


def test_a_frame_on_the_wire_has_its_place_until_it_is_sent(bus_of):
    bus = bus_of("ab")
    for number in range(10):
        bus.send("a", 0x200 + number)
    end = frame_bits(0x200, b"")
    bus.send("a", 0x300, at=end - 1).send("a", 0x301, at=end + 1).run(2000)
    assert bus.lost("a") == {"transmit queue full": 1}
    assert bus.frames[-1][2] == 0x301


def test_depth_is_set_for_each_node(bus_of):
    bus = bus_of("ab").set("a", depth=1).send("a", 0x200).send("a", 0x201).send("b", 0x202).send("b", 0x203).run(900)
    assert [frame[2] for frame in bus.frames] == [0x200, 0x202, 0x203]


def test_queue_by_priority(bus_of):
    bus = bus_of("ab")
    for identifier in (0x400, 0x300, 0x100, 0x200):
        bus.send("a", identifier)
    bus.run(1000)
    assert [frame[2] for frame in bus.frames] == [0x100, 0x200, 0x300, 0x400]


def test_queue_first_in_first_out_even_against_its_own_priorities(bus_of):
    """b's frames go between: its heads against a's heads."""
    bus = bus_of("abc").set("a", fifo=True)
    for identifier in (0x400, 0x100, 0x300):
        bus.send("a", identifier)
    for identifier in (0x200, 0x500):
        bus.send("b", identifier)
    bus.run(1000)
    assert [frame[2] for frame in bus.frames] == [0x200, 0x400, 0x100, 0x300, 0x500]


def test_queue_first_in_first_out_repeats_its_head(wire):
    bus = wire("ab", [BitError(identifier=0x400, bit=20)]).set("a", fifo=True)
    bus.send("a", 0x400).send("a", 0x100).run(500)
    assert [frame[2] for frame in bus.frames] == [0x400, 0x100]
    assert bus["a"].repeated == 1


def test_equal_frames_of_a_node_keep_their_order(bus_of):
    bus = bus_of("ab")
    for number in range(5):
        bus.send("a", 0x200, bytes([number]))
    bus.run(1000)
    assert [frame[3] for frame in bus.frames] == [bytes([number]) for number in range(5)]


ORDER = [0x100, 0x100 | REMOTE, 0x100 << 18 | EXTENDED, 0x100 << 18 | EXTENDED | REMOTE, 0x100 << 18 | 1 | EXTENDED]


@pytest.mark.parametrize(("winner", "loser"), list(pairwise(ORDER)))
def test_arbitration_field_decides_and_the_loser_goes_next(bus_of, winner, loser):
    bus = bus_of().send("b", winner).send("a", loser).run(500)
    assert [frame[2] for frame in bus.frames] == [winner, loser]
    assert bus["a"].repeated == 0
    assert bus.events == []
    assert bus.got("a") == bus.ends("b")  # who lost receives


def stream(identifier):
    """SOF and arbitration field with stuff bits, by the rules."""
    extended, remote = identifier & EXTENDED != 0, str(int(identifier & REMOTE != 0))
    number = identifier & 0x1FFFFFFF
    bits = "0" + (f"{number >> 18:011b}11{number & 0x3FFFF:018b}{remote}" if extended else f"{number:011b}{remote}0")
    stuffed = ""
    for bit in bits:
        if stuffed[-5:] in ("00000", "11111"):
            stuffed += "1" if stuffed[-1] == "0" else "0"
        stuffed += bit
    return stuffed


PAIRS = [(0x100, 0x101), (0x100, 0x300), (0x000, 0x001), (0x7F0, 0x7F1), *pairwise(ORDER)]


@pytest.mark.parametrize(("winner", "loser"), PAIRS)
def test_lost_arbitration_is_told_with_its_bit_where_the_loser_gives_up(bus_of, winner, loser):
    """Counted from SOF, stuff bits included, as linux/can/error.h has it: the bit number in the bit stream."""
    bit = next(n for n, (one, other) in enumerate(zip(stream(winner), stream(loser), strict=False)) if one != other)
    bus = bus_of().set("a", discards=True).send("b", winner).send("a", loser).run(500)
    assert [frame[2] for frame in bus.frames] == [winner]
    told = [event for _, event in bus.events]
    assert [(event.name, event.port.name, event.number) for event in told] == [(ARBITRATION_LOST, "a", bit)]
    assert bus.lost("a") == {"arbitration lost": 1}
    assert (bus["a"].queued, bus["a"].sent) == (0, 0)


def test_only_the_head_is_given_up(bus_of):
    bus = bus_of().set("a", discards=True).send("b", 0x100).send("a", 0x200).send("a", 0x300).run(500)
    assert [frame[2] for frame in bus.frames] == [0x100, 0x300]
    assert bus.lost("a") == {"arbitration lost": 1}


def test_one_shot_is_lost_with_its_first_error_and_others_follow(wire):
    bus = wire("abc", [BitError(identifier=0x2AA, bit=22, at=("a",))]).set("a", one_shot=True)
    bus.send("a", 0x2AA, b"\x55\x33").send("a", 0x555).run(500)
    assert bus.frames == [(45 + 45, "a", 0x555, b"")]
    assert (bus["a"].repeated, bus["a"].queued, bus.lost("a")) == (0, 0, {"one-shot: disturbed": 1})
    assert bus.counters("a") == (7, 0)


def test_one_shot_that_loses_arbitration_waits(bus_of):
    """One shot is for disturbed frames; who gives up what loses is said by `discards`."""
    bus = bus_of().set("a", one_shot=True).send("b", 0x100).send("a", 0x200).run(500)
    assert [frame[2] for frame in bus.frames] == [0x100, 0x200]


def test_flushed_frames_are_counted_and_the_one_on_the_wire_ends(bus_of):
    bus = bus_of("ab")
    for number in range(5):
        bus.send("a", 0x200 + number)
    bus.run(20)
    bus.kernel.medium.flush(bus.ports["a"])
    bus.run(1000)
    assert [frame[2] for frame in bus.frames] == [0x200]
    assert (bus.lost("a"), bus["a"].queued) == ({"flushed": 4}, 0)
