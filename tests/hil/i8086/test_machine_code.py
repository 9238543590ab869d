"""joint.bin is what joint.asm says, each of its instructions counts, and its interrupt leaves no trace."""

import random
from collections.abc import Callable
from pathlib import Path
from struct import pack_into, unpack_from
from typing import Any

import pytest

from firmware_py.joint_cpu import SIGNALS, make_step
from firmware_py.words import Words
from hil.i8086 import image
from hil.i8086.board import COUNTED, Board
from hil.i8086.interpreted_board import InterpretedBoard
from hil.i8086.state import REGISTERS, SP
from hil.i8086.unicorn_board import CALL_AT, NEVER, UnicornBoard
from tests.hil.i8086 import agreement
from tests.hil.i8086.agreement import Rows
from tests.hil.i8086.nasm import SOURCE, assemble

RUNAWAY = 5000
"""Instructions after which a mutant is ended; the step has less than 200."""
CHUNK = 4000


@pytest.fixture(scope="module")
def assembled(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, str]:
    return assemble(SOURCE.read_text(), tmp_path_factory.mktemp("nasm"))


def test_the_machine_code_is_the_source_assembled(assembled: tuple[bytes, str]) -> None:
    assert assembled[0] == SOURCE.with_suffix(".bin").read_bytes() == image.CODE


def test_the_listing_is_the_assembler_s(assembled: tuple[bytes, str]) -> None:
    assert assembled[1] == SOURCE.with_suffix(".lst").read_text()


def test_data_lie_where_the_source_puts_them(assembled: tuple[bytes, str]) -> None:
    """By the listing, whose lines of reserved words end in their names."""
    reserved = [line.split() for line in assembled[1].splitlines() if "resw" in line]
    at = {name.rstrip(":"): int(address, 16) for _, address, _, name, *_ in reserved}
    names = ("count_prev", "w_prev", "d", "a_ref", "ka", "kb", "kj", "shift", "current_limit")
    assert [at[name] for name in names] == [0, 2, 4, 8, 10, 12, 14, 16, 18]
    assert image.DATA_AT + at["w_prev"] == image.RESULTS_AT
    assert [at[name] for name in ("i", "estimate", "kb_dw_over", "d_over", "i_over")] == [20, 22, 24, 26, 28]
    assert at["error_over"] + 2 == image.DATA_BYTES
    assert not any(address % 2 for address in at.values())


# -- mutations --

MUTATIONS = {
    "sub     ax,[count_prev]": "add     ax,[count_prev]",
    "mov     [count_prev],bx": "mov     [count_prev],ax",
    "sub     ax,[w_prev]": "add     ax,[w_prev]",
    "mov     [w_prev],bx": "mov     [w_prev],ax",
    "imul    word [kb]": "mul     word [kb]",
    "jo      kb_dw_saturates": "nop",
    "sub     di,ax": "add     di,ax",
    "jo      d_saturates\n": "js      d_saturates\n",
    "mov     [estimate],di": "mov     [estimate],ax",
    "imul    word [kj]": "mul     word [kj]",
    "shl     bx,1\n": "shr     bx,1\n",
    "sbb     bx,bx": "sub     bx,bx",
    "mov     cx,16                   ; right": "mov     cx,15                   ; right",
    "je      round": "je      shifted",
    "jb      shift_far": "js      round",
    "rcl     bx,1": "shl     bx,1",
    "shl     ax,1                    ; carry": "sar     ax,1                    ; carry",
    "adc     dx,cx": "add     dx,cx",
    "adc     bx,cx": "add     bx,cx",
    "adc     dx,bx": "add     dx,bx",
    "jne     i_far": "nop",
    "jg      i_over_limit": "jge     i_over_limit",
    "neg     bx": "not     bx",
    "jl      i_over_limit": "jle     i_over_limit",
    "sub     ax,di": "add     ax,di",
    "jo      error_saturates": "nop",
    "imul    word [ka]": "mul     word [ka]",
    "adc     di,dx                   ; both": "add     di,dx                   ; both",
    "mov     [d],cx": "mov     [d],ax",
    "mov     [d+2],di": "mov     [d+2],dx",
    "inc     word [kb_dw_over]": "inc     word [d_over]",
    "xor     ax,7FFFh": "xor     ax,7FFEh",
    "mov     [d],dx": "mov     [d],ax",
    "neg     cx": "not     cx",
    "mov     cx,16\nshift_right": "mov     cx,8\nshift_right",
    "sar     dx,1": "shr     dx,1",
    "jge     i_limited": "jle     i_limited",
    "neg     ax": "not     ax",
    "mov     ax,bx\n": "mov     ax,cx\n",
    "push    bx": "push    cx",
    "pop     di": "pop     ax",
    "mov     ax,[i]": "mov     ax,[estimate]",
    "out     DAC,ax": "out     PIC,ax",
    "iret": "ret",
}
"""One instruction in the place of another."""


