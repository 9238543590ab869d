"""Where an instruction's word is: a register, or memory by ModRM.

Ref: Intel 8086 Family User's Manual 1979, chapter 4, machine instruction encoding and decoding.
"""

from collections.abc import Callable
from dataclasses import dataclass

from hil.i8086.clocks import BASED, DIRECT, DISPLACED
from hil.i8086.state import BP, BX, DI, DS, SI, SS, State

Read = Callable[[State], int]
Write = Callable[[State, int], None]

BASES = ((BX, SI), (BX, DI), (BP, SI), (BP, DI), (SI,), (DI,), (BP,), (BX,))
"""By ModRM's r/m."""


@dataclass(frozen=True)
class Operand:
    """How to read and write it; bytes that ModRM and its displacement take; clocks of its address, None: a register.

    offset: of an address that has no register in it.
    """

    read: Read
    write: Write
    length: int = 0
    address: int | None = None
    offset: int | None = None


def register(number: int) -> Operand:
    """Return a word register."""

    def write(state: State, word: int) -> None:
        state.registers[number] = word

    return Operand(lambda state: state.registers[number], write)


def direct(offset: int, segment: int | None, length: int, address: int = DIRECT) -> Operand:
    """Return a word of memory by its offset. segment: of a prefix."""
    place = DS if segment is None else segment
    return Operand(
        lambda state: state.load(place, offset),
        lambda state, word: state.store(place, offset, word),
        length,
        address,
        offset,
    )


def by_modrm(code: bytes, segment: int | None) -> Operand:
    """Return the word that ModRM, code's first byte, means. segment: of a prefix."""
    mode, rm = code[0] >> 6, code[0] & 7
    if mode == 3:
        operand = register(rm)
        return Operand(operand.read, operand.write, 1)
    if mode == 0 and rm == 6:
        return direct(word_at(code, 1), segment, 3)
    place = segment if segment is not None else SS if BP in BASES[rm] else DS
    offset = _offset(BASES[rm], (0, signed_byte(code[1]), word_at(code, 1))[mode])
    return Operand(
        lambda state: state.load(place, offset(state)),
        lambda state, word: state.store(place, offset(state), word),
        1 + mode,
        BASED[rm] + (DISPLACED if mode else 0),
    )


def _offset(bases: tuple[int, ...], displacement: int) -> Read:
    """Return what computes an offset: one or two registers and a displacement, in 16 bits."""
    if len(bases) == 1:
        (base,) = bases
        return lambda state: state.registers[base] + displacement & 0xFFFF
    base, index = bases
    return lambda state: state.registers[base] + state.registers[index] + displacement & 0xFFFF


def word_at(code: bytes, at: int) -> int:
    """Return the word there, low byte first."""
    return code[at] | code[at + 1] << 8


def signed_byte(byte: int) -> int:
    """Return a byte as -128 to 127."""
    return (byte ^ 0x80) - 0x80
