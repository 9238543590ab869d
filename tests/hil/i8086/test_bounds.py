"""The bounds of a control interrupt's clocks against interrupts of random rows, and rows made to come near."""

import random

import pytest

from firmware_py.joint_cpu import SIGNALS
from firmware_py.words import Words
from hil.i8086.bounds import Bounds, bounds, joint_rounds
from hil.i8086.image import CODE, INTERRUPT, STEP
from hil.i8086.interpreted_board import InterpretedBoard
from hil.i8086.interpreter import MachineCodeError

ROWS = 20_000
SHIFTS = range(16)

Row = tuple[int, ...]
"""count, count_prev, w_prev, d, a_ref, ka, kb, kj, shift, current_limit."""


@pytest.fixture(scope="module")
def board() -> InterpretedBoard:
    return InterpretedBoard()


def of_shift(shift: int) -> Bounds:
    return bounds(CODE, INTERRUPT, joint_rounds(shift))


def random_row(chance: random.Random, shift: int) -> Row:
    """Every number over its full range, at its ends one time in four."""

    def word() -> int:
        return chance.choice((-32768, -1, 0, 32767)) if chance.random() < 0.25 else chance.randint(-32768, 32767)

    count, count_prev, w_prev, a_ref, ka, kb, kj, limit = (word() for _ in range(8))
    d = chance.randint(-(2**31), 2**31 - 1)
    return count & 0xFFFF, count_prev & 0xFFFF, w_prev, d, a_ref, ka, kb, kj, shift, max(limit, -32767)


def taken(board: InterpretedBoard, row: Row) -> tuple[int, int]:
    """Return clocks and instructions of one interrupt."""
    board.step(Words(16, len(SIGNALS)), *row)
    return board.cpu.clocks, board.cpu.instructions


def within(board: InterpretedBoard, row: Row, limits: Bounds) -> bool:
    clocks, instructions = taken(board, row)
    return (
        limits.least_clocks <= clocks <= limits.most_clocks
        and limits.least_instructions <= instructions <= limits.most_instructions
    )


def test_interrupts_of_random_rows_are_within_their_bounds(board: InterpretedBoard) -> None:
    chance = random.Random(8086)
    limits = [of_shift(shift) for shift in SHIFTS]
    for _ in range(ROWS):
        row = random_row(chance, chance.choice(SHIFTS))
        assert within(board, row, limits[row[8]]), row


@pytest.mark.parametrize("shift", [16, 17, 20, 31, 32, 33, 100, 32767])
def test_so_are_those_of_shifts_that_leave_a_word(board: InterpretedBoard, shift: int) -> None:
    chance, limits = random.Random(shift), of_shift(shift)
    for _ in range(100):
        row = random_row(chance, shift)
        assert within(board, row, limits), row


@pytest.mark.parametrize("shift", SHIFTS)
def test_a_joint_at_rest_takes_the_least(board: InterpretedBoard, shift: int) -> None:
    """Zeros have no ones and no sign. (An instruction more than the least: i beyond its word saves one, not clocks.)"""
    limits = of_shift(shift)
    row = (0, 0, 0, 0, 0, 0, 0, 0, shift, 32767)
    assert taken(board, row) == (limits.least_clocks, limits.least_instructions + 1)


@pytest.mark.parametrize("shift", SHIFTS)
def test_a_row_that_saturates_everything_comes_near_the_most(board: InterpretedBoard, shift: int) -> None:
    """Not to it: an error that saturates is no factor with which IMUL is slowest. 30 clocks are about 2 %."""
    limits = of_shift(shift)
    clocks, _ = taken(board, (1, 0, -32768, -(2**31), -32767, -20000, -2, 32766, shift, -20000))
    assert limits.most_clocks - 30 <= clocks <= limits.most_clocks


def test_the_interrupt_is_its_instructions_around_the_step() -> None:
    """5 PUSH, IN, CALL, MOV, OUT, MOV, OUT, 5 POP, IRET: 55 + 10 + 19 + 10 + 10 + 4 + 10 + 40 + 32 clocks."""
    step = bounds(CODE, STEP, joint_rounds(14))
    assert of_shift(14) == step.then(Bounds(190, 190, 17, 17))


# -- code of a few bytes, by hand --

RET = b"\xc3"


@pytest.mark.parametrize(
    ("code", "rounds", "expected"),
    [
        pytest.param(RET, (), (16, 16, 1, 1), id="ret"),
        pytest.param(b"\xb8\x01\x00" + RET, (), (20, 20, 2, 2), id="mov ax,1"),
        pytest.param(b"\xa1\x02\x00" + RET, (), (26, 26, 2, 2), id="an even word"),
        pytest.param(b"\xa1\x03\x00" + RET, (), (30, 30, 2, 2), id="an odd word"),
        pytest.param(b"\x8b\x07" + RET, (), (29, 33, 2, 2), id="mov ax,[bx]: who knows"),
        pytest.param(b"\x01\x07" + RET, (), (37, 45, 2, 2), id="add [bx],ax: read and written"),
        pytest.param(b"\x03\x07" + RET, (), (30, 34, 2, 2), id="add ax,[bx]: read"),
        pytest.param(b"\x2e\x8b\x07" + RET, (), (31, 35, 2, 2), id="with a prefix"),
        pytest.param(b"\xf7\xeb" + RET, (), (143, 172, 2, 2), id="imul bx"),
        pytest.param(b"\x70\x01\x99" + RET, (), (25, 32, 2, 3), id="jo over cwd: 4 + 5 + 16, or taken 16 + 16"),
        pytest.param(b"\x49\x75\xfd" + RET, (3,), (2 * 18 + 6 + 16, 2 * 18 + 6 + 16, 7, 7), id="a loop"),
        pytest.param(b"\xe8\x01\x00" + RET + b"\xeb\x00" + RET, (), (66, 66, 4, 4), id="call, jmp, ret"),
        pytest.param(b"\x74\x03\x49\x75\xfd" + RET, (0,), (32, 32, 2, 2), id="je past a loop of no rounds"),
        pytest.param(b"\x74\x03\x49\x75\xfd" + RET, (1,), (26, 26, 4, 4), id="not past one"),
    ],
)
def test_a_few_bytes(code: bytes, rounds: tuple[int, ...], expected: tuple[int, ...]) -> None:
    assert bounds(code, 0, rounds) == expected


@pytest.mark.parametrize(
    ("code", "rounds", "message"),
    [
        pytest.param(b"\xeb\xfe", (), "nothing counts the rounds through 0000", id="an endless loop"),
        pytest.param(b"\x49\x75\xfd" + RET, (), "rounds of 0 loops .* one for each .* 0001", id="a loop not given"),
        pytest.param(b"\x49\x75\xfd" + RET, (0,), "no path from 0000", id="a loop that has to be passed"),
        pytest.param(b"\x0f" + RET, (), "bytes 0F C3 at 0000", id="no instruction"),
        pytest.param(b"\x99", (), "at 0001 of 0001", id="past the end"),
        pytest.param(b"\xb8\x01", (), "bytes B8 01 at 0000 of 0002", id="cut off"),
    ],
)
def test_what_has_no_bounds_says_why(code: bytes, rounds: tuple[int, ...], message: str) -> None:
    with pytest.raises(MachineCodeError, match=message):
        bounds(code, 0, rounds)
