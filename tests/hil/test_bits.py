"""Frame lengths by byte tables against a frame built naively, bit by bit."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.wire.bits import crc15, frame_bits, worst_case_bits

SEED = 20240611


def bits_of(value, width):
    return [int(digit) for digit in f"{value:0{width}b}"] if width else []


def naive_crc15(bits):
    """The shift register of ISO 11898-1, one bit at a time."""
    register = [0] * 15
    for bit in bits:
        feedback = bit ^ register[0]
        register = [*register[1:], 0]
        if feedback:
            register = [a ^ b for a, b in zip(register, bits_of(0x4599, 15), strict=True)]
    return register


def naive_stuffing(bits):
    """Copy the bits; behind five equal ones, stuff bits counted, put the opposite."""
    wire = []
    for bit in bits:
        wire.append(bit)
        if len(wire) >= 5 and len(set(wire[-5:])) == 1:
            wire.append(1 - bit)
    return wire


def naive_frame(identifier, data, extended=False, remote=False, dlc=None):
    """All bits of a frame, from SOF to the last of EOF."""
    rtr = [int(remote)]
    if extended:
        base, extension = bits_of(identifier >> 18, 11), bits_of(identifier & 0x3FFFF, 18)
        arbitration = [*base, 1, 1, *extension, *rtr, 0, 0]
    else:
        arbitration = [*bits_of(identifier, 11), *rtr, 0, 0]
    control = bits_of(len(data) if dlc is None else dlc, 4)
    covered = [0, *arbitration, *control, *bits_of(int.from_bytes(data, "big"), 8 * len(data))]
    crc_delimiter, ack, ack_delimiter, end_of_frame = [1], [0], [1], [1] * 7
    return naive_stuffing(covered + naive_crc15(covered)) + crc_delimiter + ack + ack_delimiter + end_of_frame


def random_frame(source):
    """Arguments of one frame; half of the data stuff heavily."""
    extended, remote = source.random() < 0.5, source.random() < 0.2
    identifier = source.getrandbits(29 if extended else 11) & source.choice([-1, 0x1F, 0])
    length = source.randrange(9)
    fill = source.choice([0x00, 0xFF, 0xF8, 0x07, 0x0F, 0xC1, None, None, None, None, None, None])
    data = bytes(source.randrange(256) if fill is None else fill for _ in range(length))
    if remote:
        return identifier, b"", extended, True, source.randrange(16)
    return identifier, data, extended, False, None


def test_equals_naive_construction_on_random_frames():
    source = random.Random(SEED)
    for number in range(10_000):
        frame = random_frame(source)
        assert frame_bits(*frame) == len(naive_frame(*frame)), f"SEED={SEED}, frame {number}: frame_bits{frame}"


PATTERNS = [
    b"\x00",
    b"\xff",
    b"\x07\xc1\xf0\x7c\x1f",
    b"\xf8\x3e\x0f\x83\xe0",
    b"\x0f",
    b"\x78",
    b"\xe1\xc3\x87\x0f\x1e\x3c",
]


@pytest.mark.parametrize("pattern", PATTERNS, ids=bytes.hex)
@pytest.mark.parametrize("extended", [False, True])
@pytest.mark.parametrize("length", range(9))
def test_equals_naive_construction_where_much_is_stuffed(pattern, extended, length):
    data = (pattern * 8)[:length]
    for identifier in (0x000, 0x7FF, 0x01F, 0x7E0, 0x078, 0x783) + ((0x1FFFFFFF, 0x1F07C1F0) if extended else ()):
        assert frame_bits(identifier, data, extended) == len(naive_frame(identifier, data, extended))


@pytest.mark.parametrize("remote", [False, True])
def test_equals_naive_construction_for_every_standard_identifier(remote):
    for identifier in range(0x800):
        assert frame_bits(identifier, b"", remote=remote) == len(naive_frame(identifier, b"", remote=remote))


@pytest.mark.parametrize("dlc", range(8, 16))
def test_dlc_above_eight_means_eight_bytes(dlc):
    data = bytes(range(8))
    assert frame_bits(0x123, data, dlc=dlc) == len(naive_frame(0x123, data, dlc=dlc))


def test_published_check_value():
    assert crc15(b"123456789") == 0x059E


def test_length_that_can_be_counted_by_hand():
    """Identifier 0 without data is 34 dominant bits, CRC included: a stuff bit behind each full five, and ten more."""
    assert frame_bits(0, b"") == 34 + 34 // 5 + 10


# Bits of the longest data frame there is, by its length: found by an exhaustive search over identifier and data.
LONGEST = [
    (False, 0x000, "", 50),
    (False, 0x7FE, "ff", 59),
    (False, 0x7FF, "f83e", 69),
    (False, 0x7C3, "ef87fc", 80),
    (False, 0x3FF, "00f0ff87", 90),
    (False, 0x7FE, "fffc200787", 99),
    (False, 0x7FE, "0f0f0f0ff878", 110),
    (False, 0x01F, "8787c1e1e1e1e1", 121),
    (False, 0x7FE, "3e0f0f0f0f0f0fbe", 130),
    (True, 0x0F861FF8, "", 75),
    (True, 0x1F0CF878, "ef", 85),
    (True, 0x1F0C3DF0, "083c", 95),
    (True, 0x1F0C3C1F, "e1e3e1", 105),
    (True, 0x1F0C1F0F, "00f0f0f0", 115),
    (True, 0x17C30F0F, "f0f0f0ff87", 125),
    (True, 0x1F0C3E0F, "0f0f0f0f0ff8", 135),
    (True, 0x1FFF0F0F, "fc3c1f0f0f0f00", 145),
    (True, 0x1F0C3C3C, "3fe1e1e1fff803c3", 155),
]


@pytest.mark.parametrize(("extended", "identifier", "data", "bits"), LONGEST)
def test_longest_frame_stays_one_to_three_bits_below_the_bound(extended, identifier, data, bits):
    data = bytes.fromhex(data)
    assert frame_bits(identifier, data, extended) == len(naive_frame(identifier, data, extended)) == bits
    assert 1 <= worst_case_bits(len(data), extended) - bits <= 3


@pytest.mark.parametrize("length", range(9))
def test_bound_is_attained_by_bits_that_no_control_field_interrupts(length):
    for extended, unstuffed in ((False, 44), (True, 64)):
        stuffable = unstuffed - 10 + 8 * length
        rhythm = [0] * 5 + [1, 1, 1, 1, 0, 0, 0, 0] * stuffable
        assert worst_case_bits(length, extended) == len(naive_stuffing(rhythm[:stuffable])) + 10


@settings(deadline=None, max_examples=500)
@given(identifier=st.integers(0, 0x1FFFFFFF), extended=st.booleans(), data=st.binary(max_size=8))
def test_bound_is_never_exceeded(identifier, extended, data):
    bits = frame_bits(identifier if extended else identifier & 0x7FF, data, extended)
    assert (64 if extended else 44) + 8 * len(data) <= bits <= worst_case_bits(len(data), extended)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ((0x800, b""), r"identifier 0x800 is outside 0\.\.0x7ff: pass extended=True"),
        ((-1, b""), r"identifier -0x1 is outside 0\.\.0x7ff"),
        ((0x20000000, b"", True), r"identifier 0x20000000 is outside 0\.\.0x1fffffff: mask"),
        ((1, bytes(9)), r"data of 9 bytes, the limit is 8: split"),
        ((1, b"\0", False, True), r"remote frame with 1 bytes of data, the limit is 0"),
        ((1, b"", False, True, 16), r"DLC 16 is outside 0\.\.15"),
        ((1, b"", False, True, -1), r"DLC -1 is outside 0\.\.15"),
        ((1, b"\0\0", False, False, 3), r"DLC 3 with 2 bytes of data: leave dlc out"),
    ],
)
def test_impossible_frame_is_refused(arguments, reason):
    with pytest.raises(ValueError, match=reason):
        frame_bits(*arguments)


@pytest.mark.parametrize("length", [-1, 9])
def test_worst_case_of_impossible_length_is_refused(length):
    with pytest.raises(ValueError, match=rf"data length {length} is outside 0\.\.8"):
        worst_case_bits(length)
