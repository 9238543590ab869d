"""The board by Unicorn, which translates the machine code into this host's: ten times as fast as interpreting it.

Unicorn knows no clocks: they are those of the straight line, and where something saturates the interpreter executes the
step again, and counts.

Unicorn is a later x86 in 16-bit mode: joint.asm has nothing in which that differs from the 8086.
"""

import ctypes
import mmap
from collections.abc import Callable
from typing import Any

from hil.i8086 import image
from hil.i8086.board import Board
from hil.i8086.straight_line import executed_clocks, straight_clocks

CALL_AT = 0xF00
"""In the code segment: PUSHF, PUSH CS, CALL interrupt, which leaves on the stack what an interrupt does; HLT, where
Unicorn stops: given an address to stop at it would translate the block anew for each call."""
PUSHF, PUSH_CS, CALL = 0x9C, 0x0E, 0xE8
NEVER = 0xFFFFF
"""An address to stop at that is not reached."""


class UnicornBoard(Board):
    """A board; raises ImportError where Unicorn is not installed."""

    def __init__(self) -> None:
        self._pages = mmap.mmap(-1, image.END)
        super().__init__(memoryview(self._pages))
        behind = CALL_AT + 5
        call = bytes([PUSHF, PUSH_CS, CALL, *(image.INTERRUPT - behind & 0xFFFF).to_bytes(2, "little"), image.HLT])
        self.memory[image.CODE_AT + CALL_AT : image.CODE_AT + CALL_AT + len(call)] = call
        self._engine = engine_of(self._pages, self.read, self.write)

    def interrupt(self) -> None:
        """Execute the control interrupt, once."""
        self._engine.emu_start(image.CODE_AT + CALL_AT, NEVER)

    @property
    def clocks(self) -> int:
        """Clocks of the last step's interrupt."""
        return executed_clocks(*self.given) if self.saturated else straight_clocks(self.given, self.answered)


def engine_of(pages: mmap.mmap, read: Callable[[int], int], write: Callable[[int, int], None]) -> Any:
    """Return Unicorn on these pages as its memory from address 0 on, its ports answered by `read` and `write`."""
    import unicorn
    from unicorn import x86_const as x86

    engine: Any = unicorn.Uc(unicorn.UC_ARCH_X86, unicorn.UC_MODE_16)
    address = ctypes.addressof(ctypes.c_char.from_buffer(pages))
    engine.mem_map_ptr(0, image.END, unicorn.UC_PROT_ALL, address)
    for register, value in (
        (x86.UC_X86_REG_CS, image.CODE_AT >> 4),
        (x86.UC_X86_REG_DS, image.DATA_AT >> 4),
        (x86.UC_X86_REG_SS, image.STACK_AT >> 4),
        (x86.UC_X86_REG_SP, image.STACK_TOP),
    ):
        engine.reg_write(register, value)
    for instruction, answer in (
        (x86.UC_X86_INS_IN, lambda _engine, port, _size, _data: read(port)),
        (x86.UC_X86_INS_OUT, lambda _engine, port, _size, value, _data: write(port, value)),
    ):
        engine.hook_add(unicorn.UC_HOOK_INSN, answer, None, 1, 0, instruction)
    return engine
