"""Frames bit by bit, and their lengths, against frames written as strings and frames recorded on a real bus.

The model here shares nothing with the code: bits are characters, stuffing is a search for 00000 or 11111, a CRC
is the remainder of a long division of integers.
"""

import random
import re
from pathlib import Path
from typing import NamedTuple

import pytest

from hil.wire.bits import frame_bits
from hil.wire.fd_bits import fd_frame_bits
from hil.wire.frame_plan import crc17, crc21, frame_plan

SEED = 20240917
FRAMES_OF_EACH_KIND = 100_000
PLANS_OF_EACH_KIND = 3_000
LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
RECORDED = Path(__file__).with_name("recorded_frames.txt")


class Frame(NamedTuple):
    """Arguments of `frame_plan`."""

    identifier: int
    data: bytes
    extended: bool = False
    remote: bool = False
    fd: bool = False
    brs: bool = False
    esi: bool = False
    dlc: int | None = None


class Naive(NamedTuple):
    """A frame as a string; where its stuff bits are; the lengths up to the end of RTR or RRS and of BRS; its fields."""

    wire: str
    stuff: list[int]
    arbitration_end: int
    brs_end: int
    fields: list[tuple[str, int]]


FIVE_EQUAL = re.compile("00000|11111")


def stuffed(bits, at_end=True):
    """Return the bits with the opposite behind each five equal ones, and where; `at_end`: behind the last one too."""
    positions, start = [], 0
    while hit := FIVE_EQUAL.search(bits, start):
        start = hit.end()
        if start == len(bits) and not at_end:
            break
        positions.append(start)
        bits = bits[:start] + ("1" if bits[start - 1] == "0" else "0") + bits[start:]
    return bits, positions


def remainder(bits, generator, start=0):
    """Return what is left of the bits, `start` added to the first of them, divided by the generator."""
    width = generator.bit_length() - 1
    rest = int(bits, 2) << width ^ start << len(bits)
    while rest.bit_length() > width:
        rest ^= generator << rest.bit_length() - width - 1
    return f"{rest:0{width}b}"


def header(frame):
    """Return SOF to DLC as pairs of a name and its bits."""
    number = f"{frame.identifier:029b}" if frame.extended else f"{frame.identifier:011b}"
    request = ("RRS", "0") if frame.fd else ("RTR", str(int(frame.remote)))
    parts = [("SOF", "0"), ("ID", number[:11])]
    if frame.extended:
        parts += [("SRR", "1"), ("IDE", "1"), ("ID", number[11:]), request]
    else:
        parts += [request, ("IDE", "0")]
    if frame.fd:
        parts += [("FDF", "1"), ("res", "0"), ("BRS", str(int(frame.brs))), ("ESI", str(int(frame.esi)))]
        return [*parts, ("DLC", f"{LENGTHS.index(len(frame.data)):04b}")]
    parts += [("r1", "0"), ("r0", "0")] if frame.extended else [("r0", "0")]
    return [*parts, ("DLC", f"{len(frame.data) if frame.dlc is None else frame.dlc:04b}")]


def naive_classic(frame):
    parts = [*header(frame), ("data", "".join(f"{byte:08b}" for byte in frame.data))]
    covered = "".join(bits for _, bits in parts)
    parts.append(("CRC", remainder(covered, 0b1100010110011001)))
    wire, stuff = stuffed("".join(bits for _, bits in parts))
    return parts, wire, stuff


def naive_fd(frame):
    parts = [*header(frame), ("data", "".join(f"{byte:08b}" for byte in frame.data))]
    wire, stuff = stuffed("".join(bits for _, bits in parts), at_end=False)
    # Number of dynamic stuff bits modulo 8, in Gray code, and the parity (ISO 11898-1:2015, 10.4.2.6)
    count = ("0000", "0011", "0110", "0101", "1100", "1111", "1010", "1001")[len(stuff) % 8]
    if len(frame.data) <= 16:
        crc = remainder(wire + count, 0b110110100001011011, 1 << 16)
    else:
        crc = remainder(wire + count, 0b1100000010100010011001, 1 << 20)
    field = count + crc
    for four in (field[k : k + 4] for k in range(0, len(field), 4)):
        stuff.append(len(wire))
        wire += ("0" if wire[-1] == "1" else "1") + four
    return [*parts, ("SC", count), ("CRC", crc)], wire, stuff


def naive_wire(frame):
    """Return the parts, the whole frame, ACK recessive as its sender sends it, and where its stuff bits are."""
    parts, wire, stuff = (naive_fd if frame.fd else naive_classic)(frame)
    return parts, wire + "1" * 10, stuff


