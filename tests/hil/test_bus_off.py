"""Bus-off and the way back from it; a sender that nobody hears.

Ref: ISO 11898-1:2015, 12.1.4.4 (bus-off); Bosch, CAN Specification 2.0 (1991), part B, 8, rules 10 and 12, note on
start-up. The frame and its bits are those of test_error_detection.py.
"""

import pytest

from hil.wire.bits import frame_bits
from hil.wire.confinement import BUS_OFF, ERROR_ACTIVE
from hil.wire.duration import plan_of
from hil.wire.fault import BitError, StuckDominant

IDENTIFIER, DATA, LENGTH = 0x2AA, b"\x55\x33", 62
SEQUENCES = 128
NEVER = 10**6
"""A bit that no frame has: bit by bit, and yet nothing happens."""


def flip(bit, *at, identifier=IDENTIFIER, **kwargs):
    return BitError(identifier=identifier, bit=bit, at=at, **kwargs)


class NothingVisible:
    """Makes every frame be played bit by bit, and disturbs none."""

    def flips(self, _sender, _identifier, _data):
        return {NEVER: None}


def off(wire, script=(), names="abc"):
    """A bus whose a goes bus-off in bit 23: flags 29 to 34 (a's own was recessive), all recessive from 35 on."""
    return wire(names, [flip(22, "a"), *script]).set("a", tec=248).send("a", IDENTIFIER, DATA)


@pytest.fixture(params=[False, True], ids=["computed whole", "bit by bit"])
def bit_by_bit(request):
    return request.param


def played(bus, bit_by_bit):
    """Take care that everything behind the first error goes bit by bit, if it is to."""
    if bit_by_bit:
        bus.call(30, lambda: (setattr(bus.kernel.medium, "faults", NothingVisible()), bus.kernel.medium.assess()))
    return bus


# -- on an idle bus --


def test_recovery_on_an_idle_bus_takes_128_times_11_recessive_bits(wire):
    bus = off(wire).run(35 + SEQUENCES * 11 - 1)
    assert bus["a"].confinement.state == BUS_OFF
    bus.run(35 + SEQUENCES * 11)
    assert bus["a"].confinement.state == ERROR_ACTIVE
    assert bus.counters("a") == (0, 0)
    assert [state for state in bus.states if state[1] == "a"] == [(23, "a", BUS_OFF), (35 + 1408, "a", ERROR_ACTIVE)]


def test_the_frame_that_led_to_bus_off_goes_out_at_once_behind_the_recovery(wire):
    bus = off(wire).run(3000)
    assert bus.ends() == [35 + SEQUENCES * 11 + LENGTH]
    assert (bus["a"].sent, bus["a"].queued, bus["a"].repeated) == (1, 0, 1)


def test_eleven_bits_begin_anew_behind_a_dominant_bit(wire):
    """Ten recessive bits (35 to 44), then d's dominant one, which makes the others flag in 52 to 57."""
    # 45 is the third bit of intermission and so a SOF; 46 to 51 are six equal bits
    bus = off(wire, [StuckDominant(node="d", from_s=45e-6, to_s=46e-6)], "abcd").run(3000)
    assert [state[0] for state in bus.states if state[1] == "a"] == [23, 58 + SEQUENCES * 11]


def test_bus_off_node_neither_drives_nor_receives(wire):
    """Not even the acknowledgement: b, the only other one, finds none."""
    bus = off(wire, names="ab").send("b", 0x100, at=50).run(1000)
    assert bus["b"].errors["ACK"] > 5
    assert bus.ends() == bus.got("a") == []


def test_bus_off_node_receives_nothing(wire):
    bus = off(wire).send("b", 0x100, at=50).run(1000)
    assert (bus.ends(), bus.got("c"), bus.got("a")) == ([98], [98], [])


def test_bus_off_keeps_what_is_queued(wire):
    bus = off(wire).send("a", 0x300, at=500).run(3000)
    assert bus.ends() == [1443 + LENGTH, 1443 + LENGTH + 3 + frame_bits(0x300, b"")]


# -- on a busy bus --


def test_recovery_on_a_busy_bus_counts_each_gap_once(wire, bit_by_bit):
    """Error delimiter and intermission are 11 recessive bits, and so are ACK delimiter, EOF and intermission."""
    bus = played(off(wire), bit_by_bit)
    for number in range(200):
        bus.send("b", 0x300, DATA, at=46 + 60 * number)
    length = frame_bits(0x300, DATA)
    assert length + 3 > 60  # the queue is never empty
    gap_ends = [46] + [46 + (length + 3) * number for number in range(1, SEQUENCES)]
    bus["b"].depth = 200
    bus.run(gap_ends[-1] - 1)
    assert bus["a"].confinement.state == BUS_OFF
    bus.run(gap_ends[-1])
    assert bus["a"].confinement.state == ERROR_ACTIVE
    # its frame has the higher priority and takes part in the arbitration of that very bit
    bus.run(gap_ends[-1] + LENGTH)
    assert bus.frames[-1][:2] == (gap_ends[-1] + LENGTH, "a")
    assert len(bus.frames) == SEQUENCES


