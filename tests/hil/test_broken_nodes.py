"""Nodes that only listen, babble, hold the bus, lose their cable, or are too slow: what that does to everybody.

Ref: ISO 11898-1:2015, 10.9 (bus monitoring), 10.5 (bus integration), 12.1.4 (fault confinement); Bosch, CAN with
Flexible Data-Rate 1.0 (2012), 3.3 (integrating, bus monitoring mode). Bits as in test_error_detection.py.
"""

from itertools import pairwise

import pytest

from hil.wire.bits import frame_bits
from hil.wire.confinement import BUS_OFF, ERROR_PASSIVE
from hil.wire.events import OVERRUN
from hil.wire.fault import Babble, BitError, CutOff, Overrun, QueueDelay, StuckDominant

IDENTIFIER, DATA, LENGTH = 0x2AA, b"\x55\x33", 62


def flip(bit, *at, **kwargs):
    return BitError(identifier=IDENTIFIER, bit=bit, at=at, **kwargs)


def during(kind, node, first, last=None, **kwargs):
    """A fault from one bit time to another."""
    return kind(node=node, from_s=first * 1e-6, to_s=None if last is None else last * 1e-6, **kwargs)


# -- who only listens --


def test_listener_does_not_acknowledge(wire):
    bus = wire("ab").set("b", listen_only=True).send("a", IDENTIFIER, DATA).run(70)
    assert bus.errors[0][:3] == (54, "a", "ACK")
    assert bus.got("b") == []


def test_listener_receives_what_others_acknowledge(wire):
    bus = wire("abc").set("b", listen_only=True).send("a", IDENTIFIER, DATA).run(70)
    assert bus.got("b") == bus.got("c") == [62]


@pytest.mark.parametrize("bit", [16, 22, 52, 54, 57, -2, -1])
def test_listener_with_an_error_disturbs_nobody_and_counts_nothing(wire, bit):
    bus = wire("abc", [flip(bit, "b")]).set("b", listen_only=True).send("a", IDENTIFIER, DATA).run(200)
    assert (bus.ends(), bus.got("c")) == ([62], [62])
    assert [bus.counters(name) for name in "abc"] == [(0, 0)] * 3
    assert bus.got("b") == ([62] if bit == -1 else [])


def test_listener_follows_the_others_through_an_error_frame(wire):
    """What it would drive it takes for what it sees: it is in time for the repetition."""
    bus = wire("abc", [flip(22, "a")]).set("b", listen_only=True).send("a", IDENTIFIER, DATA).run(200)
    assert bus.got("b") == bus.got("c") == [107]
    assert bus.counters("b") == (0, 0)


def test_listener_is_in_time_behind_a_missing_acknowledgement(wire):
    """a's flag 54 to 59, b's own 55 to 60 shows only to b; the SOF in 71 is its third bit of intermission.

    c comes in the middle of the first attempt; 60 to 70 are the 11 recessive bits that it waits for.
    """
    bus = wire("ab").set("b", listen_only=True).send("a", IDENTIFIER, DATA).call(30, lambda: None).run(30)
    bus.join("c")
    bus.run(71 + LENGTH)
    assert bus.got("b") == bus.ends() == bus.got("c") == [71 + LENGTH]


def test_listener_sends_nothing_and_what_it_is_asked_to_send_is_counted(wire):
    bus = wire("abc", [during(QueueDelay, "b", 0, delay_us=50)]).send("b", 0x100).run(10)
    bus.kernel.medium.listen_only(bus.ports["b"], True)
    bus.send("b", 0x101, at=20).send("a", 0x300, at=60).run(500)
    assert [frame[1] for frame in bus.frames] == ["a"]
    assert sum(bus.lost("b").values()) == 2
    assert (bus["b"].queued, bus["b"].sent) == (0, 0)


# -- stuck dominant --