def naive_end(parts, name):
    """Return the length up to the end of a field. A stuff bit right behind it belongs to what follows."""
    names = [each for each, _ in parts]
    bits = "".join(bits for _, bits in parts[: names.index(name) + 1])
    return len(stuffed(bits, at_end=False)[0])


def naive(frame):
    """Return the frame with all that a plan says of it."""
    parts, wire, stuff = naive_wire(frame)
    request = "RRS" if frame.fd else "RTR"
    ends = [naive_end(parts, name) for name in (request, "BRS" if frame.fd else request)]
    trailer = [("CRC delimiter", 1), ("ACK slot", 1), ("ACK delimiter", 1), ("EOF", 7)]
    return Naive(wire, stuff, *ends, [(name, len(bits)) for name, bits in parts] + trailer)


KINDS = {
    "classic standard data": (False, False, False),
    "classic extended data": (True, False, False),
    "classic standard remote": (False, True, False),
    "classic extended remote": (True, True, False),
    "FD standard": (False, False, True),
    "FD extended": (True, False, True),
}
RUNS = [b"\x00", b"\xff", b"\x1f", b"\xf8", b"\x07\xc1\xf0\x7c\x1f", b"\x0f", b"\x78", b"\xe1\xc3\x87\x0f\x1e\x3c"]
"""Bytes that stuff heavily, at every place of a byte."""


