"""Lengths of FD frames: tables, bounds and refusals. Random frames are compared in test_frame_plan.py."""

from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.wire.fd_bits import FD_LENGTHS, fd_dlc, fd_frame_bits, fd_worst_case_bits
from hil.wire.frame_plan import frame_plan

# Bits behind BRS, CRC delimiter included, where nothing is stuffed: ESI, DLC, data, and 28 (CRC-17) or 33 (CRC-21).
FAST = [33, 41, 49, 57, 65, 73, 81, 89, 97, 129, 161, 198, 230, 294, 422, 550]
UNSTUFFED = [
    pytest.param(length, extended, nominal, fast, id=f"{length}-{kind}")
    for length, fast in zip((0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64), FAST, strict=True)
    for extended, nominal, kind in ((False, 17 + 9, "standard"), (True, 36 + 9, "extended"))
]


@pytest.mark.parametrize(("length", "extended", "nominal", "fast"), UNSTUFFED)
def test_lengths_that_can_be_counted_by_hand(length, extended, nominal, fast):
    identifier, data = 0x15555555 if extended else 0x555, b"\x55" * length
    assert fd_frame_bits(identifier, data, extended) == (nominal, fast)
    # With a dominant BRS, ESI keeps res, BRS and a small DLC apart, but makes five ones with DLC 15.
    stuffed = 1 if length == 64 else 0
    assert fd_frame_bits(identifier, data, extended, brs=False, esi=True) == (nominal + fast + stuffed, 0)


# Five equal bits at the end of the data bring no dynamic stuff bit: the first fixed one stands there.
@pytest.mark.parametrize(
    ("data", "dynamic"),
    [("", 0), ("50", 0), ("60", 0), ("5555a0", 0), ("5540", 1), ("5000", 2), ("5f", 0), ("55bf", 1), ("551f", 0)],
)
def test_no_dynamic_stuff_bit_stands_before_the_crc_field(data, dynamic):
    data = bytes.fromhex(data)
    nominal, fast = fd_frame_bits(0x555, data)
    assert (nominal, fast) == (26, 33 + 8 * len(data) + dynamic)


def longest_stuffing(pattern):
    """Return the most dynamic stuff bits that a pattern of "0", "1" and free "?" can bring, and one choice of bits."""
    best = {("1", 1): (0, "")}
    for place, free in enumerate(pattern):
        following = {}
        for (level, run), (count, bits) in best.items():
            for bit in "01" if free == "?" else free:
                state, stuffed = ((bit, run + 1) if bit == level else (bit, 1)), 0
                if state[1] == 5:
                    state, stuffed = ("1" if bit == "0" else "0", 1), int(place < len(pattern) - 1)
                following[state] = max(following.get(state, (-1, "")), (count + stuffed, bits + bit))
        best = following
    return max(best.values())


def longest_frame(length, extended, brs, esi):
    """Return the arguments of a longest frame, found by going through all frames at once, bit by bit."""
    identifier = "?" * 11 + ("11" + "?" * 18 + "0" if extended else "00")
    pattern = f"0{identifier}10{brs:d}{esi:d}{fd_dlc(length):04b}" + "?" * (8 * length)
    count, bits = longest_stuffing(pattern)
    number = bits[1:12] + bits[14:32] if extended else bits[1:12]
    data = int(bits[len(pattern) - 8 * length :] or "0", 2).to_bytes(length, "big")
    return count, (int(number, 2), data, extended, brs, esi)


@pytest.mark.parametrize("brs", [False, True])
@pytest.mark.parametrize("extended", [False, True])
@pytest.mark.parametrize("length", FD_LENGTHS)
def test_longest_frame_stays_within_a_few_bits_of_the_bound(length, extended, brs):
    longest = [longest_frame(length, extended, brs, esi) for esi in (False, True)]
    stuffed, frame = max(longest)
    bits = fd_frame_bits(*frame)
    unstuffed = sum(fd_frame_bits(0x15555555 if extended else 0x555, b"\x55" * length, extended, True))
    bound = fd_worst_case_bits(length, extended, brs)
    assert sum(bits) == unstuffed + stuffed
    assert bits[0] <= bound[0]
    assert bits[1] <= bound[1]
    assert sum(bound) - sum(bits) <= 3


@settings(deadline=None, max_examples=500)
@given(
    identifier=st.integers(0, 0x1FFFFFFF),
    extended=st.booleans(),
    brs=st.booleans(),
    esi=st.booleans(),
    data=st.sampled_from(FD_LENGTHS).flatmap(lambda length: st.binary(min_size=length, max_size=length)),
)
def test_bound_is_never_exceeded(identifier, extended, brs, esi, data):
    bits = fd_frame_bits(identifier if extended else identifier & 0x7FF, data, extended, brs, esi)
    bound = fd_worst_case_bits(len(data), extended, brs)
    assert bits[0] <= bound[0]
    assert bits[1] <= bound[1]


@pytest.mark.parametrize("nominal_point", [Fraction(1, 2), Fraction(7, 8)])
@pytest.mark.parametrize("data_point", [Fraction(1, 2), Fraction(7, 10), Fraction(4, 5)])
def test_time_is_exact_wherever_the_sample_points_are(nominal_point, data_point):
    """The rate is switched at the nominal sample point of BRS and at the data sample point of the CRC delimiter."""
    nominal_ns, data_ns = 2000, 500
    plan = frame_plan(0x123, bytes(range(24)), fd=True)
    time_ns = Fraction(0)
    for field, stuff, fast in zip(plan.fields, plan.stuff, plan.fast, strict=True):
        if field == "BRS" and not stuff:
            time_ns += nominal_point * nominal_ns + (1 - data_point) * data_ns
        elif field == "CRC delimiter":
            time_ns += data_point * data_ns + (1 - nominal_point) * nominal_ns
        else:
            time_ns += data_ns if fast else nominal_ns
    nominal, fast = fd_frame_bits(0x123, bytes(range(24)))
    assert time_ns == nominal * nominal_ns + fast * data_ns


@pytest.mark.parametrize(
    ("length", "reason"),
    [
        (9, r"data of 9 bytes is no length of an FD frame: pad it to 12"),
        (13, r"data of 13 bytes is no length of an FD frame: pad it to 16"),
        (33, r"data of 33 bytes is no length of an FD frame: pad it to 48"),
        (63, r"data of 63 bytes is no length of an FD frame: pad it to 64"),
        (65, r"data of 65 bytes, the limit is 64: split it over several frames"),
    ],
)
def test_length_that_no_dlc_says_is_refused(length, reason):
    for refuse in (lambda: fd_frame_bits(1, bytes(length)), lambda: fd_worst_case_bits(length), lambda: fd_dlc(length)):
        with pytest.raises(ValueError, match=reason):
            refuse()


@pytest.mark.parametrize(("identifier", "extended"), [(-1, False), (0x800, False), (-1, True), (0x20000000, True)])
def test_identifier_of_too_many_bits_is_refused(identifier, extended):
    with pytest.raises(ValueError, match=rf"identifier {identifier:#x} is outside"):
        fd_frame_bits(identifier, b"", extended)
