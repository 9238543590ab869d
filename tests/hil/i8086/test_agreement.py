"""One firmware, many machines: the same answers on 1e5 rows of arguments, from every one, bit by bit."""

from collections.abc import Callable

import numpy as np
import pytest

from firmware_py.joint_cpu import SIGNALS
from firmware_py.words import Words
from hil.i8086.board import COUNTED, Board
from hil.i8086.interpreted_board import InterpretedBoard
from hil.i8086.unicorn_board import UnicornBoard
from tests import micropython
from tests.hil.i8086 import agreement
from tests.hil.i8086.agreement import Rows

ROWS = 100_000
FAR = 20_000
"""Rows with shifts that the 64 bits of Numba have not."""


@pytest.fixture(scope="module")
def rows() -> Rows:
    return agreement.drawn(ROWS, seed=8086)


@pytest.fixture(scope="module")
def answers(rows: Rows) -> Rows:
    """The firmware's source, as CPython runs it."""
    return agreement.by_python(rows)


@pytest.fixture(scope="module")
def interpreted(rows: Rows) -> tuple[Rows, list[int]]:
    """Answers and clocks."""
    board, clocks = InterpretedBoard(), []

    def step(words: Words, *given: int) -> tuple[int, ...]:
        answered = board.step(words, *given)
        clocks.append(board.clocks)
        return answered

    return agreement.answers_of(step, rows), clocks


def test_rows_reach_every_saturation(answers: Rows) -> None:
    assert ((answers[:, 4:] > 0).sum(axis=0) > ROWS // 1000).all()


def test_numba(rows: Rows, answers: Rows) -> None:
    assert agreement.difference(rows, agreement.by_numba(rows), answers) == ""


def test_the_interpreter(rows: Rows, answers: Rows, interpreted: tuple[Rows, list[int]]) -> None:
    assert agreement.difference(rows, interpreted[0], answers) == ""


def test_micropython(rows: Rows, answers: Rows) -> None:
    answered, saturated = micropython.steps(rows)
    found = np.concatenate([answered, saturated[:, list(COUNTED)]], axis=1)
    assert agreement.difference(rows, found, answers) == ""
    assert saturated.sum() == found[:, 4:].sum()


def test_unicorn(rows: Rows, answers: Rows) -> None:
    assert agreement.difference(rows, agreement.answers_of(UnicornBoard().step, rows), answers) == ""


def test_clocks_of_unicorn_are_those_that_the_interpreter_counts(
    rows: Rows, interpreted: tuple[Rows, list[int]]
) -> None:
    """On the straight line by its formula; where something saturates, the interpreter is asked."""
    board, words = UnicornBoard(), Words(16, len(SIGNALS))
    straight = np.flatnonzero((interpreted[0][:, 4:] == 0).all(axis=1))
    chosen = sorted({*straight.tolist(), *range(2000)})
    assert len(straight) > ROWS // 3
    for k in chosen:
        board.step(words, *rows[k].tolist())
        assert board.clocks == interpreted[1][k], rows[k]


@pytest.mark.parametrize("board", [UnicornBoard, InterpretedBoard])
def test_shifts_beyond_64_bits(board: Callable[[], Board]) -> None:
    rows = agreement.drawn(FAR, seed=1)[: 1000 if board is InterpretedBoard else FAR]
    rows[:, 8] = 63 + rows[:, 8] * 500
    assert 63 <= rows[:, 8].min() < 17 * 500 < rows[:, 8].max() < 0x8000
    assert agreement.difference(rows, agreement.answers_of(board().step, rows), agreement.by_python(rows)) == ""


def test_a_difference_is_told_with_its_row(rows: Rows, answers: Rows) -> None:
    wrong = answers.copy()
    wrong[7, 2] += 1
    wrong[9, 4] += 1
    told = agreement.difference(rows, wrong, answers)
    assert told.startswith(f"2 rows of {ROWS}; count = {rows[7, 0]}, ")
    assert told.endswith(f"i {answers[7, 2] + 1}, not {answers[7, 2]}")


def test_counters_of_saturations_wrap_in_the_machine_and_not_in_the_words() -> None:
    board, words = UnicornBoard(), Words(16, len(SIGNALS))
    for _ in range(0x10000 + 5):
        board.step(words, 0, 0, 0, 0, 32767, 0, 0, 32767, 0, 1)
    assert words.saturations == [0, 0, 0, 0, 0x10005, 0, 0, 0]
