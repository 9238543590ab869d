"""What kind of frame it is, in one number: an identifier as in linux/can.h, with the flags of CAN FD above it.

Ref: linux/can.h; ISO 11898-1:2015, 10.4 (frame formats), 10.8 (arbitration).
"""

EXTENDED = 0x80000000
REMOTE = 0x40000000
ERROR = 0x20000000
"""An error frame of linux/can/error.h: told to who listens, never sent."""
FD = 1 << 32
BRS = 1 << 33
"""The data phase runs at the data rate."""
ESI = 1 << 34
"""The sender is error-passive."""
OWN = 1 << 35
"""Handed back to the one that sent it."""

STANDARD_MASK = 0x7FF
EXTENDED_MASK = 0x1FFFFFFF

LONGEST_CLASSIC = 8
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Bytes of data by DLC. Ref: ISO 11898-1:2015, table 5."""


def is_identifier(identifier: int) -> bool:
    """Return whether this is an identifier of 11 or 29 bits with no flags but those of a frame that can be sent."""
    if 0 <= identifier <= STANDARD_MASK:
        return True
    if identifier < 0 or identifier & ERROR or identifier >= OWN:
        return False
    if identifier & FD:
        if identifier & REMOTE:
            return False
    elif identifier & (BRS | ESI):
        return False
    return identifier & EXTENDED_MASK <= (EXTENDED_MASK if identifier & EXTENDED else STANDARD_MASK)


def refusal(identifier: int, length: int, fd: bool) -> str | None:
    """Return why a frame cannot be sent on a bus, classic or FD; None if it can."""
    if not is_identifier(identifier):
        return f"identifier {identifier:#x} has more than 11 or 29 bits, or flags that exclude each other"
    if identifier & FD:
        if not fd:
            return "CAN FD frame on a classic bus: send one without FD, or start the bus with a data rate"
        if length not in FD_LENGTHS:
            longer = longer_fd_length(length)
            cure = f"pad it to {longer}" if longer else f"split it, the limit is {FD_LENGTHS[-1]}"
            return f"no DLC of CAN FD says {length} bytes: {cure}"
    elif length > LONGEST_CLASSIC:
        return f"{length} bytes of data in a classic frame, the limit is {LONGEST_CLASSIC}: split them, or send CAN FD"
    return None


def longer_fd_length(length: int) -> int | None:
    """Return the next longer data that a DLC of CAN FD says; None beyond the longest."""
    return next((known for known in FD_LENGTHS if known > length), None)


def check_number(number: int, extended: bool) -> None:
    """Raise ValueError unless this is an identifier of 11 or, extended, 29 bits without flags."""
    limit = EXTENDED_MASK if extended else STANDARD_MASK
    if not 0 <= number <= limit:
        cure = "mask the flags off" if extended else "pass extended=True for 29 bits"
        raise ValueError(f"identifier {number:#x} is outside 0..{limit:#x}: {cure}")


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
    """Return (number, extended, remote) of an identifier with flags."""
    extended, remote = identifier & EXTENDED != 0, identifier & REMOTE != 0
    return identifier & (EXTENDED_MASK if extended else STANDARD_MASK), extended, remote
