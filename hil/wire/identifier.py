"""Identifiers as in linux/can.h: 11 or 29 bits, and the flags EXTENDED and REMOTE above them.

Ref: linux/can.h; ISO 11898-1:2015, 10.8 (arbitration).
"""

EXTENDED = 0x80000000
REMOTE = 0x40000000
STANDARD_MASK = 0x7FF
EXTENDED_MASK = 0x1FFFFFFF


def is_identifier(identifier: int) -> bool:
    """Return whether this is an identifier of 11 or 29 bits with no flags but EXTENDED and REMOTE."""
    if 0 <= identifier <= STANDARD_MASK:
        return True
    number = identifier & ~(EXTENDED | REMOTE)
    return 0 <= number <= (EXTENDED_MASK if identifier & EXTENDED else STANDARD_MASK)


def arbitration_key(identifier: int) -> int:
    """Return the arbitration field as a number: the smaller wins the bus (ISO 11898-1, 10.8: dominant is 0)."""
    if identifier <= STANDARD_MASK:
        return identifier << 21
    remote = identifier & REMOTE != 0
    if identifier & EXTENDED:
        number = identifier & EXTENDED_MASK
        return (number >> 18) << 21 | 0b11 << 19 | (number & 0x3FFFF) << 1 | remote
    return (identifier & STANDARD_MASK) << 21 | remote << 20


def split_identifier(identifier: int) -> tuple[int, bool, bool]:
    """Return (number, extended, remote) of an identifier with the flags of linux/can.h."""
    extended, remote = identifier & EXTENDED != 0, identifier & REMOTE != 0
    return identifier & (EXTENDED_MASK if extended else STANDARD_MASK), extended, remote
