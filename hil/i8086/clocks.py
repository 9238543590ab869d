"""The clocks that are documented of the 8086, by form of instruction, with those of IMUL by its operands.

They leave out what is waiting for: instruction bytes that are not yet fetched, and wait states. A form is named by its
opcode, without a register in its low bits, and the operation that ModRM has: "83.7" is CMP of a word and a signed byte.

Ref: instruction timing tables of the 8086, made after table 2-21 of the Intel 8086 Family User's Manual 1979, which was
not at hand itself; RET and IRET as measured on silicon, where tables differ.
"""

from typing import NamedTuple


class Clocks(NamedTuple):
    """Of a form: with operands in registers; with one in memory, its address apart."""

    register: int
    memory: int = 0


_TABLE = (
    (Clocks(3, 16), "01 11 19 29 31"),  # ADD, ADC, SBB, SUB, XOR: register to memory
    (Clocks(3, 9), "03 13 1B 2B 33"),  # memory to register
    (Clocks(4), "05 15 1D 2D 35 3D"),  # immediate to AX, and CMP
    (Clocks(4, 17), "81.0 81.2 81.3 81.5 81.6 83.0 83.2 83.3 83.5"),  # immediate to memory
    (Clocks(3, 9), "39 3B"),  # CMP
    (Clocks(4, 10), "81.7 83.7"),
    (Clocks(2), "40 48"),  # INC, DEC
    (Clocks(3, 15), "FF.0 FF.1"),
    (Clocks(3, 16), "F7.3"),  # NEG
    (Clocks(127, 133), "F7.5"),  # IMUL at its least
    (Clocks(2, 15), "D1.2 D1.4 D1.7"),  # RCL, SHL, SAR by one bit
    (Clocks(5), "99"),  # CWD
    (Clocks(2, 9), "89"),  # MOV: register to memory
    (Clocks(2, 8), "8B"),  # memory to register
    (Clocks(0, 4), "A1 A3"),  # AX
    (Clocks(4), "B0 B8"),  # immediate to register
    (Clocks(4, 10), "C7"),  # immediate to memory
    (Clocks(11), "50"),  # PUSH
    (Clocks(8), "58"),  # POP
    (Clocks(4), "70 71 72 73 74 75 78 79 7C 7D 7E 7F"),  # JO, JB, JE, JS, JL, JLE and their opposites, not taken
    (Clocks(15), "E9 EB"),  # JMP
    (Clocks(19), "E8"),  # CALL
    (Clocks(16), "C3"),  # RET
    (Clocks(32), "CF"),  # IRET
    (Clocks(10), "E4 E5 E6 E7"),  # IN, OUT
    (Clocks(2), "F4"),  # HLT
)

FORMS = {form: clocks for clocks, forms in _TABLE for form in forms.split()}
"""All forms that the interpreter knows."""

TAKEN = 12
"""A branch that is taken, more than one that is not."""
ODD_WORD = 4
"""Each access to a word at an odd address, or at an odd port."""
PREFIX = 2
INTERRUPT = 61
"""The acknowledgement of an INTR: no instruction, counted by whoever interrupts. Flags, CS and IP are pushed in it."""

DIRECT = 6
BASED = (7, 8, 8, 7, 5, 5, 5, 5)
"""Of an address by ModRM's r/m: BX+SI, BX+DI, BP+SI, BP+DI, SI, DI, BP, BX."""
DISPLACED = 4
"""A displacement in addition to them."""

MULTIPLY_MOST = 29
"""More than the least, with which IMUL stands above."""


def multiply(ax: int, by: int) -> int:
    """Return what an IMUL of two words takes beyond the least.

    One for every one in the magnitude of AX; signs are made positive before, and the product negative after. Found by
    fitting captures of silicon: the manual has the range 128 to 154 alone.
    """
    negative, by_negative = ax >> 15, by >> 15
    magnitude = 0x10000 - ax if negative else ax
    return magnitude.bit_count() + 2 * negative - by_negative + 12 * (negative ^ by_negative)