def test_recovery_between_frames_apart(wire, bit_by_bit):
    """32 recessive bits between two frames count twice: 8 behind the ACK slot, 3 of intermission, 21 idle."""
    bus = played(off(wire), bit_by_bit)
    length = frame_bits(0x300, DATA)
    period = length - 8 + 32
    starts = [46 + period * number for number in range(80)]
    for start in starts:
        bus.send("b", 0x300, DATA, at=start)
    # one gap of 11 bits, then two sequences in each gap of 32: 63 gaps make 127, the 64th has the last one
    bus.run(6000)
    recovered = starts[63] + length - 8 + 11
    assert [state[0] for state in bus.states if state[1] == "a"] == [23, recovered]


def test_recovery_counts_recessive_bits_under_lone_attempts(wire, bit_by_bit):
    """b alone and passive: recessive from bit 51, the last of its CRC, to the suspension: 28 bits, two sequences."""
    assert plan_of(IDENTIFIER, DATA).levels[50:53] == [0, 1, 1]
    bus = played(off(wire, names="ab").set("b", tec=140), bit_by_bit).send("b", IDENTIFIER, DATA, at=46)
    # Behind the error b's flag was passive and recessive too: recessive from bit 23 on.
    period = LENGTH - 8 + 6 + 8 + 3 + 8
    before = (46 - 23) // 11
    rounds = -(-(SEQUENCES - before) // 2)
    start = 46 + (rounds - 1) * period
    last = (SEQUENCES - before) - 2 * (rounds - 1)
    bus.run(12000)
    assert [state[0] for state in bus.states if state[1] == "a"][:2] == [23, start + 51 + 11 * last]


# -- nobody there --


def test_lone_sender_ends_at_128_and_never_goes_bus_off(wire):
    """16 attempts of 54 + 6 + 8 + 3 bits, then 8 more of suspension each."""
    bus = wire("a").send("a", IDENTIFIER, DATA)
    assert [bus.run(bits).counters("a")[0] for bits in (53, 54, 71 + 53, 71 + 54)] == [0, 8, 8, 16]
    assert bus.run(15 * 71 + 53).counters("a") == (120, 0)
    assert bus.run(15 * 71 + 54).counters("a") == (128, 0)
    assert bus.run(200_000).counters("a") == (128, 0)
    assert bus["a"].confinement.state != BUS_OFF
    first_passive = 16 * 71 + 8 + 54
    assert bus["a"].errors["ACK"] == 16 + (200_000 - first_passive) // 79 + 1


def test_lone_sender_is_heard_by_who_comes(wire):
    """b takes part behind 11 recessive bits of the suspension and what went before it."""
    bus = wire("a").send("a", IDENTIFIER, DATA).call(10_000, lambda: None).run(10_000)
    bus.join("b")
    bus.run(11_000)
    assert bus["a"].sent == 1
    assert bus.got("b") == bus.ends()
    assert bus.counters("a") == (127, 0)


LONERS = {
    "alone": ("a", {}),
    "with a listener": ("ab", {"b": {"listen_only": True}}),
    "passive": ("a", {"a": {"tec": 128}}),
    "passive by reception": ("a", {"a": {"rec": 140, "tec": 3}}),
    "passive with a listener": ("ab", {"a": {"tec": 130}, "b": {"listen_only": True}}),
    "with one that is bus-off": ("ab", {"b": {"tec": 256}}),
    "one-shot": ("a", {"a": {"one_shot": True}}),
}


@pytest.mark.parametrize("case", LONERS)
def test_lone_sender_computed_whole_is_the_same_as_bit_by_bit(wire, case):
    names, settings = LONERS[case]
    buses = []
    for forced in (False, True):
        bus = wire(names)
        for name, each in settings.items():
            bus.set(name, **each)
        bus.kernel.medium.faults = NothingVisible() if forced else None
        bus.kernel.medium.assess()
        bus.send("a", IDENTIFIER, DATA).send("a", 0x300, at=30).send("a", 0x200, DATA, at=777)
        buses.append(bus)
    whole, bits = buses
    for at in [*range(0, 3000, 1), 20_000]:
        states = []
        for bus in (whole.run(at), bits.run(at)):
            a = bus["a"]
            log = (a.repeated, a.sent, a.queued, dict(a.errors), dict(a.lost), bus.counters("a"), bus.frames)
            states.append((log, [(bus.counters(name), bus.got(name), dict(bus[name].errors)) for name in names]))
        assert states[0] == states[1], f"at bit {at}"
    events = [[(t, event.port.name, event[2:]) for t, event in bus.events] for bus in buses]
    assert events[0] == events[1]
    busy = [bus.kernel.medium.busy_ns for bus in (whole, bits)]
    assert abs(busy[0] - busy[1]) < 100_000  # one frame that is under way
