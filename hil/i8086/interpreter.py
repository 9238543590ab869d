"""The 8086 in Python: one instruction after the other, with the clocks that each takes.

It answers what registers, flags and memory become as silicon does (tests/hil/i8086/test_captures.py), for the forms of
hil/i8086/clocks.py.
"""

from hil.errors import NodeError
from hil.i8086.decode import UnknownForm, decode
from hil.i8086.state import CS, State


class MachineCodeError(NodeError):
    """Machine code that is not known, or does not come to its end."""


class Interpreter(State):
    """An 8086 that runs what is in its memory, from segments[CS] and ip on."""

    def step(self) -> None:
        """Carry out one instruction; raise MachineCodeError, with nothing changed, at one that is not known."""
        code = self.code()
        try:
            decoded = decode(code)
        except UnknownForm:
            raise MachineCodeError(self._unknown(code)) from None
        self.ip = self.ip + decoded.length & 0xFFFF
        self.clocks += decoded.clocks
        self.instructions += 1
        decoded.execute(self)

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