def stuck_rec(held):
    """REC of who finds the bus idle, then dominant for so many bits: stuff error in the 6th, own flag to the 12th."""
    if held < 6:
        return 1  # a SOF, and six equal bits later on
    return 1 + (8 if held > 12 else 0) + 8 * max(0, (held - 12) // 8)


@pytest.mark.parametrize("held", [6, 12, 13, 19, 20, 27, 28, 100, 200])
def test_stuck_dominant_counts_for_every_receiver(wire, held):
    """Rules 1 and 2 once, rule 6 for each eight dominant bits behind the flag; then delimiter and intermission."""
    bus = wire("abc", [during(StuckDominant, "c", 100, 100 + held)]).send("a", IDENTIFIER, DATA, at=105 + held)
    bus.run(100 + held + 8 + 1)
    assert [bus.counters(name) for name in "abc"] == [(0, stuck_rec(held))] * 3
    bus.run(1000)
    flags_end = max(100 + held, 112)
    assert bus.ends() == [flags_end + 8 + 3 + LENGTH]
    assert bus["a"].confinement.state != BUS_OFF


def test_stuck_dominant_silences_the_bus_until_it_ends(wire):
    bus = wire("abc", [during(StuckDominant, "c", 30, 5000)]).send("a", IDENTIFIER, DATA)
    for number in range(10):
        bus.send("b", 0x300 + number, at=200 * number + 100)
    bus.run(5000)
    assert bus.frames == []
    # a: bit error in 30 (its 1), flag 31 to 36, rule 6 for each eight from 37 on until bus-off
    off = 37 + 8 * ((256 - 8) // 8)
    assert [state for state in bus.states if state[2] == BUS_OFF] == [(off, "a", BUS_OFF)]
    assert bus["b"].confinement.state == ERROR_PASSIVE
    bus.run(20_000)
    # b's first frame begins behind delimiter and intermission; a comes back behind 128 times 11 recessive bits
    assert bus.frames[0][:2] == (5000 + 8 + 3 + frame_bits(0x300, b""), "b")
    assert sorted(frame[2] for frame in bus.frames) == [IDENTIFIER, *range(0x300, 0x30A)]
    assert bus["a"].confinement.tec == 0


def test_stuck_dominant_in_the_middle_of_a_frame_spares_what_is_past(wire):
    """Bit 31 of a is a 1."""
    bus = wire("abc", [during(StuckDominant, "c", 31, 32)]).send("a", IDENTIFIER, DATA).run(300)
    assert bus.errors[0][:3] == (32, "a", "bit")
    assert bus["a"].sent == 1


def test_stuck_dominant_over_dominant_bits_only_is_not_noticed(wire):
    """Bits 12 to 15 are 0."""
    bus = wire("abc", [during(StuckDominant, "c", 12, 16)]).send("a", IDENTIFIER, DATA).run(300)
    assert (bus.ends(), bus.errors) == ([62], [])


# -- a broken cable --


def test_sender_that_is_cut_off_leaves_a_torn_frame_and_tries_alone(wire):
    """From 30 on the others see 1: six equal bits in 30 to 35, or 28 to 33 where the last driven ones were 1."""
    bus = wire("abc", [during(CutOff, "a", 30)]).send("a", IDENTIFIER, DATA).send("b", 0x300, at=40).run(3000)
    assert [error[1] for error in bus.errors[:2]] == ["b", "c"]
    assert {error[2] for error in bus.errors if error[1] != "a"} == {"stuff"}
    assert [frame[1] for frame in bus.frames] == ["b"]
    assert bus["a"].errors["ACK"] > 10
    assert (bus["a"].sent, bus["a"].queued) == (0, 1)


def test_receiver_that_is_cut_off_hears_nothing_and_nobody_minds(wire):
    bus = wire("abc", [during(CutOff, "b", 30, 500)]).send("a", IDENTIFIER, DATA).send("a", 0x300, at=600).run(1000)
    assert bus.got("c") == bus.ends() == [62, 648]
    assert bus.got("b") == [648]
    assert [bus.counters(name) for name in "ac"] == [(0, 0), (0, 0)]


def test_the_only_receiver_that_is_cut_off_leaves_the_frame_unacknowledged(wire):
    bus = wire("ab", [during(CutOff, "b", 30)]).send("a", IDENTIFIER, DATA).run(70)
    assert bus.errors[0][:3] == (54, "a", "ACK")


@pytest.mark.parametrize("back", [700, 720, 750, 755, 762, 764, 765])
def test_back_in_the_middle_of_other_traffic_it_destroys_nothing(wire, back):
    """Frames from 700 on, 65 bits apart. It reads the first one that begins behind 11 recessive bits."""
    bus = wire("abc", [during(CutOff, "b", 30, back)])
    for _ in range(6):
        bus.send("a", IDENTIFIER, DATA, at=700)
    bus.send("b", 0x100, at=600).run(2000)
    assert {error[1] for error in bus.errors} <= {"b"}  # alone, before
    assert all(error[0] < back for error in bus.errors)
    starts = [700 + 65 * number for number in range(6)]
    # Recessive without a break: from the ACK delimiter, 8 bits before the end, to the next SOF.
    quiet_from = [max(start + 65 - 11, back) for start in starts]
    heard = next(start + 65 for start, quiet in zip(starts, quiet_from, strict=True) if start + 65 - quiet >= 11)
    mine = [frame for frame in bus.frames if frame[1] == "b"]
    assert mine == [(heard + frame_bits(0x100, b""), "b", 0x100, b"")]
    assert len(bus.frames) == 7
    assert bus.got("c") == bus.ends()
    assert bus.got("b") == [end for end in bus.ends("a") if end > heard]


def test_back_on_an_idle_bus_it_waits_for_eleven_bits(wire):
    bus = wire("abc", [during(CutOff, "b", 30, 500)]).send("b", IDENTIFIER, DATA, at=100)
    bus.run(500).set("b").run(1000)
    assert bus.ends() == [511 + LENGTH]


def test_back_on_an_idle_bus_it_does_not_acknowledge_before(wire):
    """a's frame begins 5 bits behind b's return: it has no other receiver, and b is not in time for it."""
    bus = wire("ab", [during(CutOff, "b", 30, 500)]).send("a", IDENTIFIER, DATA, at=505).run(1000)
    assert bus.errors[0][:3] == (505 + 54, "a", "ACK")
    assert bus.ends() == bus.got("b") == [505 + 71 + LENGTH]


def test_back_in_fd_traffic_it_does_not_slow_it_down(wire):
    identifier = 0x2AA | 1 << 32 | 1 << 33
    ends = []
    for script in ([], [during(CutOff, "b", 10, 70)]):
        bus = wire("abc", script, data_bit_ns=125).send("a", identifier, bytes(64)).send("a", identifier, bytes(64))
        ends.append(bus.run(2000).ends())
        assert bus.got("c") == ends[-1]
    assert ends[0] == ends[1]
    assert bus.got("b") == ends[0][1:]


def test_who_joins_in_the_middle_of_a_frame_does_not_get_it(wire):
    bus = wire("ab").send("a", IDENTIFIER, DATA).send("a", 0x300).run(30)
    bus.join("c")
    bus.run(500)
    assert bus.got("c") == bus.ends()[1:]
    assert bus.got("b") == bus.ends() == [62, 113]


# -- too slow, too fast --


def test_receive_overrun_is_counted_and_told(wire):
    bus = wire("ab", [during(Overrun, "b", 0, 100)])
    for at in (0, 65, 200):
        bus.send("a", IDENTIFIER, DATA, at=at)
    bus.run(500)
    assert bus.lost("b") == {"receive overrun": 1}
    assert [(t, e.port.name) for t, e in bus.events if e.name == OVERRUN] == [(62, "b")]
    assert bus.got("b") == [127, 262]
    assert bus.counters("a") == (0, 0)  # its controller acknowledges all the same


def test_receive_queue_has_its_depth(wire):
    """A node that computes takes nothing out: the controller keeps 64 frames, and loses the others."""
    bus = wire("ab").call(0, lambda: setattr(bus.ports["b"], "busy_until_ns", 10_000_000))
    bus["a"].depth = 100
    for _ in range(70):
        bus.send("a", IDENTIFIER, DATA)
    bus.run(9000)
    assert bus["b"].lost["receive overrun"] == 6
    assert bus.got("b") == []
    assert len(bus.run(11_000).got("b")) == 64


def test_babbling_node_starves_the_others_of_lower_priority_only(wire):
    """Identifier 0 without a pause from 1000 to 3000: nobody but a still higher priority could come between."""
    bus = wire("abc", [during(Babble, "c", 1000, 3000, identifier=0x100)])
    bus.send("a", 0x300, at=1010).send("b", 0x080, at=1500).run(4000)
    babble = [frame for frame in bus.frames if frame[1] == "c"]
    length = frame_bits(0x100, b"")
    assert babble[0][0] == 1000 + length
    assert [frame[1] for frame in bus.frames if frame[1] != "c"] == ["b", "a"]
    other = frame_bits(0x080, b"") + 3
    gaps = {second[0] - first[0] for first, second in pairwise(babble)}
    assert gaps == {length + 3, length + 3 + other}
    a_end = bus.ends("a")[0]
    assert 3000 < a_end <= 3000 + 2 * (length + 3) + frame_bits(0x300, b"")
    assert bus["c"].queued == 0


def test_queue_delay_is_added_in_front_of_arbitration(wire):
    bus = wire("ab", [during(QueueDelay, "a", 100, 200, delay_us=50)])
    bus.send("a", 0x300, at=0).send("a", 0x300, at=150).send("b", 0x400, at=190).send("a", 0x300, at=400).run(1000)
    length = frame_bits(0x300, b"")
    b_end = 190 + frame_bits(0x400, b"")
    assert bus.frames[0][:2] == (length, "a")
    assert [frame[:2] for frame in bus.frames[1:3]] == [(b_end, "b"), (b_end + 3 + length, "a")]
    assert bus.frames[3][:2] == (400 + length, "a")


def test_frames_that_wait_longer_keep_their_order(wire):
    bus = wire("ab", [during(QueueDelay, "a", 0, 100, delay_us=50)]).set("a", fifo=True)
    for number in range(5):
        bus.send("a", 0x300 - number, at=number)
    bus.run(1000)
    assert [frame[2] for frame in bus.frames] == [0x300 - number for number in range(5)]
    assert bus["a"].queued == 0
