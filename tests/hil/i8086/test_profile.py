"""What a step takes, against sums of documented clocks by hand, and against memory looked at."""

import re
from pathlib import Path

import pytest

from firmware_py.joint_cpu import SIGNALS
from firmware_py.words import Words
from hil.i8086 import image, study
from hil.i8086.board import Board
from hil.i8086.clocks import FORMS, INTERRUPT
from hil.i8086.interpreted_board import InterpretedBoard
from hil.i8086.profile import ADD, IMUL, KINDS, CountingBoard, Spread, kind_at
from tests.hil.i8086 import agreement

LISTING = Path(__file__).parents[3] / "firmware_py" / "targets" / "i8086" / "joint.lst"
ROW = (5, 3, 4, 100 << 16, 2, 7, 3, 4, 15, 1000)
"""w = 2, dw = -2, KB dw = -6, estimate = 106, feed = 8 / 2^15 = 0, i = 106, error = 0."""
BY_HAND = (
    # the manual's table 2-21, lines of joint.asm; [..] is 6 more; IMUL 127 of a register, 6 more of memory
    *(("move", 2), ("ADD, SUB", 9 + 6), ("move", 9 + 6)),  # mov bx,ax; sub ax,[count_prev]; mov [count_prev],bx
    *(("move", 2), ("ADD, SUB", 9 + 6), ("move", 9 + 6)),  # the same of w_prev
    *(("IMUL", 133 + 6 + 1 + 2 + 12), ("decide", 4)),  # AX = -2: a one, its sign, and that of the product; jo
    *(("move", 8 + 6), ("ADD, SUB", 3), ("decide", 4), ("move", 9 + 6)),  # mov di,[d+2]; sub; jo; mov [estimate],di
    *(("move", 10), ("IMUL", 133 + 6 + 1)),  # mov ax,[a_ref]; AX = 2: a one
    *(("move", 2), ("shift", 2), ("ADD, SUB", 3)),  # mov bx,dx; shl bx,1; sbb bx,bx
    *(("move", 4), ("ADD, SUB", 9 + 6), ("decide", 4), ("decide", 4)),  # mov cx,16; sub cx,[shift]; je; jb
    *(("shift", 2), ("shift", 2), ("shift", 2), ("decide", 2), ("decide", 4)),  # one round: shl, rcl, rcl, dec, jne
    *(("shift", 2), ("ADD, SUB", 3), ("ADD, SUB", 3)),  # shl ax,1; adc dx,cx; adc bx,cx
    *(("move", 2), ("move", 2), ("decide", 5), ("ADD, SUB", 3), ("ADD, SUB", 3)),  # mov, mov, cwd, add, adc
    *(("move", 2), ("decide", 5), ("decide", 3), ("decide", 4)),  # mov bx,dx; cwd; cmp dx,bx; jne
    *(("move", 8 + 6), ("decide", 3), ("decide", 4)),  # mov bx,[current_limit]; cmp; jg
    *(("decide", 3), ("decide", 3), ("decide", 4), ("move", 10)),  # neg bx; cmp; jl; mov [i],ax
    *(("ADD, SUB", 3), ("decide", 4), ("IMUL", 133 + 6)),  # sub ax,di; jo; AX = 0
    *(("move", 8 + 6), ("ADD, SUB", 3), ("ADD, SUB", 3), ("decide", 4)),  # mov cx,[d]; add; adc; jo
    *(("ADD, SUB", 3), ("ADD, SUB", 3), ("decide", 4)),  # add; adc; jo
    *(("move", 9 + 6), ("move", 9 + 6), ("stack", 16)),  # mov [d],cx; mov [d+2],di; ret
)
AROUND = (61, *(11,) * 5, 10, 19, 10, 10, 4, 10, *(8,) * 5, 32)
"""INTR, 5 PUSH, IN, CALL, MOV, OUT, MOV, OUT, 5 POP, IRET."""


def words() -> Words:
    return Words(16, len(SIGNALS))


@pytest.fixture
def board() -> CountingBoard:
    return CountingBoard()


