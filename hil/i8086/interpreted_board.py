"""The board by our interpreter, which counts every clock."""

from hil.i8086 import image
from hil.i8086.board import Board
from hil.i8086.clocks import INTERRUPT
from hil.i8086.interpreter import Interpreter
from hil.i8086.state import CS, DS, MEMORY_BYTES, SP, SS


class InterpretedBoard(Board):
    """A board. cpu: what executes the code; its totals are those of the last interrupt, without the acknowledgement."""

    def __init__(self, interpreter: type[Interpreter] = Interpreter) -> None:
        memory = bytearray(MEMORY_BYTES)
        super().__init__(memory)
        self.cpu = interpreter(memory, self.read, self.write)
        for segment, address in ((CS, image.CODE_AT), (DS, image.DATA_AT), (SS, image.STACK_AT)):
            self.cpu.segments[segment] = address >> 4
        self.cpu.registers[SP] = image.STACK_TOP

    def interrupt(self) -> None:
        """Execute the control interrupt, once."""
        cpu = self.cpu
        for word in (cpu.flags, cpu.segments[CS], image.RETURN):
            cpu.push(word)
        cpu.ip = image.INTERRUPT
        cpu.clocks = cpu.instructions = cpu.multiplications = 0
        cpu.run(image.RETURN)

    @property
    def clocks(self) -> int:
        """Clocks of the last interrupt, from its acknowledgement to its IRET."""
        return INTERRUPT + self.cpu.clocks
