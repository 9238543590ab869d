"""How many bits a classic CAN frame occupies on the wire, stuff bits included.

Ref: Bosch, CAN Specification 2.0 (1991), part B: data frame, remote frame, CRC sequence, coding (bit stuffing).
Not implemented: FD frames (hil/wire/fd_bits.py), error and overload frames.

A loop over bits costs 24 us a frame, byte tables 1 us: so both the CRC and the stuffing advance by whole bytes, through
tables made here from their one-bit rules. What precedes the data differs between few frames only and is remembered.
"""

from functools import lru_cache

from hil.wire.identifier import check_number
from hil.wire.stuffing import AFTER, START, STATES, STUFFED, stuff_bits

INTERMISSION_BITS = 3
"""Recessive bits between two frames; no part of a frame's length."""

CRC15_POLYNOMIAL = 0x4599
TRAILER_BITS = 10
"""CRC delimiter, ACK slot, ACK delimiter and seven bits of EOF: never stuffed."""

STANDARD_HEADER_BITS = 19
"""SOF, identifier (11), RTR, IDE, r0, DLC (4)."""
EXTENDED_HEADER_BITS = 39
"""SOF, identifier (11), SRR, IDE, identifier (18), RTR, r1, r0, DLC (4)."""
CRC_BITS = 15
LONGEST_DATA = 8
LARGEST_DLC = 15


def frame_bits(
    identifier: int, data: bytes, extended: bool = False, remote: bool = False, dlc: int | None = None
) -> int:
    """Return the exact length of a frame in bits, from SOF to the last bit of EOF, without intermission.

    `dlc` defaults to the length of the data. A remote frame has no data and may ask for any DLC from 0 to 15;
    a data frame of eight bytes may carry a DLC from 8 to 15.
    """
    usual = dlc is None and not remote and len(data) <= LONGEST_DATA
    dlc = len(data) if usual else checked_dlc(data, remote, dlc)
    crc, state, bits = _header(identifier, dlc, extended, remote)
    stuffed = STUFFED
    after = AFTER
    table = _CRC15
    for byte in data:
        crc = (crc << 8 & 0x7FFF) ^ table[crc >> 7 ^ byte]
        step = state | byte
        bits += stuffed[step]
        state = after[step]
    # 15 bits of CRC fill two bytes with one bit to spare: the opposite of its neighbour, which can never be stuffed.
    step = state | crc >> 7
    return bits + 8 * len(data) + stuffed[step] + stuffed[after[step] | (crc << 1 & 0xFF) | (~crc & 1)]


def worst_case_bits(length: int, extended: bool = False) -> int:
    """Return the bound on `frame_bits` of a data frame with `length` bytes, whatever its identifier and data.

    A stuff bit follows at the earliest after five bits and then after every four, being itself the first of the next
    five. No frame quite gets there: fixed control bits and the CRC break that rhythm, at a price of 1 to 3 bits.
    """
    if not 0 <= length <= LONGEST_DATA:
        raise ValueError(f"data length {length} is outside 0..{LONGEST_DATA}: split it over several frames")
    header = EXTENDED_HEADER_BITS if extended else STANDARD_HEADER_BITS
    stuffable = header + 8 * length + CRC_BITS
    return stuffable + (stuffable - 1) // 4 + TRAILER_BITS


def shortest_bits(length: int, extended: bool = False) -> int:
    """Return what `frame_bits` of a data frame with `length` bytes never falls short of: a frame without stuff bits."""
    return (EXTENDED_HEADER_BITS if extended else STANDARD_HEADER_BITS) + 8 * length + CRC_BITS + TRAILER_BITS


def crc15(data: bytes, crc: int = 0) -> int:
    """Return the CRC-15/CAN of whole bytes, most significant bit first, continuing from `crc`."""
    for byte in data:
        crc = (crc << 8 & 0x7FFF) ^ _CRC15[crc >> 7 ^ byte]
    return crc


@lru_cache(maxsize=4096)
def _header(identifier: int, dlc: int, extended: bool, remote: bool) -> tuple[int, int, int]:
    """Return the CRC and the stuffing state behind the DLC, and the frame's bits but for data and what it stuffs."""
    field, width = _header_field(identifier, dlc, extended, remote)
    state, stuffed = stuff_bits(START, field, width)
    # The CRC starts from zero, so zeros in front of SOF, up to a whole byte, change nothing.
    crc = crc15(field.to_bytes((width + 7) // 8, "big"))
    return crc, STATES.index(state) << 8, width + stuffed + CRC_BITS + TRAILER_BITS


def _header_field(identifier: int, dlc: int, extended: bool, remote: bool) -> tuple[int, int]:
    """Return the bits from SOF (dominant, so a leading zero) to DLC as one number, and how many they are."""
    check_number(identifier, extended)
    if not extended:
        return identifier << 7 | remote << 6 | dlc, STANDARD_HEADER_BITS
    srr_ide = 0b11
    return identifier >> 18 << 27 | srr_ide << 25 | (
        identifier & 0x3FFFF
    ) << 7 | remote << 6 | dlc, EXTENDED_HEADER_BITS


def checked_dlc(data: bytes, remote: bool, dlc: int | None) -> int:
    """Return the DLC of a classic frame, remote or with a DLC of its own included.

    ValueError says what cannot be sent.
    """
    if len(data) > LONGEST_DATA:
        raise ValueError(f"data of {len(data)} bytes, the limit is {LONGEST_DATA}: split it over several frames")
    if remote and data:
        raise ValueError(f"remote frame with {len(data)} bytes of data, the limit is 0: pass b'' and the DLC as dlc")
    if dlc is None:
        return len(data)
    if not 0 <= dlc <= LARGEST_DLC:
        raise ValueError(f"DLC {dlc} is outside 0..{LARGEST_DLC}: pass a length from 0 to {LONGEST_DATA}")
    if not remote and min(dlc, LONGEST_DATA) != len(data):
        raise ValueError(f"DLC {dlc} with {len(data)} bytes of data: leave dlc out and it follows the data")
    return dlc


def _crc15_entry(byte: int) -> int:
    """Return what one byte at the top of the register does to it."""
    crc = byte << 7
    for _ in range(8):
        crc = crc << 1 ^ (CRC15_POLYNOMIAL if crc & 0x4000 else 0)
    return crc & 0x7FFF


_CRC15 = [_crc15_entry(byte) for byte in range(256)]
