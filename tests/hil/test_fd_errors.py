"""CAN FD, extended and remote frames under error: where the data phase ends, and which error it is.

Ref: ISO 11898-1:2015, 10.4.2.6 (CRC field), 10.11 (error detection); Bosch, CAN with Flexible Data-Rate 1.0 (2012),
3.2, 6 (a fixed stuff bit that equals its predecessor is a form error; the data phase ends with the error flag).
"""

import pytest

from hil.wire.bits import frame_bits
from hil.wire.duration import duration_ns, plan_of
from hil.wire.fault import BitError
from hil.wire.identifier import BRS, ESI, EXTENDED, FD, REMOTE
from hil.wire.rates import Rates

BIT, FAST = 1000, 250
RATES = Rates(BIT, FAST)
IDENTIFIER = 0x2AA | FD | BRS
SHORT, LONG = b"\x55\x33" * 4, b"\x55\x33" * 32
ERROR_FRAME = (8 + 3) * BIT


def flip(bit, *at, identifier=IDENTIFIER):
    return BitError(identifier=identifier, bit=bit, at=at)


def starts(plan):
    """When each bit begins, in ns since SOF, and when the last one ends."""
    times = [0]
    for fast in plan.fast:
        times.append(times[-1] + (FAST if fast else BIT))
    return times


def run(wire, *script, data=SHORT, identifier=IDENTIFIER, until=2000, **tec):
    bus = wire("abc", script, bit_ns=BIT, data_bit_ns=FAST)
    for name, count in tec.items():
        bus.set(name, tec=count)
    return bus.send("a", identifier, data).run(until)


def first(bus):
    t, event = next((t, event) for t, event in bus.events if event.name == "Bus Error")
    return round(t * BIT), event.port.name, event.code


def ends(bus):
    return [round(frame[0] * BIT) for frame in bus.frames]


BIT_ERROR, STUFF_ERROR, FORM_ERROR, CRC_ERROR, ACK_ERROR = range(1, 6)


def test_the_plan_has_the_times_that_the_bus_keeps(wire):
    bus = run(wire)
    assert ends(bus) == [starts(plan_of(IDENTIFIER, SHORT))[-1]] == [duration_ns(IDENTIFIER, SHORT, RATES)]


@pytest.mark.parametrize("offset", [0, 1, 7, 30, 50])
def test_bit_error_in_the_data_phase_returns_to_the_nominal_rate_at_once(wire, offset):
    """The flag is six nominal bits from the end of that data bit; the receivers see its dominance at the data rate."""
    plan = plan_of(IDENTIFIER, SHORT)
    bit = plan.fields.index("data") + offset
    assert plan.fast[bit]
    bus = run(wire, flip(bit, "a"), until=2000)
    flag_ns = starts(plan)[bit + 1]
    assert first(bus) == (flag_ns, "a", BIT_ERROR)
    receivers = [round(t * BIT) for t, name, *_ in bus.errors[1:3]]
    # six equal data bits at most, but their flags begin with a bit of a's, at the nominal rate
    assert set(receivers) <= {flag_ns + BIT, flag_ns + 2 * BIT}
    last_flag_ends = max(receivers) + 6 * BIT
    assert ends(bus) == [last_flag_ends + ERROR_FRAME + starts(plan)[-1]]
    assert [bus.counters(name) for name in "abc"] == [(7, 0), (0, 0), (0, 0)]


@pytest.mark.parametrize(("data", "width"), [(SHORT, 17), (LONG, 21)])
def test_crc_error_of_17_and_21_bits_shows_behind_the_ack_delimiter(wire, data, width):
    plan = plan_of(IDENTIFIER, data)
    crc = [bit for bit, field in enumerate(plan.fields) if field == "CRC" and not plan.stuff[bit]]
    assert len(crc) == width
    # the last bit of the CRC: no fixed stuff bit follows it
    bus = run(wire, flip(crc[-1], "b"), data=data)
    end_ns = starts(plan)[-1]
    eof_ns = end_ns - 7 * BIT
    assert first(bus) == (eof_ns, "b", CRC_ERROR)
    # b flags from the first bit of EOF, the others from the second
    assert ends(bus) == [eof_ns + 7 * BIT + ERROR_FRAME + end_ns]
    assert bus.got("b") == bus.got("c") == [frame[0] for frame in bus.frames]
    assert bus.counters("b") == (0, 8)