def test_a_step_takes_the_sum_of_its_lines(board: CountingBoard) -> None:
    assert board.step(words(), *ROW) == (2, 106 << 16, 106, 106)
    (taken,) = board.taken
    assert taken.step_clocks == sum(clocks for _, clocks in BY_HAND)
    assert taken.step_instructions == len(BY_HAND)
    assert taken.clocks == taken.step_clocks + sum(AROUND) == board.clocks
    assert taken.instructions == len(BY_HAND) + len(AROUND) - 1
    assert (taken.multiplications, taken.additions) == (3, 14)


def test_clocks_by_kind_are_those_of_its_lines(board: CountingBoard) -> None:
    for _ in range(3):
        board.step(words(), *ROW)
    found = board.clocks_by_kind()
    around = {"stack": 5 * 11 + 19 + 5 * 8 + 32, "ports": 30, "move": 14, "acknowledge": INTERRUPT}
    for kind in (*KINDS, "acknowledge"):
        in_step = sum(clocks for each, clocks in BY_HAND if each == kind)
        assert found[kind] == 3 * (in_step + around.get(kind, 0)), kind


def test_every_form_is_of_one_kind() -> None:
    assert sorted(form for forms in KINDS.values() for form in forms.split()) == sorted(FORMS)


def test_six_sums_take_ten_of_the_fourteen() -> None:
    """By the listing: sums 1, 2, 3, 5 one each, 4 two, 6 two and made twice; sign, shift and rounding take four."""
    sums = (0x21, 0x2B, 0x3D, 0x71, 0x73, 0x8D, 0x99, 0x9B, 0x9F, 0xA1)
    others = (0x50, 0x55, 0x68, 0x6A)
    offsets = [int(at, 16) for at in re.findall(r"^ *\d+ ([0-9A-F]{8}) ", LISTING.read_text(), re.M)]
    in_step = [at for at in offsets if image.STEP <= at < image.SATURATING]
    assert sorted((*sums, *others)) == [at for at in in_step if kind_at(at) == ADD]
    assert [at for at in in_step if kind_at(at) == IMUL] == [0x33, 0x48, 0x91]


def test_all_clocks_of_any_rows_have_a_kind(board: CountingBoard) -> None:
    plain, saturated = InterpretedBoard(), 0
    total = instructions = 0
    for row in agreement.drawn(300, seed=3).tolist():
        assert board.step(words(), *row) == plain.step(words(), *row)
        total, instructions = total + plain.clocks, instructions + plain.cpu.instructions
        saturated += plain.saturated
    assert sum(board.clocks_by_kind().values()) == total
    assert sum(taken.instructions for taken in board.taken) == instructions
    assert 50 < board.saturated_steps == saturated < 300
    assert {taken.clocks - taken.step_clocks for taken in board.taken} == {sum(AROUND)}
    assert board.spread("multiplications") == (3, 3.0, 3)


@pytest.mark.parametrize("row", [ROW, study.DEEPEST])
def test_the_stack_is_as_deep_as_memory_shows(board: CountingBoard, row: tuple[int, ...]) -> None:
    """The interrupt's three words, five registers and one call; a call more where d saturates."""
    assert left_on_stack(InterpretedBoard(), row) == 2 * (3 + 5 + 1 + (row == study.DEEPEST))
    board.step(words(), *row)
    assert board.stack_bytes == left_on_stack(InterpretedBoard(), row)


def left_on_stack(board: Board, row: tuple[int, ...]) -> int:
    """Return how many bytes of the stack a step writes to, down from its top; no word on it is A5A5."""
    stack = slice(image.STACK_AT, image.STACK_AT + image.STACK_TOP)
    board.memory[stack] = b"\xa5" * image.STACK_TOP
    board.step(words(), *row)
    return len(bytes(board.memory[stack]).lstrip(b"\xa5"))


def test_a_spread_is_least_mean_and_most() -> None:
    assert Spread.of(iter([3, 1, 8])) == (1, 4.0, 8)
    assert Spread.of([]) == (None, None, None)
