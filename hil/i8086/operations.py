"""Arithmetic of words, with the flags that it leaves: on what is in the registers or memory of a State.

Each takes the state and words, sets flags, and returns the word. Flags that the 8086 leaves undefined: AF is cleared by
XOR and the shifts, and IMUL keeps SF, ZF, AF and PF.

Ref: Intel 8086 Family User's Manual 1979, chapter 2, instruction set.
"""

from hil.i8086.clocks import multiply as multiply_clocks
from hil.i8086.state import AF, AX, CF, DX, OF, PF, SF, ZF, State

ARITHMETIC = CF | PF | AF | ZF | SF | OF
OTHERS = 0xFFFF & ~ARITHMETIC

_PARITY = bytes(0 if byte.bit_count() & 1 else PF for byte in range(256))
_SIGN_ZERO_PARITY = (
    bytes([_PARITY[0] | ZF]) + _PARITY[1:] + _PARITY * 127 + bytes(parity | SF for parity in _PARITY) * 128
)
"""SF, ZF and PF of every word."""


def add(state: State, a: int, b: int, carry: int = 0) -> int:
    """Return a + b + carry."""
    total = a + b + carry
    word = total & 0xFFFF
    state.flags = (
        state.flags & OTHERS
        | _SIGN_ZERO_PARITY[word]
        | total >> 16
        | (a ^ b ^ total) & AF
        | ((a ^ total) & (b ^ total)) >> 4 & OF
    )
    return word


def add_with_carry(state: State, a: int, b: int) -> int:
    """Return a + b + CF."""
    return add(state, a, b, state.flags & CF)


def subtract(state: State, a: int, b: int, borrow: int = 0) -> int:
    """Return a - b - borrow."""
    total = a - b - borrow
    word = total & 0xFFFF
    state.flags = (
        state.flags & OTHERS
        | _SIGN_ZERO_PARITY[word]
        | total >> 16 & CF
        | (a ^ b ^ total) & AF
        | ((a ^ b) & (a ^ total)) >> 4 & OF
    )
    return word


def subtract_with_borrow(state: State, a: int, b: int) -> int:
    """Return a - b - CF."""
    return subtract(state, a, b, state.flags & CF)


def exclusive_or(state: State, a: int, b: int) -> int:
    """Return a XOR b."""
    state.flags = state.flags & OTHERS | _SIGN_ZERO_PARITY[a ^ b]
    return a ^ b


def increment(state: State, a: int) -> int:
    """Return a + 1; CF stays."""
    word = a + 1 & 0xFFFF
    overflow = OF if word == 0x8000 else 0
    state.flags = state.flags & (OTHERS | CF) | _SIGN_ZERO_PARITY[word] | (a ^ word) & AF | overflow
    return word


def decrement(state: State, a: int) -> int:
    """Return a - 1; CF stays."""
    word = a - 1 & 0xFFFF
    overflow = OF if a == 0x8000 else 0
    state.flags = state.flags & (OTHERS | CF) | _SIGN_ZERO_PARITY[word] | (a ^ word) & AF | overflow
    return word


def negate(state: State, a: int) -> int:
    """Return -a."""
    return subtract(state, 0, a)


def shift_left(state: State, a: int) -> int:
    """Return a << 1."""
    word = a << 1 & 0xFFFF
    state.flags = state.flags & OTHERS | _SIGN_ZERO_PARITY[word] | a >> 15 | (a ^ word) >> 4 & OF
    return word


def rotate_left_through_carry(state: State, a: int) -> int:
    """Return a << 1 with CF as its lowest bit; SF, ZF and PF stay."""
    word = a << 1 & 0xFFFF | state.flags & CF
    state.flags = state.flags & ~(CF | OF) | a >> 15 | (a ^ word) >> 4 & OF
    return word


def shift_right_signed(state: State, a: int) -> int:
    """Return a >> 1, floored."""
    word = a >> 1 | a & 0x8000
    state.flags = state.flags & OTHERS | _SIGN_ZERO_PARITY[word] | a & CF
    return word


def multiply(state: State, by: int) -> None:
    """Put AX * by into DX:AX; CF and OF say that it is no word."""
    ax = state.registers[AX]
    product = (ax ^ 0x8000) - 0x8000
    product *= (by ^ 0x8000) - 0x8000
    state.registers[AX] = product & 0xFFFF
    state.registers[DX] = product >> 16 & 0xFFFF
    fits = -0x8000 <= product <= 0x7FFF
    state.flags = state.flags & ~(CF | OF) | (0 if fits else CF | OF)
    state.clocks += multiply_clocks(ax, by)
    state.multiplications += 1


def widen(state: State) -> None:
    """Fill DX with the sign of AX."""
    state.registers[DX] = 0xFFFF if state.registers[AX] & 0x8000 else 0