def test_stuff_count_that_is_wrong_is_a_crc_error(wire):
    """The last bit of the stuff count, its parity, with the fixed stuff bit behind it made to fit."""
    plan = plan_of(IDENTIFIER, SHORT)
    parity = max(bit for bit, field in enumerate(plan.fields) if field == "SC" and not plan.stuff[bit])
    assert plan.stuff[parity + 1]
    bus = run(wire, flip(parity, "b"), flip(parity + 1, "b"))
    assert first(bus) == (starts(plan)[-1] - 7 * BIT, "b", CRC_ERROR)


def test_fixed_stuff_bit_that_equals_its_predecessor_is_a_form_error(wire):
    plan = plan_of(IDENTIFIER, SHORT)
    fixed = [bit for bit, stuff in enumerate(plan.stuff) if stuff and bit > plan.fields.index("SC")]
    for bit in fixed[:4]:
        bus = run(wire, flip(bit, "b"))
        assert first(bus) == (starts(plan)[bit + 1], "b", FORM_ERROR)


def test_receiver_error_in_the_data_phase_is_seen_by_the_sender_in_its_next_recessive_bit(wire):
    """b's dynamic stuff bit is inverted: its flag holds the bus for six nominal bits."""
    data = bytes(8)
    identifier = IDENTIFIER
    plan = plan_of(identifier, data)
    bit = next(bit for bit, stuff in enumerate(plan.stuff) if stuff and plan.fields[bit] == "data")
    bus = run(wire, flip(bit, "b"), data=data)
    assert first(bus) == (starts(plan)[bit + 1], "b", STUFF_ERROR)
    assert {error[1] for error in bus.errors} == set("abc")
    assert bus.counters("b") == (0, 1 + 8 - 1)
    assert bus.got("b") == bus.got("c") == [frame[0] for frame in bus.frames]
    assert bus["a"].sent == 1


def test_passive_receiver_does_not_disturb_a_data_phase(wire):
    """Its recessive flag neither slows the frame down nor destroys it."""
    plan = plan_of(IDENTIFIER, LONG)
    bit = plan.fields.index("data") + 10
    bus = wire("abc", [flip(bit, "b"), flip(bit + 3, "b")], bit_ns=BIT, data_bit_ns=FAST).set("b", rec=128)
    bus.send("a", IDENTIFIER, LONG).send("a", 0x555, at=1000).run(2000)
    assert ends(bus)[0] == starts(plan)[-1]
    assert (len(bus.got("b")), len(bus.got("c"))) == (1, 2)
    assert {error[1] for error in bus.errors} == {"b"}


def test_passive_sender_says_so_in_esi(wire):
    bus = run(wire, a=128)
    assert bus.frames[0][2] == IDENTIFIER | ESI
    assert bus.nodes["b"].arrivals[0][1] == IDENTIFIER | ESI
    assert ends(bus) == [starts(plan_of(IDENTIFIER | ESI, SHORT))[-1]]


def test_passive_sender_says_so_in_esi_bit_by_bit_too_until_it_is_active(wire):
    plan = plan_of(IDENTIFIER, SHORT)
    bus = wire("abc", [flip(plan.fields.index("data"), "b")], bit_ns=BIT, data_bit_ns=FAST).set("a", tec=126)
    bus.send("a", IDENTIFIER, SHORT).run(500)
    # 126 + 8 is passive: the repetition has ESI recessive
    assert bus.frames[0][2] == IDENTIFIER | ESI
    for _ in range(7):
        bus.send("a", IDENTIFIER, SHORT, at=500)
    bus.run(3000)
    assert [frame[2] for frame in bus.frames] == [IDENTIFIER | ESI] * 7 + [IDENTIFIER]
    assert [arrival[1] for arrival in bus.nodes["c"].arrivals] == [frame[2] for frame in bus.frames]


