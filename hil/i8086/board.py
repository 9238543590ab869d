"""A joint's 8086 board: memory and ports around whatever executes its machine code."""

from abc import ABC, abstractmethod
from typing import Any

from firmware_py.joint_cpu import CURRENT, ERROR, KB_DW, D
from hil.i8086 import image

NOTHING = 0xFFFF
"""What the bus reads where nobody drives it."""
COUNTED = (KB_DW, D, CURRENT, ERROR)
"""Signals, in the order of the machine code's counters."""


class Board(ABC):
    """One board. Its `step` has the signature of firmware_py.joint_cpu.make_step's and takes its place.

    memory: the first four pages. The encoder's port shows `count`; what the DAC's was given last is `current`.
    given, answered, saturated: arguments and results of the last step, and whether anything saturated in it.
    """

    def __init__(self, memory: bytearray | memoryview) -> None:
        self.memory = memory
        self.count = 0
        self.current = 0
        self.given: tuple[int, ...] = (0,) * 10
        self.answered: tuple[int, ...] = (0,) * 4
        self.saturated = False
        self._counters = [0] * len(COUNTED)
        image.load(memory)

    def step(self, words: Any, count: int, count_prev: int, w_prev: int, d: int, *rest: int) -> tuple[int, ...]:
        """Run the control interrupt on these numbers; return (w, d, i, estimate), and count saturations in `words`."""
        memory = self.memory
        self.count = count
        self.given = (count, count_prev, w_prev, d, *rest)
        image.PARAMETERS.pack_into(memory, image.DATA_AT, count_prev & 0xFFFF, w_prev, d, *rest)
        self.interrupt()
        w, d, i, estimate, *counters = image.RESULTS.unpack_from(memory, image.RESULTS_AT)
        self.saturated = counters != self._counters
        if self.saturated:
            for signal, was, is_ in zip(COUNTED, self._counters, counters, strict=True):
                words.saturations[signal] += (is_ - was) & 0xFFFF
            self._counters = counters
        self.answered = w, d, i, estimate
        return self.answered

    @property
    @abstractmethod
    def clocks(self) -> int:
        """Clocks of the last step's interrupt, from its acknowledgement to its IRET."""

    @abstractmethod
    def interrupt(self) -> None:
        """Execute the control interrupt, once."""

    def read(self, port: int) -> int:
        """Answer IN; nothing is at another port than the encoder's."""
        return self.count if port == image.ENCODER else NOTHING

    def write(self, port: int, value: int) -> None:
        """Answer OUT; the interrupt controller's port is written to, too, and does nothing here."""
        if port == image.DAC:
            self.current = value
