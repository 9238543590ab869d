"""What an 8086 holds and reaches: registers, flags, 1 MiB of memory, ports, and the running totals.

Ref: Intel 8086 Family User's Manual 1979, chapter 2.
"""

from collections.abc import Callable

from hil.i8086.clocks import ODD_WORD

AX, CX, DX, BX, SP, BP, SI, DI = range(8)
REGISTERS = ("ax", "cx", "dx", "bx", "sp", "bp", "si", "di")
ES, CS, SS, DS = range(4)
SEGMENTS = ("es", "cs", "ss", "ds")
CF, PF, AF, ZF, SF, OF = 0x001, 0x004, 0x010, 0x040, 0x080, 0x800
FLAGS = 0x0FD5
"""Bits that are flags; of the others, bits 1 and 12 to 15 are read as ones."""
ALWAYS_ONE = 0xF002

MEMORY_BYTES = 1 << 20


class State:
    """Registers and segments by number, in the order of REGISTERS and SEGMENTS; words are 0 to 65535.

    Words wrap at the end of their segment, and addresses at 1 MiB. read_port, write_port: are given the port, and the
    value. clocks, instructions, multiplications: since the beginning.
    """

    def __init__(
        self, memory: bytearray, read_port: Callable[[int], int], write_port: Callable[[int, int], None]
    ) -> None:
        self.memory = memory
        self.read_port = read_port
        self.write_port = write_port
        self.registers = [0] * len(REGISTERS)
        self.segments = [0] * len(SEGMENTS)
        self.ip = 0
        self.flags = ALWAYS_ONE
        self.clocks = 0
        self.instructions = 0
        self.multiplications = 0

    def load(self, segment: int, offset: int) -> int:
        """Return the word there; one at an odd address takes a second bus cycle."""
        if offset & 1:
            self.clocks += ODD_WORD
        base = self.segments[segment] << 4
        return (
            self.memory[base + offset & MEMORY_BYTES - 1]
            | self.memory[base + (offset + 1 & 0xFFFF) & MEMORY_BYTES - 1] << 8
        )

    def store(self, segment: int, offset: int, word: int) -> None:
        """Write a word; its clocks are those of load."""
        if offset & 1:
            self.clocks += ODD_WORD
        base = self.segments[segment] << 4
        self.memory[base + offset & MEMORY_BYTES - 1] = word & 0xFF
        self.memory[base + (offset + 1 & 0xFFFF) & MEMORY_BYTES - 1] = word >> 8

    def push(self, word: int) -> None:
        """Put a word on the stack."""
        sp = self.registers[SP] = self.registers[SP] - 2 & 0xFFFF
        self.store(SS, sp, word)

    def pop(self) -> int:
        """Take a word from the stack."""
        sp = self.registers[SP]
        self.registers[SP] = sp + 2 & 0xFFFF
        return self.load(SS, sp)

    def code(self) -> bytes:
        """Return the bytes from CS:IP on, as many as the longest instruction has."""
        ip, base = self.ip, self.segments[CS] << 4
        if ip <= 0x10000 - LONGEST and base + ip <= MEMORY_BYTES - LONGEST:
            return bytes(self.memory[base + ip : base + ip + LONGEST])
        return bytes(self.memory[base + (ip + k & 0xFFFF) & MEMORY_BYTES - 1] for k in range(LONGEST))


LONGEST = 7
"""Bytes: a prefix, opcode, ModRM, displacement and immediate word."""
