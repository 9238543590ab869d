"""How many bits a CAN FD frame occupies on the wire at either rate, stuff bits included.

Ref: ISO 11898-1:2015, 10.4 (frames), 10.4.2.6 (CRC field), frame coding, bit rate switch; linux/can/length.h.
Not implemented: FD frames of the Bosch specification of 2012, which carry no stuff count.

No CRC is computed: it is stuffed at fixed places, so the length does not depend on it.
"""

from functools import lru_cache

from hil.wire.identifier import FD_LENGTHS, check_number, longer_fd_length
from hil.wire.stuffing import AFTER, START, STATES, STUFFED, stuff_bits

STANDARD_HEADER_BITS = 22
"""SOF, identifier (11), RRS, IDE, FDF, res, BRS, ESI, DLC (4)."""
EXTENDED_HEADER_BITS = 41
"""SOF, identifier (11), SRR, IDE, identifier (18), RRS, FDF, res, BRS, ESI, DLC (4)."""
FAST_HEADER_BITS = 5
"""ESI, DLC (4): what follows BRS."""
LONGEST_CRC17 = 16
"""Bytes of data; more are protected by CRC-21."""
CRC17_FIELD_BITS = 4 + 17 + 6 + 1
"""Stuff count, CRC, fixed stuff bits, CRC delimiter."""
CRC21_FIELD_BITS = 4 + 21 + 7 + 1
TRAILER_BITS = 9
"""ACK slot, ACK delimiter, seven bits of EOF: at the nominal rate again."""


def fd_frame_bits(
    identifier: int, data: bytes, extended: bool = False, brs: bool = True, esi: bool = False
) -> tuple[int, int]:
    """Return the exact length of an FD frame as (bits at the nominal rate, bits at the data rate).

    From SOF to the last bit of EOF, without intermission. With `brs` the data rate begins at the sample point of BRS
    and ends at that of the CRC delimiter. Each of the two bits is partly slow and partly fast; what is slow in them
    adds up to one nominal bit and what is fast to one data bit, wherever the two sample points are. So BRS counts as
    nominal, the CRC delimiter as a data bit, and the time of the frame is exact. Without `brs` all bits are nominal.
    ValueError names a length that no DLC says.
    """
    nominal, fast, state = _header(identifier, len(data), extended, brs, esi)
    bits = 8 * len(data)
    stuffed = STUFFED
    after = AFTER
    for byte in data:
        step = state | byte
        bits += stuffed[step]
        state = after[step]
    # Where a stuff bit would come last, its level is that of the state; the first fixed stuff bit takes its place.
    last = data[-1] & 1 if data else 0
    bits -= state >> 10 ^ last
    return (nominal, fast + bits) if brs else (nominal + bits, 0)


def fd_worst_case_bits(length: int, extended: bool = False, brs: bool = True) -> tuple[int, int]:
    """Return the bounds on both numbers of `fd_frame_bits` with `length` bytes, whatever the identifier, data and ESI.

    FDF is recessive between two dominant bits: stuffing starts anew behind it, and never comes to five before BRS. Of
    the 14 or 33 bits before FDF at most (n - 1) // 4 are followed by a stuff bit; so are two in each byte of data, and
    one in what lies between. ValueError names a length that no DLC says.
    """
    fd_dlc(length)
    arbitration = EXTENDED_HEADER_BITS - 8 if extended else STANDARD_HEADER_BITS - 8
    nominal = arbitration + (arbitration - 1) // 4 + 3 + TRAILER_BITS
    fast = FAST_HEADER_BITS + 8 * length + 1 + 2 * length + _crc_field_bits(length)
    return (nominal, fast) if brs else (nominal + fast, 0)


def fd_shortest_bits(length: int, extended: bool = False) -> tuple[int, int]:
    """Return what `fd_frame_bits` with `length` bytes and `brs` never falls short of: a frame without stuff bits."""
    nominal = (EXTENDED_HEADER_BITS if extended else STANDARD_HEADER_BITS) - FAST_HEADER_BITS + TRAILER_BITS
    return nominal, FAST_HEADER_BITS + 8 * length + _crc_field_bits(length)


def fd_dlc(length: int) -> int:
    """Return the DLC that says this number of bytes; ValueError names the next length that there is."""
    if length in FD_LENGTHS:
        return FD_LENGTHS.index(length)
    following = longer_fd_length(length)
    if following is None:
        raise ValueError(f"data of {length} bytes, the limit is {FD_LENGTHS[-1]}: split it over several frames")
    raise ValueError(f"data of {length} bytes is no length of an FD frame: pad it to {following}")


@lru_cache(maxsize=4096)
def _header(identifier: int, length: int, extended: bool, brs: bool, esi: bool) -> tuple[int, int, int]:
    """Return the bits at either rate but for data and what it stuffs, and the stuffing state behind the DLC."""
    field, width = _header_field(identifier, fd_dlc(length), extended, brs, esi)
    # No stuff bit can follow BRS while it is recessive: it differs from res.
    nominal = width - FAST_HEADER_BITS
    state, slow = stuff_bits(START, field >> FAST_HEADER_BITS, nominal)
    state, stuffed = stuff_bits(state, field, FAST_HEADER_BITS)
    nominal += slow + TRAILER_BITS
    fast = FAST_HEADER_BITS + stuffed + _crc_field_bits(length)
    number = STATES.index(state) << 8
    return (nominal, fast, number) if brs else (nominal + fast, 0, number)


def _header_field(identifier: int, dlc: int, extended: bool, brs: bool, esi: bool) -> tuple[int, int]:
    """Return the bits from SOF (dominant, so a leading zero) to DLC as one number, and how many they are."""
    check_number(identifier, extended)
    fdf = 1 << 7
    control = fdf | brs << 5 | esi << 4 | dlc
    if not extended:
        return identifier << 10 | control, STANDARD_HEADER_BITS
    srr_ide = 0b11
    return identifier >> 18 << 29 | srr_ide << 27 | (identifier & 0x3FFFF) << 9 | control, EXTENDED_HEADER_BITS


def _crc_field_bits(length: int) -> int:
    return CRC17_FIELD_BITS if length <= LONGEST_CRC17 else CRC21_FIELD_BITS
