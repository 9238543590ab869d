"""A processor before a few bytes of code, and what words mean: for tests against closed forms."""

from hypothesis import strategies as st

from hil.i8086.interpreter import Interpreter
from hil.i8086.state import AF, DS, ES, MEMORY_BYTES, OF, PF, REGISTERS, SF, SS, ZF

CODE_AT = 0x100
MEMORY = bytearray(MEMORY_BYTES)
"""Of all examples; each puts its code first."""

words = st.one_of(st.sampled_from((0, 1, 0x7FFF, 0x8000, 0xFFFF, 0x000F, 0x0010)), st.integers(0, 0xFFFF))


def refuse(*_: int) -> int:
    raise AssertionError("no port instruction here")


def cpu_with(code: bytes, **registers: int) -> Interpreter:
    """Return a processor before this code, in segment 0, with other segments elsewhere."""
    cpu = Interpreter(MEMORY, refuse, refuse)
    MEMORY[CODE_AT : CODE_AT + len(code)] = code
    cpu.ip = CODE_AT
    cpu.segments[DS], cpu.segments[SS], cpu.segments[ES] = 0x2000, 0x3000, 0x4000
    for name, value in registers.items():
        cpu.registers[REGISTERS.index(name)] = value
    return cpu


def stepped(code: bytes, carry: int = 0, **registers: int) -> Interpreter:
    """Return a processor after one instruction. carry: CF before it; all other flags are set."""
    cpu = cpu_with(code, **registers)
    cpu.flags = cpu.flags | PF | AF | ZF | SF | OF | carry
    cpu.step()
    return cpu


def signed(word: int) -> int:
    return word - 0x10000 if word >= 0x8000 else word


def fits(x: int) -> bool:
    return -0x8000 <= x <= 0x7FFF
