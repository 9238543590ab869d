"""The control step on many rows of arguments, by everything that computes it: `python -m tests.hil.i8086.agreement`.

Prints how many rows agree between Numba and the 8086's machine code under Unicorn, by default 1e7, and ends with 1 at
the first that does not.
"""

import argparse
import sys
from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt

from firmware_py.joint_cpu import SIGNALS, make_step
from firmware_py.words import Words
from hil.engine.loop import WORDS
from hil.i8086.board import COUNTED
from hil.i8086.unicorn_board import UnicornBoard
from plant.compiled import machine_code_of

Rows = npt.NDArray[np.int64]
GIVEN = ("count", "count_prev", "w_prev", "d", "a_ref", "ka", "kb", "kj", "shift", "current_limit")
ANSWERED = ("w", "d", "i", "estimate", *(f"{SIGNALS[signal]} saturations" for signal in COUNTED))

EDGES = np.array([-0x8000, -0x7FFF, -0x4000, -2, -1, 0, 1, 2, 0x4000, 0x7FFE, 0x7FFF])
TABLES = ((22938, 1478, 17616, 13, 16384), (22938, 984, 23462, 14, 16384), (22938, 457, 21810, 15, 16384))
"""As in paper-joint."""
OF_A_RUN = 0.4
"""Share of rows."""
MOST_SHIFT = 63
"""The DSP sends up to 15. Machine code of 64 bits, as Numba makes it, knows no 1 << 63; Python and the 8086 go on."""

joint_step = make_step(Words)


def drawn(number: int, seed: int) -> Rows:
    """Return rows of GIVEN: whole ranges, edges, small numbers, all tables that the step can take; some as in a run."""
    chance = np.random.default_rng(seed)

    def word() -> npt.NDArray[np.int64]:
        whole, small = chance.integers(-0x8000, 0x8000, number), chance.integers(-60, 61, number)
        return np.choose(chance.integers(0, 4, number), [whole, whole, small, chance.choice(EDGES, number)])

    def near(x: npt.NDArray[np.int64], by: int) -> npt.NDArray[np.int64]:
        close = x + chance.integers(-by, by + 1, number)
        return np.where(chance.random(number) < 0.6, (close + 0x8000 & 0xFFFF) - 0x8000, word())

    count = word()
    count_prev = near(count, 300)
    w_prev = near(count - count_prev, 60)
    # a bridged cycle may leave it beside the counter's range
    count_prev = (count_prev & 0xFFFF) + chance.choice([-0x10000, 0, 0, 0], number)
    d = (word() << 16) + (word() & 0xFFFF)
    shift = np.where(
        chance.random(number) < 0.8, chance.integers(0, 17, number), chance.integers(14, MOST_SHIFT, number)
    )
    others = np.stack([word(), word(), word(), shift, np.maximum(word(), -0x7FFF)])
    of_a_run = np.array(TABLES)[chance.integers(0, len(TABLES), number)].T
    table = np.where(chance.random(number) < 0.4, of_a_run, others)
    rows = np.stack([count & 0xFFFF, count_prev, w_prev, d, word(), *table], axis=1)
    return np.where(chance.random((number, 1)) < OF_A_RUN, as_in_a_run(number, chance), rows)


def as_in_a_run(number: int, chance: np.random.Generator) -> Rows:
    """Return rows in which hardly anything saturates."""
    count, w, dw, a_ref = (chance.integers(-top, top + 1, number) for top in (0x8000, 140, 12, 600))
    d = chance.integers(-6000 << 16, 6000 << 16, number)
    table = np.array(TABLES)[chance.integers(0, len(TABLES), number)].T
    return np.stack([count & 0xFFFF, count - w & 0xFFFF, w - dw, d, a_ref, *table], axis=1)


def answers_of(step: Callable[..., tuple[int, ...]], rows: Rows) -> Rows:
    """Return rows of ANSWERED by a step as firmware_py.joint_cpu makes one."""
    words = Words(16, len(SIGNALS))

    def answers() -> Iterator[tuple[int, ...]]:
        for row in rows.tolist():
            words.saturations = counts = [0] * len(SIGNALS)
            yield *step(words, *row), *(counts[signal] for signal in COUNTED)

    return np.array(list(answers()))


def by_python(rows: Rows) -> Rows:
    """Return what the firmware's source answers, as CPython runs it."""
    return answers_of(joint_step, rows)


def answer_rows(words, rows, answers):  # type: ignore[no-untyped-def]
    """Fill in the answers; plain source, for Numba."""
    for k in range(len(rows)):
        counts = words[0].saturations
        counts[:] = 0
        count, count_prev, w_prev, d, a_ref, ka, kb, kj, shift, current_limit = rows[k]
        w, d, i, estimate = joint_step(words[0], count, count_prev, w_prev, d, a_ref, ka, kb, kj, shift, current_limit)
        answers[k, 0], answers[k, 1], answers[k, 2], answers[k, 3] = w, d, i, estimate
        answers[k, 4], answers[k, 5], answers[k, 6], answers[k, 7] = counts[2], counts[3], counts[4], counts[5]


def by_numba(rows: Rows) -> Rows:
    """Return what the same source answers as Numba compiles it."""
    words = np.zeros(1, WORDS).view(np.recarray)
    for name, value in vars(Words()).items():
        if isinstance(value, int):
            words[name] = value
    answers = np.zeros((len(rows), len(ANSWERED)), dtype=np.int64)
    machine_code_of(answer_rows)(words, rows, answers)
    return answers


def difference(rows: Rows, one: Rows, other: Rows) -> str:
    """Return the first row on which two answers differ, and how; empty if none does."""
    wrong = np.flatnonzero((one != other).any(axis=1))
    if not wrong.size:
        return ""
    k = wrong[0]
    given = ", ".join(f"{name} = {value}" for name, value in zip(GIVEN, rows[k].tolist(), strict=True))
    pairs = zip(ANSWERED, one[k].tolist(), other[k].tolist(), strict=True)
    return f"{wrong.size} rows of {len(rows)}; {given}: " + ", ".join(
        f"{n} {a}, not {b}" for n, a, b in pairs if a != b
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=10_000_000)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    board, chunk = UnicornBoard(), 100_000
    for first in range(0, asked.rows, chunk):
        rows = drawn(min(chunk, asked.rows - first), asked.seed + first)
        if wrong := difference(rows, answers_of(board.step, rows), by_numba(rows)):
            print(f"Unicorn and Numba differ in {wrong}")
            return 1
    print(f"{asked.rows} rows: 8086 machine code under Unicorn and Python by Numba agree on every one")
    return 0


if __name__ == "__main__":
    sys.exit(main())
