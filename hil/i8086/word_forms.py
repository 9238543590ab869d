"""Instructions that compute with words, or move them.

Ref: Intel 8086 Family User's Manual 1979, chapter 4, machine instruction encoding and decoding.
"""

from collections.abc import Callable

from hil.i8086 import operations
from hil.i8086.clocks import FORMS, MULTIPLY_MOST, ODD_WORD
from hil.i8086.decoded import Decoded, Decoder, Execute, UnknownForm, group_form, opcode_form, plain
from hil.i8086.operands import Operand, Read, by_modrm, direct, register, signed_byte, word_at
from hil.i8086.state import AX, State

ARITHMETIC = {
    0: operations.add,
    2: operations.add_with_carry,
    3: operations.subtract_with_borrow,
    5: operations.subtract,
    6: operations.exclusive_or,
}
COMPARE = 7
"""Bits 3 to 5, of the opcode or of ModRM."""
UNARY = {
    "FF.0": operations.increment,
    "FF.1": operations.decrement,
    "D1.2": operations.rotate_left_through_carry,
    "D1.4": operations.shift_left,
    "D1.7": operations.shift_right_signed,
    "F7.3": operations.negate,
}
MULTIPLY = "F7.5"


def _on(form: str, length: int, operand: Operand, accesses: int, execute: Execute) -> Decoded:
    """Return an instruction on a register, or with so many accesses to memory."""
    if form not in FORMS:
        raise UnknownForm
    clocks = FORMS[form]
    if operand.address is None:
        return Decoded(form, length, clocks.register, execute)
    odd = ODD_WORD * accesses
    least, most = (0, odd) if operand.offset is None else (odd * (operand.offset & 1),) * 2
    return Decoded(form, length, clocks.memory + operand.address, execute, least, most)


def _combined(operation: int, target: Operand, read: Read) -> tuple[Execute, int]:
    """Return what an operation of two words does, and how often it reaches its target."""
    if operation == COMPARE:
        return lambda state: operations.subtract(state, target.read(state), read(state)), 1
    compute = ARITHMETIC[operation]
    return lambda state: target.write(state, compute(state, target.read(state), read(state))), 2


def _changed(compute: Callable[[State, int], int], operand: Operand) -> Execute:
    return lambda state: operand.write(state, compute(state, operand.read(state)))


def _moved(target: Operand, source: Operand) -> Execute:
    return lambda state: target.write(state, source.read(state))


def _constant(word: int) -> Operand:
    """Return what can be read only."""

    def write(_state: State, _word: int) -> None:
        raise AssertionError("an immediate word is never written")

    return Operand(lambda _state: word, write)


def _arithmetic(code: bytes, segment: int | None) -> Decoded:
    by_rm, named = by_modrm(code[1:], segment), register(code[1] >> 3 & 7)
    to_memory = not code[0] & 2
    target, source = (by_rm, named) if to_memory else (named, by_rm)
    execute, accesses = _combined(code[0] >> 3, target, source.read)
    return _on(opcode_form(code), 1 + by_rm.length, by_rm, accesses if to_memory else 1, execute)


def _arithmetic_accumulator(code: bytes, _segment: int | None) -> Decoded:
    execute, _ = _combined(code[0] >> 3, register(AX), _constant(word_at(code, 1)).read)
    return plain(opcode_form(code), 3, execute)


def _arithmetic_immediate(code: bytes, segment: int | None) -> Decoded:
    if group_form(code) not in FORMS:
        raise UnknownForm
    operand, short = by_modrm(code[1:], segment), code[0] == 0x83
    at = 1 + operand.length
    word = signed_byte(code[at]) & 0xFFFF if short else word_at(code, at)
    execute, accesses = _combined(code[1] >> 3 & 7, operand, _constant(word).read)
    return _on(group_form(code), at + (1 if short else 2), operand, accesses, execute)


def _unary(code: bytes, segment: int | None) -> Decoded:
    form, operand = group_form(code), by_modrm(code[1:], segment)
    if form == MULTIPLY:
        decoded = _on(form, 1 + operand.length, operand, 1, lambda s: operations.multiply(s, operand.read(s)))
        return decoded._replace(most=decoded.most + MULTIPLY_MOST)
    if form not in UNARY:
        raise UnknownForm
    return _on(form, 1 + operand.length, operand, 2, _changed(UNARY[form], operand))


def _step_register(code: bytes, _segment: int | None) -> Decoded:
    compute = operations.decrement if code[0] & 8 else operations.increment
    return plain(f"{code[0] & ~7:02X}", 1, _changed(compute, register(code[0] & 7)))


def _widen(_code: bytes, _segment: int | None) -> Decoded:
    return plain("99", 1, operations.widen)


def _move(code: bytes, segment: int | None) -> Decoded:
    by_rm, named = by_modrm(code[1:], segment), register(code[1] >> 3 & 7)
    execute = _moved(named, by_rm) if code[0] & 2 else _moved(by_rm, named)
    return _on(opcode_form(code), 1 + by_rm.length, by_rm, 1, execute)


def _move_accumulator(code: bytes, segment: int | None) -> Decoded:
    there, ax = direct(word_at(code, 1), segment, 2), register(AX)
    execute = _moved(there, ax) if code[0] & 2 else _moved(ax, there)
    return _on(opcode_form(code), 3, there, 1, execute)


def _move_immediate(code: bytes, segment: int | None) -> Decoded:
    """The operation that ModRM has is not looked at."""
    operand = by_modrm(code[1:], segment)
    at = 1 + operand.length
    return _on(opcode_form(code), at + 2, operand, 1, _moved(operand, _constant(word_at(code, at))))


def _move_word(code: bytes, _segment: int | None) -> Decoded:
    return plain("B8", 3, _moved(register(code[0] & 7), _constant(word_at(code, 1))))


def _move_byte(code: bytes, _segment: int | None) -> Decoded:
    """AL, CL, DL, BL, then the high bytes of the same registers."""
    number, keeps = code[0] & 3, 0x00FF if code[0] & 4 else 0xFF00
    byte = code[1] << 8 if code[0] & 4 else code[1]

    def execute(state: State) -> None:
        state.registers[number] = state.registers[number] & keeps | byte

    return plain("B0", 2, execute)


DECODERS: dict[int, Decoder] = {
    **{operation << 3 | kind: _arithmetic for operation in (*ARITHMETIC, COMPARE) for kind in (1, 3)},
    **{operation << 3 | 5: _arithmetic_accumulator for operation in (*ARITHMETIC, COMPARE)},
    **dict.fromkeys((0x81, 0x83), _arithmetic_immediate),
    **dict.fromkeys((0xD1, 0xF7, 0xFF), _unary),
    **dict.fromkeys(range(0x40, 0x50), _step_register),
    **dict.fromkeys((0x89, 0x8B), _move),
    **dict.fromkeys((0xA1, 0xA3), _move_accumulator),
    **dict.fromkeys(range(0xB0, 0xB8), _move_byte),
    **dict.fromkeys(range(0xB8, 0xC0), _move_word),
    0x99: _widen,
    0xC7: _move_immediate,
}
"""By opcode."""
