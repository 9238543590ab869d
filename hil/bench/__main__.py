"""`make bench`: how fast rig, wire, analysis, fast engine and machine code run here, and where the time goes.

Figures are medians over several runs of simulated seconds per wall second (recording on, `bits`); a wall clock is read
nowhere else to judge speed, and no test does.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

from rich.console import Console
from rich.table import Table

from hil import scenario_file
from hil.addresses import restart_at_fixed_addresses
from hil.bench import scaling
from hil.bench.engine import show_engine
from hil.bench.i8086 import show_i8086
from hil.bench.plot import write_plot
from hil.bench.timing import show_timing
from hil.bench.wire import show_wire
from hil.processes import run_processes
from hil.rig import run_inline
from hil.scenario import Scenario
from hil.timed import time_nodes
from hil.wire import duration, medium
from hil.wire.rates import Rates

RUNS = 7
SCENARIOS = ("load-step", "paper-joint", "paper-task")
FLOORS = {"processes": 3.0, "inline": 5.0}
START_LIMIT_S = 3.0
MEMORY_LIMIT_MB = 600.0


def speeds(scenario: Scenario) -> dict[str, float]:
    """Return simulated s / wall s of both modes."""
    processes, inline = [], []
    for run in range(RUNS):
        processes.append(scenario.duration_s / run_processes(scenario, f"bench-{run}").wall_s)
        inline.append(scenario.duration_s / run_inline(scenario).wall_s)
    return {"processes": median(processes), "inline": median(inline)}


def parts(scenario: Scenario) -> dict[str, float]:
    """Return wall us a simulated ms of each part of an inline run."""
    bits_s = _time_frame_bits()
    wakes_s, total_s = time_nodes(scenario)
    found = {name: sum(each_s) for name, each_s in wakes_s.items()}
    found["frame bits"] = bits_s[0]
    found["kernel"] = total_s - sum(found.values())
    simulated_ms = scenario.duration_ns / 1e6 + scenario.clock.setup_cycles
    return {name: wall_s * 1e6 / simulated_ms for name, wall_s in found.items()}


def _time_frame_bits() -> list[float]:
    """Add up the time that exact frame lengths take, from here on."""
    spent = [0.0]
    plain = duration.duration_ns

    def timed(identifier: int, data: bytes, rates: Rates) -> int:
        began = time.perf_counter()
        lasts_ns = plain(identifier, data, rates)
        spent[0] += time.perf_counter() - began
        return lasts_ns

    setattr(medium, "duration_ns", timed)  # noqa: B010 (the name that it imported)
    return spent


def whole_command() -> tuple[float, float]:
    """Return (wall s from the start of `hil run` to cycle 0, MB of memory: the peaks of all its processes, added)."""
    with tempfile.TemporaryDirectory(prefix="hil-bench-") as folder:
        command = [sys.executable, "-m", "hil", "run", "--json", "--out", f"{folder}/run"]
        summary = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    nodes_kB = sum(process["peak_memory_kB"] for process in summary["processes"].values())
    rig_kB = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    return summary["startup_s"], (nodes_kB + rig_kB) / 1024


def show_speeds(console: Console) -> bool:
    """Print the speed of every built-in scenario; return whether all reach their floors."""
    table = Table(title=f"simulated s / wall s, medians of {RUNS} (floors: processes 3, inline 5)")
    for column in ("scenario", "processes", "inline", "processes / inline"):
        table.add_column(column, justify="right")
    reached = True
    for name in SCENARIOS:
        found = speeds(scenario_file.load(name))
        reached &= all(found[mode] >= floor for mode, floor in FLOORS.items())
        ratio = found["processes"] / found["inline"]
        table.add_row(name, f"{found['processes']:.2f}", f"{found['inline']:.2f}", f"{ratio:.2f}")
    console.print(table)
    return reached


def show_parts(console: Console) -> None:
    """Print where the time of an inline run goes."""
    found = parts(scenario_file.load("paper-joint"))
    table = Table(title="where an inline run of paper-joint spends its time")
    for column in ("part", "us a simulated ms", "share"):
        table.add_column(column, justify="right")
    for name, us in found.items():
        table.add_row(name, f"{us:.1f}", f"{us / sum(found.values()):.0%}")
    console.print(table)


def show_start(console: Console) -> bool:
    """Print how long `hil run` takes to cycle 0 and what memory it needs; return whether both are within limits."""
    started = [whole_command() for _ in range(3)]
    start_s, memory_MB = median(s for s, _ in started), max(m for _, m in started)
    console.print(f"start of `hil run` to cycle 0: {start_s:.2f} s (limit {START_LIMIT_S:.0f} s), median of 3")
    console.print(f"peak memory of all processes: {memory_MB:.0f} MB (limit {MEMORY_LIMIT_MB:.0f} MB)")
    return start_s <= START_LIMIT_S and memory_MB <= MEMORY_LIMIT_MB


def main() -> int:
    """Print the tables; 1 if a floor is missed."""
    parser = argparse.ArgumentParser(description="Measure the rig and the wire on this machine.")
    parser.add_argument("--plot", type=Path, help="write the scaling of the wire to this PNG")
    plot = parser.parse_args().plot
    console = Console()
    reached = show_speeds(console)
    show_parts(console)
    reached &= show_start(console)
    reached &= show_wire(console)
    reached &= show_timing(console)
    reached &= show_engine(console)
    reached &= show_i8086(console)
    costs = scaling.measure()
    reached &= scaling.show_scaling(console, costs)
    if plot is not None:
        write_plot(costs, plot)
        console.print(f"plotted: {plot}")
    return 0 if reached else 1


if __name__ == "__main__":
    restart_at_fixed_addresses()
    sys.exit(main())
