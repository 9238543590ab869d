"""The 8086 in Python: one instruction after the other, with the clocks that each takes.

It answers what registers, flags and memory become as silicon does (tests/hil/i8086/test_captures.py), for the forms of
hil/i8086/clocks.py.
"""

from collections.abc import Callable

from hil.errors import NodeError
from hil.i8086.decode import decode
from hil.i8086.decoded import Execute, UnknownForm
from hil.i8086.state import CS, MEMORY_BYTES, State

Known = tuple[int, bytes, int, int, Execute]


class MachineCodeError(NodeError):
    """Machine code that is not known, or does not come to its end."""


class Interpreter(State):
    """An 8086 that runs what is in its memory, from segments[CS] and ip on."""

    def __init__(
        self, memory: bytearray, read_port: Callable[[int], int], write_port: Callable[[int, int], None]
    ) -> None:
        super().__init__(memory, read_port, write_port)
        self._known: dict[int, Known] = {}

    def step(self) -> None:
        """Carry out one instruction; raise MachineCodeError, with nothing changed, at one that is not known."""
        known = self._known.get(self.segments[CS] << 16 | self.ip)
        if known is None or not self.memory.startswith(known[1], known[0]):
            known = self._look()
        _, _, self.ip, clocks, execute = known
        self.clocks += clocks
        self.instructions += 1
        execute(self)

    def _look(self) -> Known:
        """Return the instruction at CS:IP: its address and bytes, the next IP, its clocks, and how to carry it out.

        It is known again by its bytes, which may change, but not where it wraps at the end of its segment or of memory.
        """
        code, cs, ip = self.code(), self.segments[CS], self.ip
        try:
            decoded = decode(code)
        except UnknownForm:
            raise MachineCodeError(self._unknown(code)) from None
        address, end = (cs << 4) + ip, ip + decoded.length
        known = address, code[: decoded.length], end & 0xFFFF, decoded.clocks, decoded.execute
        if end <= 0x10000 and address + decoded.length <= MEMORY_BYTES:
            self._known[cs << 16 | ip] = known
        return known

    def run(self, until: int, most: int = 10_000) -> None:
        """Run to ip = until, which is not carried out; raise MachineCodeError where most instructions do not do."""
        for _ in range(most):
            if self.ip == until:
                return
            self.step()
        if self.ip != until:
            raise MachineCodeError(
                f"8086: {most} instructions did not lead to {self.segments[CS]:04X}:{until:04X}, the last to "
                f"{self._place()}: end the loop there, or allow more than {most}"
            )

    def _unknown(self, code: bytes) -> str:
        return (
            f"8086: opcode {code[0]:02X} at {self._place()}, bytes {code.hex(' ').upper()}, is none that the "
            "interpreter knows: use the forms of hil/i8086/clocks.py, or look who jumps there"
        )

    def _place(self) -> str:
        return f"{self.segments[CS]:04X}:{self.ip:04X}"
