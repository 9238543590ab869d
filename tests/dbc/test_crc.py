"""The checksums against their published check values and against a shift register, bit by bit."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.crc import CRC8_RESIDUE, crc8, crc8_register, crc16, frame_crc8


def shift_register(data: bytes, width: int, polynomial: int, preset: int, invert: int) -> int:
    """Divide bit by bit, most significant first, as the definition says."""
    register = preset
    for byte in data:
        for shift in range(7, -1, -1):
            carry = register >> (width - 1) ^ (byte >> shift & 1)
            register = (register << 1) % (1 << width)
            if carry:
                register ^= polynomial
    return register ^ invert


@pytest.mark.parametrize(("checksum", "check_value"), [(crc8, 0x4B), (crc16, 0x29B1)])
def test_published_check_value(checksum, check_value):
    assert checksum(b"123456789") == check_value


def test_empty_data_leaves_the_preset():
    assert (crc8(b""), crc16(b"")) == (0x00, 0xFFFF)


@settings(deadline=None)
@given(st.binary(max_size=20))
def test_tables_equal_shift_register(data):
    assert crc8(data) == shift_register(data, 8, 0x1D, 0xFF, 0xFF)
    assert crc16(data) == shift_register(data, 16, 0x1021, 0xFFFF, 0)


@settings(deadline=None)
@given(st.binary(max_size=8), st.binary(max_size=8))
def test_register_goes_on_where_it_stopped(first, second):
    assert crc8_register(second, crc8_register(first)) == crc8_register(first + second)


@settings(deadline=None)
@given(st.binary(max_size=8))
def test_residue_behind_its_own_crc(data):
    assert crc8_register(data + bytes([crc8(data)])) == CRC8_RESIDUE


def test_frame_crc_begins_with_identifier_high_byte_first():
    assert frame_crc8(0x0123, b"\x45\x67") == crc8(b"\x01\x23\x45\x67")
