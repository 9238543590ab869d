"""`make bench`, the joint CPU as 8086 machine code: a control interrupt by each engine, the rig beside Python's."""

import time
from collections.abc import Callable
from statistics import median

from rich.console import Console
from rich.table import Table

from firmware_py.joint_cpu import SIGNALS, make_step
from firmware_py.words import Words
from hil import scenario_file
from hil.i8086.board import Board
from hil.i8086.interpreted_board import InterpretedBoard
from hil.i8086.unicorn_board import UnicornBoard
from hil.processes import run_processes
from hil.rig import Outcome, run_inline
from hil.scenario import Scenario
from hil.scenario_joint import I8086, PYTHON

RUNS, STEPS = 21, 1000
RIG_RUNS = 7
ROW = (40, 30, 3, 70_000, 400, 22_938, 1478, 17_616, 13, 16_384)
STEP_LIMIT_US = 5.0
RATIO_FLOOR = 0.6
SCENARIOS = ("load-step", "paper-joint", "paper-task")


def show_i8086(console: Console) -> bool:
    """Print times and ratios; return whether they are within their limits."""
    try:
        unicorn = UnicornBoard()
    except ImportError:
        console.print("8086 machine code: not measured: Unicorn is not installed: pip install -e '.[i8086]'")
        return False
    step_us = show_steps(console, unicorn)
    return show_rigs(console) and step_us <= STEP_LIMIT_US


def show_steps(console: Console, unicorn: Board) -> float:
    """Print what a control interrupt takes, and what the rig makes of it; return Unicorn's executing it, us."""
    table = Table(title=f"one control step, wall us, medians of {RUNS} (limit: Unicorn, executing, {STEP_LIMIT_US:g})")
    for column in ("by", "executing", "and arguments, answers", "and its clocks"):
        table.add_column(column, justify="left" if column == "by" else "right")
    table.add_row("Python's source", "", f"{_step_us(make_step(Words)):.1f}", "")
    found = {}
    for name, board in (("Unicorn", unicorn), ("interpreter", InterpretedBoard())):
        board.step(Words(16, len(SIGNALS)), *ROW)
        found[name] = _step_us(_executed(board))
        others = [_step_us(step) for step in (board.step, _counted(board))]
        table.add_row(name, *(f"{us:.1f}" for us in (found[name], *others)))
    console.print(table)
    console.print("Unicorn and the interpreter execute the whole control interrupt, ports included")
    return found["Unicorn"]


def _executed(board: Board) -> Callable[..., None]:
    def step(_words: Words, *_given: int) -> None:
        board.interrupt()

    return step


def _counted(board: Board) -> Callable[..., int]:
    def step(words: Words, *given: int) -> int:
        board.step(words, *given)
        return board.clocks

    return step


def _step_us(step: Callable[..., object]) -> float:
    words, times = Words(16, len(SIGNALS)), []
    for _ in range(RUNS):
        began = time.perf_counter()
        for _ in range(STEPS):
            step(words, *ROW)
        times.append((time.perf_counter() - began) / STEPS)
    return median(times) * 1e6


def show_rigs(console: Console) -> bool:
    """Print the speed of rigs with three 8086 joints as a share of that with Python's; return whether all suffice."""
    table = Table(
        title=f"rig with three 8086 joints / with Python joints, medians of {RIG_RUNS} (floor: {RATIO_FLOOR})"
    )
    for column in ("scenario", "inline", "processes"):
        table.add_column(column, justify="right")
    lowest = 1.0
    for name in SCENARIOS:
        both = [scenario_file.load(name, [f"joint.cpu={cpu}"]) for cpu in (I8086, PYTHON)]
        ratios = [_ratio(both, run_inline), _ratio(both, lambda each: run_processes(each, "bench-i8086"))]
        table.add_row(name, *(f"{ratio:.2f}" for ratio in ratios))
        lowest = min(lowest, *ratios)
    console.print(table)
    return lowest >= RATIO_FLOOR


def _ratio(both: list[Scenario], run: Callable[[Scenario], Outcome]) -> float:
    """Return the speed of the first over the second's, run by turns."""
    walls: tuple[list[float], ...] = ([], [])
    for _ in range(RIG_RUNS):
        for scenario, times in zip(both, walls, strict=True):
            times.append(run(scenario).wall_s)
    first, second = map(median, walls)
    return second / first
