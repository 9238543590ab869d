"""A joint whose CPU is an 8086: its control step is machine code, its computing time that code's own clocks.

All around the step (frames, states, parameters) is firmware_py.joint_cpu.JointCPU as ever: CAN is not counted.
"""

from typing import Any

from firmware_py.joint_cpu import JointCPU
from hil.i8086.board import Board
from hil.i8086.interpreted_board import InterpretedBoard
from hil.i8086.unicorn_board import UnicornBoard
from hil.scenario_parts import to_ns


class Joint8086(JointCPU):
    """Joint `number` on a board with its clock. Until its first step its computing time is that declared, compute_ns.

    clocks: of every step's interrupt: their number, sum, least and most.
    """

    def __init__(self, board: Board, clock_hz: float, *arguments: Any) -> None:
        JointCPU.__init__(self, *arguments)
        self.board = board
        self.clock_hz = clock_hz
        self.step = self._step
        self.steps = self.clocks = self.least_clocks = self.most_clocks = 0

    def _step(self, words: Any, *arguments: int) -> tuple[int, ...]:
        answer = self.board.step(words, *arguments)
        clocks = self.board.clocks
        self.least_clocks = min(clocks, self.least_clocks) if self.steps else clocks
        self.most_clocks = max(clocks, self.most_clocks)
        self.clocks += clocks
        self.steps += 1
        self.compute_ns = to_ns(clocks / self.clock_hz)
        return answer

    def report(self) -> dict[str, Any]:
        """Counters by cause; clocks of a control interrupt: least, mean and most."""
        mean = round(self.clocks / max(self.steps, 1), 3)
        return {**JointCPU.report(self), "clocks": {"least": self.least_clocks, "mean": mean, "most": self.most_clocks}}


def make_board() -> Board:
    """Return a board by Unicorn where it is installed, else by the interpreter: the same answers and clocks."""
    try:
        return UnicornBoard()
    except ImportError:
        return InterpretedBoard()