def test_fd_without_brs_stays_at_the_nominal_rate_under_error(wire):
    identifier = 0x2AA | FD
    plan = plan_of(identifier, SHORT)
    bit = plan.fields.index("data") + 2
    bus = wire("abc", [flip(bit, "a", identifier=identifier)], bit_ns=BIT, data_bit_ns=FAST)
    bus.send("a", identifier, SHORT).run(2000)
    assert first(bus) == ((bit + 1) * BIT, "a", BIT_ERROR)
    assert all(t == round(t) for t, *_ in bus.errors)
    assert bus["a"].sent == 1


def test_ack_error_of_an_fd_frame(wire):
    plan = plan_of(IDENTIFIER, SHORT)
    bus = run(wire, flip(plan.fields.index("ACK slot"), "a"))
    end_ns = starts(plan)[-1]
    assert first(bus) == (end_ns - 8 * BIT, "a", ACK_ERROR)
    # a flags over the ACK delimiter, the others from EOF on
    assert ends(bus) == [end_ns - 8 * BIT + 7 * BIT + ERROR_FRAME + end_ns]


def test_lone_sender_of_fd_frames_computed_whole_is_the_same_as_bit_by_bit(wire):
    logs = []
    for forced in (False, True):
        bus = wire("a", bit_ns=BIT, data_bit_ns=FAST)
        if forced:
            flips = type("Nothing", (), {"flips": lambda *_: {10**6: None}})()
            bus.kernel.medium.faults = flips
            bus.kernel.medium.assess()
        bus.send("a", IDENTIFIER, LONG)
        logs.append([(bus.run(at).counters("a"), bus["a"].repeated) for at in range(0, 20_000, 7)])
    assert logs[0] == logs[1]


def test_classic_frame_on_an_fd_bus_under_error(wire):
    bus = wire("abc", [flip(22, "a", identifier=0x2AA)], bit_ns=BIT, data_bit_ns=FAST)
    bus.send("a", 0x2AA, b"\x55\x33").run(300)
    assert (bus.ends(), bus.got("b")) == ([45 + 62], [45 + 62])


@pytest.mark.parametrize(
    ("identifier", "data"), [(0x2AA | REMOTE, b"\0\0"), (0x0AAAAAAA | EXTENDED, b"\x55"), (0x15555555 | EXTENDED, b"")]
)
@pytest.mark.parametrize("place", ["ID", "DLC", "CRC", "ACK delimiter", "EOF"])
def test_remote_and_extended_frames_are_repeated_as_they_are(wire, identifier, data, place):
    plan = plan_of(identifier, data)
    bit = next(i for i, field in enumerate(plan.fields) if field == place and plan.levels[i] == (place[0] in "AE"))
    bus = wire("abc", [flip(bit, "a", identifier=identifier)]).send("a", identifier, data).run(500)
    assert bus.errors[0][:2] == (bit + 1, "a")
    assert [frame[1:] for frame in bus.frames] == [("a", identifier, data)]
    assert all(bus.nodes[name].arrivals == [(bus.frames[0][0], identifier, data)] for name in "bc")


def test_extended_frame_loses_against_the_standard_one_of_its_base_identifier_under_error(wire):
    """The standard one's dominant RTR meets a recessive SRR: no error, also where both are played bit by bit."""
    extended = 0x2AA << 18 | EXTENDED
    bus = wire("abc", [flip(22, "c", identifier=0x2AA)]).send("a", extended, b"").send("b", 0x2AA, b"\x55\x33").run(500)
    assert [frame[1] for frame in bus.frames] == ["b", "a"]
    assert bus.errors[0][:3] == (55, "c", "CRC")
    assert bus.frames[1][0] == 73 + 62 + 3 + frame_bits(0x2AA << 18, b"", extended=True)
