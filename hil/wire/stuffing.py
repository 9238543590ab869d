"""Dynamic bit stuffing by whole bytes: the stuff bits that a byte brings, and the state that it leaves.

Ref: Bosch, CAN Specification 2.0 (1991), part B, coding; ISO 11898-1:2015, frame coding.
Not implemented: the fixed stuff bits in the CRC field of an FD frame, whose number is a constant.

The tables are made here from the rule for one bit. Their index is `state | byte`, where a state is a number << 8.
"""

STATES = [(level, run) for level in (0, 1) for run in (1, 2, 3, 4)]
"""Level of the last bit on the wire and how many of it in a row; the fifth is answered at once by its stuff bit."""
START = (1, 1)
"""The idle bus is recessive, so the dominant SOF always begins a run."""


def stuff_bit(state: tuple[int, int], bit: int) -> tuple[tuple[int, int], int]:
    """Return the state after one bit, and the stuff bits (0 or 1) that it brings."""
    level, run = state
    if bit != level:
        return (bit, 1), 0
    if run < 4:
        return (bit, run + 1), 0
    return (1 - bit, 1), 1


def stuff_bits(state: tuple[int, int], field: int, width: int) -> tuple[tuple[int, int], int]:
    """Return the state after `width` bits, most significant first, and the stuff bits that they bring."""
    total = 0
    for shift in reversed(range(width)):
        state, stuffed = stuff_bit(state, field >> shift & 1)
        total += stuffed
    return state, total


_STEPS = [stuff_bits(state, byte, 8) for state in STATES for byte in range(256)]
STUFFED = bytes(stuffed for _, stuffed in _STEPS)
"""Stuff bits by (state number << 8 | byte)."""
AFTER = [STATES.index(state) << 8 for state, _ in _STEPS]
"""Next state number << 8, by the same index."""