def random_data(source, length):
    """Return random bytes, runs, or random bytes that end in a run."""
    data = source.randbytes(length)
    choice = source.randrange(4)
    if choice == 0:
        return data
    run = (source.choice(RUNS) * 64)[:length]
    return run if choice == 1 else data[: length // 2] + run[length // 2 :]


def random_frame(source, extended, remote, fd):
    identifier = source.getrandbits(29 if extended else 11) & source.choice([-1, -1, -32, 0x1F, 0])
    if source.randrange(4) == 0:
        identifier ^= 0x1FFFFFFF if extended else 0x7FF
    if fd:
        data = random_data(source, source.choice(LENGTHS))
        return Frame(identifier, data, extended, False, True, source.random() < 0.5, source.random() < 0.5)
    if remote:
        return Frame(identifier, b"", extended, True, dlc=source.randrange(16))
    data = random_data(source, source.randrange(9))
    dlc = source.randrange(8, 16) if len(data) == 8 and source.random() < 0.2 else None
    return Frame(identifier, data, extended, dlc=dlc)


def random_frames(kind, number):
    source = random.Random(f"{SEED} {kind}")
    return (random_frame(source, *KINDS[kind]) for _ in range(number))


@pytest.mark.parametrize("kind", KINDS)
def test_lengths_equal_those_of_naive_frames(kind):
    for number, frame in enumerate(random_frames(kind, FRAMES_OF_EACH_KIND)):
        parts, wire, _ = naive_wire(frame)
        total = len(wire)
        if not frame.fd:
            bits = frame_bits(frame.identifier, frame.data, frame.extended, frame.remote, frame.dlc)
            assert bits == total, f"SEED={SEED}, {kind} {number}: {frame}"
            continue
        # BRS is the last nominal bit; ACK slot, ACK delimiter and EOF are nominal again.
        slow = naive_end(parts, "BRS") + 9 if frame.brs else total
        bits = fd_frame_bits(frame.identifier, frame.data, frame.extended, frame.brs, frame.esi)
        assert bits == (slow, total - slow), f"SEED={SEED}, {kind} {number}: {frame}"


@pytest.mark.parametrize("kind", KINDS)
def test_plans_equal_naive_frames(kind):
    for number, frame in enumerate(random_frames(kind, PLANS_OF_EACH_KIND)):
        assert_plan(frame, f"SEED={SEED}, {kind} {number}: {frame}")


@pytest.mark.parametrize("extended", [False, True])
@pytest.mark.parametrize("length", LENGTHS)
def test_plans_equal_naive_frames_at_each_length(extended, length):
    for identifier in (0x000, 0x7FF, 0x555) + ((0x1FFFFFFF, 0x15555555) if extended else ()):
        for byte in (0x00, 0xFF, 0x1F, 0x55):
            for brs, esi in ((False, False), (False, True), (True, False), (True, True)):
                assert_plan(Frame(identifier, bytes([byte]) * length, extended, False, True, brs, esi))
            if length <= 8:
                assert_plan(Frame(identifier, bytes([byte]) * length, extended))
        assert_plan(Frame(identifier, b"", extended, remote=True, dlc=min(length, 15)))


def assert_plan(frame, reproduce=""):
    """Compare a plan with the naive frame in each of its parts."""
    plan, expected = frame_plan(*frame), naive(frame)
    total = len(expected.wire)
    fields = [name for name, width in expected.fields for _ in range(width)]
    for position in expected.stuff:
        fields.insert(position, fields[position - 1])
    fast = range(expected.brs_end, total - 9) if frame.brs else range(0)
    assert "".join(map(str, plan.levels)) == expected.wire, reproduce
    assert [k for k, stuff in enumerate(plan.stuff) if stuff] == expected.stuff, reproduce
    assert [k for k, data_bit in enumerate(plan.fast) if data_bit] == list(fast), reproduce
    assert plan.fields == fields, reproduce
    assert plan.arbitration_end == expected.arbitration_end, reproduce
    assert len(plan.levels) == len(plan.stuff) == len(plan.fast) == total, reproduce


def recorded_frames():
    """Return (frame, wire up to the ACK slot, its duration in 10 ns) for each line."""
    for line in RECORDED.read_text().splitlines():
        if line and not line.startswith("#"):
            kind, identifier, data, bits, wire, duration = line.split()
            frame = Frame(
                int(identifier, 16),
                bytes.fromhex(data.strip("-")),
                extended="extended" in kind,
                remote="remote" in kind,
                fd="FD" in kind,
                brs="BRS" in kind,
            )
            yield frame, f"{int(wire, 16):0{bits}b}", int(duration)


@pytest.mark.parametrize(("frame", "wire", "duration"), list(recorded_frames()))
def test_plan_equals_a_frame_recorded_on_a_real_bus(frame, wire, duration):
    """Bits last 200 or 50 samples of 10 ns; the ACK of another node comes 10 to 12 samples behind the CRC delimiter."""
    plan = frame_plan(*frame)
    before_ack = plan.fields.index("ACK slot")
    assert "".join(map(str, plan.levels[:before_ack])) == wire
    assert sum(50 if fast else 200 for fast in plan.fast[:before_ack]) == pytest.approx(duration - 11, abs=1)


# CRC-17/CAN-FD and CRC-21/CAN-FD of G. Cook, "Catalogue of parametrised CRC algorithms" (reveng.sourceforge.io),
# over the ASCII characters 123456789; they start from 0, as the Bosch specification of 2012 does.
@pytest.mark.parametrize(("crc", "check"), [(crc17, 0x04F03), (crc21, 0x0ED841)])
def test_published_check_value(crc, check):
    levels = [int(bit) for bit in f"{int.from_bytes(b'123456789', 'big'):072b}"]
    assert crc(levels, start=0) == check


def test_fixed_stuff_bit_takes_the_place_of_a_dynamic_one():
    """ESI and DLC 0 are five dominant bits before the CRC field: one stuff bit follows, and the count leaves it out."""
    plan = frame_plan(0x555, b"", fd=True, brs=True)
    first = plan.fields.index("SC")
    assert plan.levels[first - 6 : first] == [0, 0, 0, 0, 0, 1]
    assert plan.stuff.index(True) == first - 1
    assert [level for level, field in zip(plan.levels, plan.fields, strict=True) if field == "SC"][:3] == [0, 0, 0]


def test_stuff_count_is_a_gray_code_and_its_parity():
    seen = {}
    for frame in random_frames("FD standard", 200):
        plan = frame_plan(*frame)
        first = plan.fields.index("SC")
        dynamic = sum(plan.stuff[: first - 1])
        seen[dynamic % 8] = plan.levels[first : first + 4]
    codes = [seen[count] for count in range(8)]
    assert all(sum(code) % 2 == 0 for code in codes)
    steps = [sum(a != b for a, b in zip(code[:3], codes[k - 1][:3], strict=True)) for k, code in enumerate(codes)]
    assert steps == [1] * 8


def test_stuff_bit_behind_rtr_is_no_longer_arbitration():
    """Identifier 0x7f0: SOF, five ones and their stuff bit, two ones, and RTR is the fifth of five zeros."""
    plan = frame_plan(0x7F0, b"")
    assert plan.arbitration_end == 14
    assert (plan.levels[14], plan.fields[14], plan.stuff[14]) == (1, "RTR", True)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ((0x800, b""), r"identifier 0x800 is outside 0\.\.0x7ff: pass extended=True"),
        ((0x20000000, b"", True), r"identifier 0x20000000 is outside 0\.\.0x1fffffff: mask"),
        ((1, bytes(9)), r"data of 9 bytes, the limit is 8: split"),
        ((1, b"\0", False, True), r"remote frame with 1 bytes of data, the limit is 0"),
        ((1, bytes(9), False, False, True), r"data of 9 bytes is no length of an FD frame: pad it to 12"),
        ((1, b"", False, True, True), r"remote FD frame: there is none, pass fd=False"),
    ],
)
def test_impossible_frame_is_refused(arguments, reason):
    with pytest.raises(ValueError, match=reason):
        frame_plan(*arguments)
