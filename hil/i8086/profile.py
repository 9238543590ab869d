"""What the control step takes as machine code: every step of a run, instruction by instruction, on boards that count.

The step is all between its first instruction and its RET, that one included; the CALL is the interrupt's. Each clock
belongs to one kind of instruction, by its form; those of the interrupt's acknowledgement belong to none.
"""

from collections.abc import Iterable
from functools import cache
from statistics import fmean
from typing import Any, NamedTuple

from hil.i8086 import image
from hil.i8086.clocks import INTERRUPT
from hil.i8086.decode import decode
from hil.i8086.interpreted_board import InterpretedBoard
from hil.i8086.interpreter import Interpreter
from hil.i8086.joint import Joint8086
from hil.i8086.state import LONGEST, SP
from hil.node import Node
from hil.rig import Outcome, Progress, directly, no_progress, run_inline
from hil.scenario import Scenario
from hil.wire.kernel import Kernel

IMUL, ADD, ACKNOWLEDGE = "IMUL", "ADD, SUB", "acknowledge"
KINDS = {
    IMUL: "F7.5",
    ADD: "01 03 05 11 13 15 19 1B 1D 29 2B 2D 81.0 81.2 81.3 81.5 83.0 83.2 83.3 83.5",
    "shift": "D1.2 D1.4 D1.7",
    "move": "89 8B A1 A3 B0 B8 C7",
    "decide": "31 33 35 39 3B 3D 81.6 81.7 83.7 40 48 FF.0 FF.1 F7.3 99 70 71 72 73 74 75 78 79 7C 7D 7E 7F E9 EB F4",
    "stack": "50 58 E8 C3 CF",
    "ports": "E4 E5 E6 E7",
}
"""Forms by kind. ADD, SUB: with carry or borrow, too; decide: to ask whether something saturates or a loop ends, and
what follows from it."""


class Taken(NamedTuple):
    """What one control interrupt took, its acknowledgement included; step_clocks and all behind it: its step alone.

    multiplications: IMUL; additions: ADD, ADC, SUB and SBB, whatever they are for.
    """

    clocks: int
    instructions: int
    step_clocks: int
    step_instructions: int
    multiplications: int
    additions: int


class Spread(NamedTuple):
    """The least, mean and most of all steps; None where there was no step."""

    least: int | None
    mean: float | None
    most: int | None

    @classmethod
    def of(cls, values: Iterable[int]) -> "Spread":
        """Return that of these values."""
        seen = list(values)
        return cls(min(seen), fmean(seen), max(seen)) if seen else cls(None, None, None)


class CountingInterpreter(Interpreter):
    """An 8086 that notes what it executes where in the code. spent: clocks by offset; sp: the lowest of the stack.

    step_clocks, step_instructions, additions: of the control step, since they were set to 0.
    """

    def __init__(self, *arguments: Any) -> None:
        Interpreter.__init__(self, *arguments)
        self.spent = [0] * len(image.CODE)
        self.sp = image.STACK_TOP
        self.step_clocks = self.step_instructions = self.additions = 0

    def step(self) -> None:
        """Carry out one instruction."""
        at, before = self.ip, self.clocks
        Interpreter.step(self)
        clocks = self.clocks - before
        self.spent[at] += clocks
        if self.registers[SP] < self.sp:
            self.sp = self.registers[SP]
        if at >= image.STEP:
            self.step_clocks += clocks
            self.step_instructions += 1
            self.additions += kind_at(at) == ADD


class CountingBoard(InterpretedBoard):
    """A board. taken: by every step; saturated_steps: those in which anything saturated."""

    cpu: CountingInterpreter

    def __init__(self) -> None:
        InterpretedBoard.__init__(self, CountingInterpreter)
        self.taken: list[Taken] = []
        self.saturated_steps = 0

    def step(self, words: Any, *given: int) -> tuple[int, ...]:
        """Run the control interrupt, and note what it took."""
        cpu = self.cpu
        cpu.step_clocks = cpu.step_instructions = cpu.additions = 0
        answer = InterpretedBoard.step(self, words, *given)
        of_step = cpu.step_clocks, cpu.step_instructions, cpu.multiplications, cpu.additions
        self.taken.append(Taken(self.clocks, cpu.instructions, *of_step))
        self.saturated_steps += self.saturated
        return answer

    def spread(self, what: str) -> Spread:
        """Return the least, mean and most of a field of Taken."""
        return Spread.of(getattr(taken, what) for taken in self.taken)

    def clocks_by_kind(self) -> dict[str, int]:
        """Return the clocks of all interrupts together, by kind of instruction."""
        found = dict.fromkeys(KINDS, 0)
        for at, clocks in enumerate(self.cpu.spent):
            if clocks:
                found[kind_at(at)] += clocks
        return {**found, ACKNOWLEDGE: INTERRUPT * len(self.taken)}

    @property
    def stack_bytes(self) -> int:
        """The most that was on the stack, the flags, CS and IP of the interrupt included."""
        return image.STACK_TOP - self.cpu.sp


@cache
def kind_at(at: int) -> str:
    """Return the kind of the instruction at an offset of the code."""
    form = decode(image.CODE[at : at + LONGEST].ljust(LONGEST, b"\0")).form
    return next(kind for kind, forms in KINDS.items() if form in forms.split())


def profile(scenario: Scenario, progress: Progress = no_progress) -> tuple[Outcome, dict[int, CountingBoard]]:
    """Run a scenario whose joints are all of machine code; return the board of each joint, 1 to n, behind it."""
    boards: dict[int, CountingBoard] = {}

    def seat(kernel: Kernel, node: Node) -> None:
        if isinstance(node, Joint8086):
            node.board = boards[node.number] = CountingBoard()
        directly(kernel, node)

    return run_inline(scenario, progress, seat=seat), boards