class Mutant(UnicornBoard):
    """A board with other code, which may not come to its end; what the DAC was given, and count_prev, are looked at."""

    def __init__(self, code: bytes) -> None:
        super().__init__()
        load(self, code)

    def interrupt(self) -> None:
        self._engine.emu_start(image.CODE_AT + CALL_AT, NEVER, count=RUNAWAY)

    def step(self, words: Any, *given: int) -> tuple[int, ...]:
        answered = super().step(words, *given)
        assert self.current == answered[2] & 0xFFFF
        assert unpack_from("<H", self.memory, image.DATA_AT) == (given[0],)  # the next count_prev
        return answered


def load(board: Board, code: bytes) -> None:
    board.memory[image.CODE_AT : image.CODE_AT + len(code)] = code


def caught(code: bytes, rows: Rows, answers: Rows) -> str:
    """Return what shows that this is not the joint's code, empty if nothing does."""
    try:
        board = Mutant(code)
        for first in range(0, len(rows), CHUNK):
            some = slice(first, first + CHUNK)
            if wrong := agreement.difference(rows[some], agreement.answers_of(board.step, rows[some]), answers[some]):
                return wrong
        return traces(code)
    except Exception as error:  # an engine's, of whatever kind
        return f"{type(error).__name__}: {error}"


def traces(code: bytes) -> str:
    """Return what an interrupt leaves in the registers of whom it interrupted."""
    board, chance = InterpretedBoard(), random.Random(1)
    load(board, code)
    registers = [chance.randrange(0x10000) & ~1 for _ in REGISTERS]
    registers[SP] = image.STACK_TOP - 0x20
    flags, board.cpu.registers[:] = board.cpu.flags, registers
    board.step(Words(16, len(SIGNALS)), *(5,) * 10)
    left = zip(REGISTERS, registers, board.cpu.registers, strict=True)
    changed = [f"{name} {was:04X} is {now:04X}" for name, was, now in left if was != now]
    return ", ".join(changed + ["flags"] * (flags != board.cpu.flags))


@pytest.fixture(scope="module")
def rows() -> Rows:
    return agreement.drawn(100_000, seed=44)


@pytest.fixture(scope="module")
def answers(rows: Rows) -> Rows:
    return agreement.by_numba(rows)


def test_the_interrupt_leaves_no_trace() -> None:
    assert traces(image.CODE) == ""


@pytest.mark.parametrize("board", [UnicornBoard, InterpretedBoard])
def test_the_state_stays_in_the_machine(board: Callable[[], Board]) -> None:
    """A thousand interrupts in a row that are given a count and a reference each, and nothing else."""
    machine, chance, words = board(), random.Random(3), Words(16, len(SIGNALS))
    step, table = make_step(Words), (22938, 1478, 17616, 13, 16384)
    image.PARAMETERS.pack_into(machine.memory, image.DATA_AT, 65000, 0, 0, 0, *table)
    count_prev, w_prev, d, count, w = 65000, 0, 0, 65000, 0
    for _ in range(1000):
        w += chance.randint(-3, 3)
        count, a_ref = count + w & 0xFFFF, chance.randint(-600, 600)
        machine.count = count
        pack_into("<h", machine.memory, image.DATA_AT + 8, a_ref)
        machine.interrupt()
        w_prev, d, i, estimate = step(words, count, count_prev, w_prev, d, a_ref, *table)
        count_prev = count
        assert machine.current == i & 0xFFFF
        *left, _, _, _, _ = results = image.RESULTS.unpack_from(machine.memory, image.RESULTS_AT)
        assert left == [w_prev, d, i, estimate]
    assert sum(results[4:]) > 0
    assert results[4:] == tuple(words.saturations[signal] for signal in COUNTED)


def test_the_code_as_it_is_passes_for_no_mutant(rows: Rows, answers: Rows) -> None:
    assert caught(image.CODE, rows[:CHUNK], answers[:CHUNK]) == ""


@pytest.mark.parametrize("was", MUTATIONS)
def test_every_mutation_is_caught(was: str, rows: Rows, answers: Rows, tmp_path: Path) -> None:
    text = SOURCE.read_text()
    assert text.count(was) == 1
    code, _ = assemble(text.replace(was, MUTATIONS[was]), tmp_path)
    assert code != image.CODE
    assert caught(code, rows, answers) != ""
