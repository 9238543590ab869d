"""`make bench`, how fast the engine of the studies runs: whole runs on one core, building each included."""

import time
from collections.abc import Callable
from statistics import median

from rich.console import Console
from rich.table import Table

from hil import scenario_file
from hil.engine import fast
from hil.engine.functional_run import inline
from hil.scenario import Scenario

RUNS, INLINE_RUNS = 21, 3
SCENARIOS = ("load-step", "paper-joint", "paper-task", "five-joints")
FLOOR_AT, FLOOR = "paper-joint", 100.0


def speeds(scenario: Scenario) -> tuple[float, float]:
    """Return simulated s / wall s of the fast engine and of the inline run; Unsupported without Numba."""
    fast.run(scenario)  # compiles, or loads what was compiled
    return _speed(fast.run, scenario, RUNS), _speed(inline, scenario, INLINE_RUNS)


def show_engine(console: Console) -> bool:
    """Print the speed of the engine; return whether it reaches its floor."""
    table = Table(title=f"the studies' engine, simulated s / wall s, medians of {RUNS} (floor: {FLOOR_AT} {FLOOR:.0f})")
    for column in ("scenario", "fast", "inline", "fast / inline"):
        table.add_column(column, justify="right")
    reached = True
    try:
        for name in SCENARIOS:
            of_fast, of_inline = speeds(scenario_file.load(name))
            table.add_row(name, f"{of_fast:.0f}", f"{of_inline:.1f}", f"{of_fast / of_inline:.0f}")
            reached &= name != FLOOR_AT or of_fast >= FLOOR
    except fast.Unsupported as reason:
        console.print(f"fast engine: not measured: {reason}")
        return False
    console.print(table)
    return reached


def _speed(run: Callable[[Scenario], object], scenario: Scenario, runs: int) -> float:
    """Return the median of some runs."""
    times = []
    for _ in range(runs):
        began = time.perf_counter()
        run(scenario)
        times.append(time.perf_counter() - began)
    return scenario.duration_s / median(times)
