"""What the bytes of an instruction mean: its form, length and clocks, where it goes on, and how to carry it out.

The meaning does not depend on where the bytes stand, so that of the same bytes is found once.

Ref: Intel 8086 Family User's Manual 1979, tables 4-12, 4-13.
Not implemented: what the joint CPU's code has no use for, as bytes in memory, strings, far calls and division.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

from hil.i8086 import operations
from hil.i8086.clocks import FORMS, MULTIPLY_MOST, ODD_WORD, PREFIX, TAKEN
from hil.i8086.operands import Operand, Read, by_modrm, direct, register, signed_byte, word_at
from hil.i8086.state import ALWAYS_ONE, AX, CF, CS, FLAGS, OF, SF, ZF, State

NEXT, JUMP, BRANCH, CALL, RETURN = range(5)
"""Where it goes on: behind itself; elsewhere by its displacement, always or perhaps; there, and back; to who called."""

Execute = Callable[[State], object]


class Decoded(NamedTuple):
    """An instruction. clocks: without what its operands add, which is least to most on an even stack."""

    form: str
    length: int
    clocks: int
    execute: Execute
    least: int = 0
    most: int = 0
    goes: int = NEXT
    displacement: int = 0


class UnknownForm(Exception):
    """Bytes that are no instruction of ours."""


PREFIXES = {0x26: 0, 0x2E: 1, 0x36: 2, 0x3E: 3}
"""Segment overrides."""


@lru_cache(maxsize=8192)
def decode(code: bytes) -> Decoded:
    """Return the instruction that code, state.LONGEST bytes, begins with; raise UnknownForm."""
    segment = PREFIXES.get(code[0])
    if segment is None:
        return _decode(code, None)
    decoded = _decode(code[1:], segment)
    return decoded._replace(length=decoded.length + 1, clocks=decoded.clocks + PREFIX)


def _decode(code: bytes, segment: int | None) -> Decoded:
    decoder = DECODERS.get(code[0])
    if decoder is None:
        raise UnknownForm
    return decoder(code, segment)


# -- one operand or two --

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


def _on(form: str, length: int, operand: Operand, accesses: int, execute: Execute, more: int = 0) -> Decoded:
    """Return an instruction on a register, or so many accesses to memory. more: clocks that it may take besides."""
    if form not in FORMS:
        raise UnknownForm
    clocks = FORMS[form]
    if operand.address is None:
        return Decoded(form, length, clocks.register, execute, 0, more)
    odd = ODD_WORD * accesses
    least, most = (0, odd) if operand.offset is None else (odd * (operand.offset & 1),) * 2
    return Decoded(form, length, clocks.memory + operand.address, execute, least, most + more)


def _combined(operation: int, target: Operand, read: Read) -> tuple[Execute, int]:
    """Return what an arithmetic operation of two words does, and how often it reaches its target."""
    if operation == COMPARE:
        return lambda state: operations.subtract(state, target.read(state), read(state)), 1
    compute = ARITHMETIC.get(operation)
    if compute is None:
        raise UnknownForm
    return lambda state: target.write(state, compute(state, target.read(state), read(state))), 2


def _arithmetic(code: bytes, segment: int | None) -> Decoded:
    form, operation, kind = f"{code[0]:02X}", code[0] >> 3, code[0] & 7
    if kind == 5:
        word = word_at(code, 1)
        execute, _ = _combined(operation, register(AX), lambda _state: word)
        return Decoded(form, 3, FORMS[form].register, execute)
    by_rm, named = by_modrm(code[1:], segment), register(code[1] >> 3 & 7)
    if kind == 1:
        execute, accesses = _combined(operation, by_rm, named.read)
    else:
        execute, accesses = _combined(operation, named, by_rm.read)[0], 1
    return _on(form, 1 + by_rm.length, by_rm, accesses, execute)


def _arithmetic_immediate(code: bytes, segment: int | None) -> Decoded:
    operand, operation = by_modrm(code[1:], segment), code[1] >> 3 & 7
    at = 1 + operand.length
    short = code[0] == 0x83
    word = signed_byte(code[at]) & 0xFFFF if short else word_at(code, at)
    execute, accesses = _combined(operation, operand, lambda _state: word)
    return _on(_group(code), at + (1 if short else 2), operand, accesses, execute)


def _unary(code: bytes, segment: int | None) -> Decoded:
    form, operand = _group(code), by_modrm(code[1:], segment)
    if form == "F7.5":
        return _on(
            form,
            1 + operand.length,
            operand,
            1,
            lambda state: operations.multiply(state, operand.read(state)),
            MULTIPLY_MOST,
        )
    compute = UNARY.get(form)
    if compute is None:
        raise UnknownForm
    return _on(
        form, 1 + operand.length, operand, 2, lambda state: operand.write(state, compute(state, operand.read(state)))
    )


def _group(code: bytes) -> str:
    return f"{code[0]:02X}.{code[1] >> 3 & 7}"


def _step_register(code: bytes, _segment: int | None) -> Decoded:
    operand, compute = register(code[0] & 7), operations.decrement if code[0] & 8 else operations.increment
    return _plain(f"{code[0] & ~7:02X}", 1, lambda state: operand.write(state, compute(state, operand.read(state))))


def _plain(form: str, length: int, execute: Execute) -> Decoded:
    return Decoded(form, length, FORMS[form].register, execute)


# -- moves --


def _move(code: bytes, segment: int | None) -> Decoded:
    by_rm, named = by_modrm(code[1:], segment), register(code[1] >> 3 & 7)
    target, source = (by_rm, named) if code[0] == 0x89 else (named, by_rm)
    return _on(f"{code[0]:02X}", 1 + by_rm.length, by_rm, 1, lambda state: target.write(state, source.read(state)))


def _move_accumulator(code: bytes, segment: int | None) -> Decoded:
    there, ax = direct(word_at(code, 1), segment, 2), register(AX)
    target, source = (ax, there) if code[0] == 0xA1 else (there, ax)
    return _on(f"{code[0]:02X}", 3, there, 1, lambda state: target.write(state, source.read(state)))


def _move_immediate(code: bytes, segment: int | None) -> Decoded:
    operand = by_modrm(code[1:], segment)
    at = 1 + operand.length
    word = word_at(code, at)
    return _on(_group(code)[:2], at + 2, operand, 1, lambda state: operand.write(state, word))


def _move_word(code: bytes, _segment: int | None) -> Decoded:
    operand, word = register(code[0] & 7), word_at(code, 1)
    return _plain("B8", 3, lambda state: operand.write(state, word))


def _move_byte(code: bytes, _segment: int | None) -> Decoded:
    number, byte = code[0] & 3, code[1]
    high = code[0] & 4

    def execute(state: State) -> None:
        word = state.registers[number]
        state.registers[number] = word & 0xFF | byte << 8 if high else word & 0xFF00 | byte

    return _plain("B0", 2, execute)


# -- stack, ports --


def _push(code: bytes, _segment: int | None) -> Decoded:
    number = code[0] & 7

    def execute(state: State) -> None:
        # SP itself goes there as it is after, unlike in later processors
        state.push(state.registers[number] - (2 if number == 4 else 0) & 0xFFFF)

    return _plain("50", 1, execute)


def _pop(code: bytes, _segment: int | None) -> Decoded:
    operand = register(code[0] & 7)
    return _plain("58", 1, lambda state: operand.write(state, state.pop()))


def _port(code: bytes, _segment: int | None) -> Decoded:
    port, wide, out = code[1], code[0] & 1, code[0] & 2
    odd = ODD_WORD if wide and port & 1 else 0

    def execute(state: State) -> None:
        ax, mask = state.registers[AX], 0xFFFF if wide else 0xFF
        state.clocks += odd
        if out:
            state.write_port(port, ax & mask)
        else:
            state.registers[AX] = ax & ~mask | state.read_port(port) & mask

    return _plain(f"{code[0]:02X}", 2, execute)._replace(least=odd, most=odd)


# -- where it goes on --

CONDITIONS: dict[int, Callable[[int], object]] = {
    0x70: lambda flags: flags & OF,
    0x72: lambda flags: flags & CF,
    0x74: lambda flags: flags & ZF,
    0x78: lambda flags: flags & SF,
    0x7C: lambda flags: (flags >> 4 ^ flags) & SF,
    0x7E: lambda flags: flags & ZF or (flags >> 4 ^ flags) & SF,
}
"""By the even opcode; the odd one has the opposite. OF is four bits above SF."""


def _branch(code: bytes, _segment: int | None) -> Decoded:
    condition, opposite = CONDITIONS[code[0] & ~1], bool(code[0] & 1)
    displacement = signed_byte(code[1])

    def execute(state: State) -> None:
        if bool(condition(state.flags)) is not opposite:
            state.ip = state.ip + displacement & 0xFFFF
            state.clocks += TAKEN

    return _plain(f"{code[0]:02X}", 2, execute)._replace(goes=BRANCH, displacement=displacement)


def _jump(code: bytes, _segment: int | None) -> Decoded:
    short = code[0] == 0xEB
    displacement = signed_byte(code[1]) if short else word_at(code, 1)

    def execute(state: State) -> None:
        state.ip = state.ip + displacement & 0xFFFF

    return _plain(f"{code[0]:02X}", 2 if short else 3, execute)._replace(goes=JUMP, displacement=displacement)


def _call(code: bytes, _segment: int | None) -> Decoded:
    displacement = word_at(code, 1)

    def execute(state: State) -> None:
        state.push(state.ip)
        state.ip = state.ip + displacement & 0xFFFF

    return _plain("E8", 3, execute)._replace(goes=CALL, displacement=displacement)


def _return(_code: bytes, _segment: int | None) -> Decoded:
    def execute(state: State) -> None:
        state.ip = state.pop()

    return _plain("C3", 1, execute)._replace(goes=RETURN)


def _return_from_interrupt(_code: bytes, _segment: int | None) -> Decoded:
    def execute(state: State) -> None:
        state.ip = state.pop()
        state.segments[CS] = state.pop()
        state.flags = state.pop() & FLAGS | ALWAYS_ONE

    return _plain("CF", 1, execute)._replace(goes=RETURN)


def _widen(_code: bytes, _segment: int | None) -> Decoded:
    return _plain("99", 1, operations.widen)


def _halt(_code: bytes, _segment: int | None) -> Decoded:
    """What ends it is an interrupt; whoever has none goes on behind it."""
    return _plain("F4", 1, lambda _state: None)


DECODERS: dict[int, Callable[[bytes, int | None], Decoded]] = {
    **{operation << 3 | kind: _arithmetic for operation in (*ARITHMETIC, COMPARE) for kind in (1, 3, 5)},
    **dict.fromkeys((0x81, 0x83), _arithmetic_immediate),
    **dict.fromkeys((0xD1, 0xF7, 0xFF), _unary),
    **dict.fromkeys(range(0x40, 0x50), _step_register),
    **dict.fromkeys(range(0x50, 0x58), _push),
    **dict.fromkeys(range(0x58, 0x60), _pop),
    **{even | opposite: _branch for even in CONDITIONS for opposite in (0, 1)},
    **dict.fromkeys((0x89, 0x8B), _move),
    **dict.fromkeys((0xA1, 0xA3), _move_accumulator),
    **dict.fromkeys(range(0xB0, 0xB8), _move_byte),
    **dict.fromkeys(range(0xB8, 0xC0), _move_word),
    **dict.fromkeys((0xE4, 0xE5, 0xE6, 0xE7), _port),
    **dict.fromkeys((0xE9, 0xEB), _jump),
    0x99: _widen,
    0xC3: _return,
    0xC7: _move_immediate,
    0xCF: _return_from_interrupt,
    0xE8: _call,
    0xF4: _halt,
}
"""By opcode."""
