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
from firmware_py.words import FLOOR, Words
from hil.quantise.tap import COLUMNS
from hil.word_format import BUS_BITS, WordFormat

Raw = npt.NDArray[np.int64]

AS_IT_WAS, SATURATED, WRAPPED, UNDERFLOWED = 0, 1, 2, 3
"""What can become of a value."""

ENCODER, CURRENT, ACCELERATION = "encoder count", "current count", "acceleration count"


@dataclass(frozen=True)
class Signal:
    """A name, and the format of what is meant by it: fraction bits behind the point, of bits altogether."""

    name: str
    unit: str
    bits: int = BUS_BITS
    fraction: int = 0
    signed: bool = True
    constant: bool = False

    @property
    def q_format(self) -> str:
        """Q whole.fraction, with the sign's bit beside; UQ where there is none."""
        return f"{'Q' if self.signed else 'UQ'}{self.bits - self.fraction - self.signed}.{self.fraction}"


def step_signals(form: WordFormat) -> tuple[Signal, ...]:
    """Return the signals in the order of the step, with their formats; their fractions are those of the bus's counts.

    KJ*a_ref: behind its shift; it and KA*(i-d) are doubles, as IMUL leaves them.
    """
    bits, current = form.bits, form.current_shift
    counter = min(bits, BUS_BITS)
    in_d = current + form.d_fraction
    return (
        Signal("count", ENCODER, BUS_BITS, signed=False),
        Signal("w", f"{ENCODER} a sample", counter),
        Signal("dw", f"{ENCODER} a sample^2", counter),
        Signal("KB*dw", CURRENT, bits + form.kb_fraction, form.kb_places),
        Signal("d", CURRENT, bits + form.d_fraction, in_d),
        Signal("estimate", CURRENT, bits, current),
        Signal("a_ref", ACCELERATION, bits, form.acceleration_shift),
        Signal("KJ*a_ref", CURRENT, 2 * bits, current),
        Signal("i", CURRENT, bits, current),
        Signal("i-d", CURRENT, bits, current),
        Signal("KA*(i-d)", CURRENT, 2 * bits, in_d),
    )


ACCEL_REF = Signal("AccelRef", ACCELERATION)
"""What the DSP sends."""


def constants(form: WordFormat, shift: int) -> tuple[Signal, ...]:
    """Return the parameters KA, KB and KJ, which must fit and no more. shift: of the joint's table."""
    bits = form.constant_bits
    return (
        Signal("KA", "-", bits, form.ka_fraction, constant=True),
        Signal("KB", f"{CURRENT} per {ENCODER} a sample", bits, form.kb_places, constant=True),
        Signal("KJ", f"{CURRENT} per {ACCELERATION}", bits, form.kj_places(shift), constant=True),
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

    def __init__(self, *formats: Any) -> None:
        Words.__init__(self, *formats)
        self.kept: dict[str, list[tuple[int, int]]] = {}

    def wrap(self, signal: int, x: int) -> int:
        """Keep it."""
        return self._keep(SIGNALS[signal], x, Words.wrap(self, signal, x), WRAPPED)

    def saturate(self, signal: int, x: int) -> int:
        """Keep it."""
        return self._keep(SIGNALS[signal], x, Words.saturate(self, signal, x))

    def saturate_speed(self, signal: int, x: int) -> int:
        """Keep it."""
        return self._keep(SIGNALS[signal], x, Words.saturate_speed(self, signal, x))

    def saturate_d(self, signal: int, x: int) -> int:
        """Keep it."""
        return self._keep(SIGNALS[signal], x, Words.saturate_d(self, signal, x))

    def limit(self, signal: int, x: int, bound: int) -> int:
        """Keep it; a law's limit saturates, whatever overflows do."""
        return self._keep(SIGNALS[signal], x, Words.limit(self, signal, x, bound), SATURATED)

    def whole(self, signal: int, d: int) -> int:
        """Keep it; of less than a count nothing is left."""
        y, overflowed = self._counted(Words.whole, signal, d)
        lost = _lost(d, y, self.d_fraction, self.round_estimate)
        return self._keep_as("estimate", y, self._overflow if overflowed else lost)

    def reference_current(self, x: int, shift: int) -> int:
        """Keep it."""
        y = Words.reference_current(self, x, shift)
        return self._keep_as("KJ*a_ref", y, _lost(x, y, shift, self.round_reference))

    def current_in_d(self, x: int) -> int:
        """Keep it."""
        y = Words.current_in_d(self, x)
        return self._keep_as("KA*(i-d)", y, _lost(x, y, self.current_places, self.round_d))

    def acceleration_from_bus(self, signal: int, x: int) -> int:
        """Keep it."""
        y, overflowed = self._counted(Words.acceleration_from_bus, signal, x)
        lost = UNDERFLOWED if x != 0 and y == 0 else AS_IT_WAS
        return self._keep_as("a_ref", y, self._overflow if overflowed else lost)

    def current_to_bus(self, signal: int, x: int) -> int:
        """Say of the current, or the estimate, that was kept last that the bus has no room for it."""
        y, overflowed = self._counted(Words.current_to_bus, signal, x)
        if overflowed:
            kept = self.kept[SIGNALS[signal]]
            kept[-1] = kept[-1][0], self._overflow
        return y

    def _counted(self, operation: Any, signal: int, x: int) -> tuple[int, bool]:
        """Return what an operation does, and whether it counts that as an overflow."""
        before = self.saturations[signal]
        y: int = operation(self, signal, x)
        return y, self.saturations[signal] > before

    @property
    def _overflow(self) -> int:
        return WRAPPED if self.wraps_over else SATURATED

    def _keep(self, name: str, x: int, y: int, otherwise: int | None = None) -> int:
        return self._keep_as(name, y, AS_IT_WAS if y == x else self._overflow if otherwise is None else otherwise)

    def _keep_as(self, name: str, y: int, became: int) -> int:
        self.kept.setdefault(name, []).append((y, became))
        return y


def _lost(x: int, y: int, places: int, rounding: int) -> int:
    """Return UNDERFLOWED where something became nothing: 0, or the -1 that a floor makes of less than a unit."""
    nothing = y == 0 or (rounding == FLOOR and y == -1 and x > -(1 << max(places, 0)))
    return UNDERFLOWED if x != 0 and nothing else AS_IT_WAS


def replay(samples: Raw, words: TracedWords) -> dict[str, Trace]:
    """Return every signal of the steps that were given these samples (rows of COLUMNS); d has two values in each."""
    step = make_step(TracedWords)
    for row in samples[:, 1:].tolist():
        step(words, *row)
    column = dict(zip(COLUMNS, samples.T, strict=True))
    traces = {name: Trace.of(*zip(*kept, strict=True)) for name, kept in words.kept.items()}
    past_its_end = column["count_prev"] + traces["w"].raw != column["count"]
    traces["count"] = Trace.of(column["count"], np.where(past_its_end, WRAPPED, AS_IT_WAS))
    return traces
