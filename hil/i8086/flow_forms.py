"""Instructions that go elsewhere, use the stack, or a port.

Ref: Intel 8086 Family User's Manual 1979, chapter 4, machine instruction encoding and decoding.
"""

from collections.abc import Callable

from hil.i8086.clocks import ODD_WORD, TAKEN
from hil.i8086.decoded import BRANCH, CALL, JUMP, RETURN, Decoded, Decoder, opcode_form, plain
from hil.i8086.operands import register, signed_byte, word_at
from hil.i8086.state import ALWAYS_ONE, AX, CF, CS, FLAGS, OF, SF, SP, ZF, State

CONDITIONS: dict[int, Callable[[int], int]] = {
    0x70: lambda flags: flags & OF,
    0x72: lambda flags: flags & CF,
    0x74: lambda flags: flags & ZF,
    0x78: lambda flags: flags & SF,
    0x7C: lambda flags: (flags >> 4 ^ flags) & SF,  # OF is four bits above SF
    0x7E: lambda flags: flags & ZF | (flags >> 4 ^ flags) & SF,
}
"""By the even opcode; the odd one has the opposite."""


def _branch(code: bytes, _segment: int | None) -> Decoded:
    condition, opposite = CONDITIONS[code[0] & ~1], bool(code[0] & 1)
    displacement = signed_byte(code[1])

    def execute(state: State) -> None:
        if bool(condition(state.flags)) is not opposite:
            state.ip = state.ip + displacement & 0xFFFF
            state.clocks += TAKEN

    return plain(opcode_form(code), 2, execute)._replace(goes=BRANCH, displacement=displacement)


def _jump(code: bytes, _segment: int | None) -> Decoded:
    short = code[0] == 0xEB
    displacement = signed_byte(code[1]) if short else word_at(code, 1)

    def execute(state: State) -> None:
        state.ip = state.ip + displacement & 0xFFFF

    return plain(opcode_form(code), 2 if short else 3, execute)._replace(goes=JUMP, displacement=displacement)


def _call(code: bytes, _segment: int | None) -> Decoded:
    displacement = word_at(code, 1)

    def execute(state: State) -> None:
        state.push(state.ip)
        state.ip = state.ip + displacement & 0xFFFF

    return plain("E8", 3, execute)._replace(goes=CALL, displacement=displacement)


def _return(_code: bytes, _segment: int | None) -> Decoded:
    def execute(state: State) -> None:
        state.ip = state.pop()

    return plain("C3", 1, execute)._replace(goes=RETURN)


def _return_from_interrupt(_code: bytes, _segment: int | None) -> Decoded:
    def execute(state: State) -> None:
        state.ip = state.pop()
        state.segments[CS] = state.pop()
        state.flags = state.pop() & FLAGS | ALWAYS_ONE

    return plain("CF", 1, execute)._replace(goes=RETURN)


def _push(code: bytes, _segment: int | None) -> Decoded:
    number = code[0] & 7

    def execute(state: State) -> None:
        # SP goes there as it is after, unlike in later processors.
        state.push(state.registers[number] - (2 if number == SP else 0) & 0xFFFF)

    return plain("50", 1, execute)


def _pop(code: bytes, _segment: int | None) -> Decoded:
    operand = register(code[0] & 7)
    return plain("58", 1, lambda state: operand.write(state, state.pop()))


def _port(code: bytes, _segment: int | None) -> Decoded:
    """A word at an odd port takes two bus cycles, as in memory."""
    port, mask, out = code[1], 0xFFFF if code[0] & 1 else 0xFF, code[0] & 2
    odd = ODD_WORD if code[0] & 1 and port & 1 else 0

    def execute(state: State) -> None:
        ax = state.registers[AX]
        state.clocks += odd
        if out:
            state.write_port(port, ax & mask)
        else:
            state.registers[AX] = ax & ~mask | state.read_port(port) & mask

    return plain(opcode_form(code), 2, execute)._replace(least=odd, most=odd)


def _halt(_code: bytes, _segment: int | None) -> Decoded:
    """An interrupt ends it; where there is none, it goes on behind itself."""
    return plain("F4", 1, lambda _state: None)


DECODERS: dict[int, Decoder] = {
    **{even | opposite: _branch for even in CONDITIONS for opposite in (0, 1)},
    **dict.fromkeys(range(0x50, 0x58), _push),
    **dict.fromkeys(range(0x58, 0x60), _pop),
    **dict.fromkeys((0xE4, 0xE5, 0xE6, 0xE7), _port),
    **dict.fromkeys((0xE9, 0xEB), _jump),
    0xC3: _return,
    0xCF: _return_from_interrupt,
    0xE8: _call,
    0xF4: _halt,
}
"""By opcode."""
