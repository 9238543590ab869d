"""The named signals of the joint CPU, each with its format; and what they were in every step of a run.

The steps are replayed on words that keep what each operation returned, and what became of the value. Underflow:
something other than zero of which a shift to the right leaves nothing: zero, or the -1 that a floor makes of less than
a count.

Ref: ARCHITECTURE.md, signals and Q formats of the joint CPU.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from firmware_py.joint_cpu import SIGNALS, make_step
from firmware_py.words import Words
from hil.quantise.tap import COLUMNS

Raw = npt.NDArray[np.int64]

WORD_BITS = 16
AS_IT_WAS, SATURATED, WRAPPED, UNDERFLOWED = 0, 1, 2, 3
"""What can become of a value."""

ENCODER, CURRENT, ACCELERATION = "encoder count", "current count", "acceleration count"


@dataclass(frozen=True)
class Signal:
    """A name, and the format of what is meant by it: fraction bits behind the point, of bits altogether."""

    name: str
    unit: str
    bits: int = WORD_BITS
    fraction: int = 0
    signed: bool = True
    constant: bool = False

    @property
    def q_format(self) -> str:
        """Q whole.fraction, with the sign's bit beside; UQ where there is none."""
        return f"{'Q' if self.signed else 'UQ'}{self.bits - self.fraction - self.signed}.{self.fraction}"


STEP_SIGNALS = (
    Signal("count", ENCODER, signed=False),
    Signal("w", f"{ENCODER} a sample"),
    Signal("dw", f"{ENCODER} a sample^2"),
    Signal("KB*dw", CURRENT),
    Signal("d", CURRENT, bits=2 * WORD_BITS, fraction=WORD_BITS),
    Signal("estimate", CURRENT),
    Signal("a_ref", ACCELERATION),
    Signal("KJ*a_ref", CURRENT, bits=2 * WORD_BITS),
    Signal("i", CURRENT),
    Signal("i-d", CURRENT),
    Signal("KA*(i-d)", CURRENT, bits=2 * WORD_BITS, fraction=WORD_BITS),
)
"""In the order of the step. KJ*a_ref: behind its shift; it and KA*(i-d) are doubles, as IMUL leaves them."""
ACCEL_REF = Signal("AccelRef", ACCELERATION)
"""What the DSP sends."""


def constants(shift: int) -> tuple[Signal, ...]:
    """Return the parameters KA, KB and KJ, which must fit and no more. shift: of the joint's table."""
    return (
        Signal("KA", "-", fraction=WORD_BITS - 1, constant=True),
        Signal("KB", f"{CURRENT} per {ENCODER} a sample", constant=True),
        Signal("KJ", f"{CURRENT} per {ACCELERATION}", fraction=shift, constant=True),
    )


@dataclass(frozen=True)
class Trace:
    """A signal in a run: raw values in the order of time, as many of each sample, and what became of each."""

    raw: Raw
    became: Raw

    @classmethod
    def of(cls, raw: Any, became: Any = None) -> "Trace":
        """Make one; became: nothing, where it is left out."""
        raw = np.asarray(raw, dtype=np.int64)
        return cls(raw, np.zeros(len(raw), np.int64) if became is None else np.asarray(became, dtype=np.int64))


class TracedWords(Words):
    """The words of the joint CPU that keep what every operation returned, and what became of it, by signal."""

    def __init__(self, bits: int = WORD_BITS) -> None:
        self.kept: dict[str, list[tuple[int, int]]] = {signal.name: [] for signal in STEP_SIGNALS}
        Words.__init__(self, bits, len(SIGNALS))

    def _bind(self) -> None:
        Words._bind(self)
        self.wrap = self._returned(self.wrap, WRAPPED)
        self.saturate = self._returned(self.saturate, SATURATED)
        self.saturate_double = self._returned(self.saturate_double, SATURATED)
        self.limit = self._returned(self.limit, SATURATED)
        one = 1 << self.bits
        self.high_of = self._shifted("estimate", self.high_of, lambda x, _: 0 < abs(x) < one)
        self.shift_right_nearest = self._shifted("KJ*a_ref", self.shift_right_nearest, lambda x, y: x != 0 and y == 0)
        self.shift_left = self._shifted("KA*(i-d)", self.shift_left, lambda _x, _y: False)

    def _returned(self, operation: Any, otherwise: int) -> Any:
        def returned(signal: int, x: int, *bound: int) -> Any:
            y = operation(signal, x, *bound)
            self.kept[SIGNALS[signal]].append((y, otherwise if y != x else AS_IT_WAS))
            return y

        return returned

    def _shifted(self, name: str, operation: Any, underflows: Any) -> Any:
        def shifted(x: int, *count: int) -> Any:
            y = operation(x, *count)
            self.kept[name].append((y, UNDERFLOWED if underflows(x, y) else AS_IT_WAS))
            return y

        return shifted


def replay(samples: Raw) -> dict[str, Trace]:
    """Return every signal of the steps that were given these samples (rows of COLUMNS); d has two values in each."""
    words = TracedWords()
    step = make_step(words)
    for row in samples[:, 1:].tolist():
        step(*row)
    column = dict(zip(COLUMNS, samples.T, strict=True))
    traces = {name: Trace.of(*zip(*kept, strict=True)) for name, kept in words.kept.items() if kept}
    past_its_end = column["count_prev"] + traces["w"].raw != column["count"]
    traces["count"] = Trace.of(column["count"], np.where(past_its_end, WRAPPED, AS_IT_WAS))
    traces["a_ref"] = Trace.of(column["a_ref"])
    return traces
