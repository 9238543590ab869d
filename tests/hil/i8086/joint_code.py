"""The joint's machine code, entered as it stands: rows of the step's inputs run on the interpreter."""

import struct
from pathlib import Path

from hil.i8086.interpreter import Interpreter
from hil.i8086.state import CS, DS, MEMORY_BYTES, SP, SS

CODE = (Path(__file__).parents[3] / "firmware_py" / "targets" / "i8086" / "joint.bin").read_bytes()
INTERRUPT, STEP = struct.unpack_from("<HH", CODE)
INPUTS = struct.Struct("<HHhihhhhHh")
"""count, count_prev, w_prev, d, a_ref, ka, kb, kj, shift, current_limit, from DS:0 on."""
STACK, END = 0x1000, 0xF000

Row = tuple[int, ...]


def no_port(*_: int) -> int:
    raise AssertionError("the step uses no port")


class StepCode:
    """The step, with code, data and stack in segments of their own."""

    def __init__(self) -> None:
        self.cpu = Interpreter(bytearray(MEMORY_BYTES), no_port, no_port)
        self.cpu.segments[CS], self.cpu.segments[DS], self.cpu.segments[SS] = 0x1000, 0x2000, 0x3000
        self.cpu.memory[0x10000 : 0x10000 + len(CODE)] = CODE

    def __call__(self, row: Row) -> tuple[int, int]:
        """Return clocks and instructions of one step, its return among them."""
        cpu = self.cpu
        INPUTS.pack_into(cpu.memory, 0x20000, *row)
        cpu.registers[SP] = STACK
        cpu.push(END)
        cpu.ip, cpu.clocks, cpu.instructions = STEP, 0, 0
        cpu.run(END)
        return cpu.clocks, cpu.instructions
