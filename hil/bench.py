"""`make bench`: how fast the rig runs on this machine, and where the time goes.

Figures are medians over several runs of simulated seconds per wall second (recording on, `bits`); a wall clock is read
nowhere else to judge speed, and no test does.
"""

import resource
import subprocess
import sys
import time
from statistics import median

from rich.console import Console
from rich.table import Table

from hil import scenario_file
from hil.assemble import build_nodes
from hil.drive import Direct
from hil.node import Reaction
from hil.processes import run_processes
from hil.rig import make_kernel, run_inline
from hil.scenario import Scenario
from hil.wire import kernel as kernel_module
from hil.wire.kernel import Arrival

RUNS = 7
SCENARIOS = ("paper-joint", "paper-task", "load-step")
FLOOR = {"processes": 2.0, "inline": 5.0}


class Timed(Direct):
    """A node whose wall time is added up."""

    wall_s = 0.0

    def wake(self, now_ns: int, stored: list[Arrival], cause: Arrival | None) -> Reaction:
        """Hand over, and look at the clock before and after."""
        began = time.perf_counter()
        reaction = super().wake(now_ns, stored, cause)
        self.wall_s += time.perf_counter() - began
        return reaction


def speeds(scenario: Scenario) -> dict[str, float]:
    """Return simulated s / wall s of both modes."""
    processes, inline = [], []
    for run in range(RUNS):
        processes.append(scenario.duration_s / run_processes(scenario, f"bench-{run}").wall_s)
        inline.append(scenario.duration_s / run_inline(scenario).wall_s)
    return {"processes": median(processes), "inline": median(inline)}


def parts(scenario: Scenario) -> dict[str, float]:
    """Return wall us a simulated ms of each part of an inline run."""
    kernel = make_kernel(scenario)
    timed = [Timed(node) for node in build_nodes(scenario)]
    for participant in timed:
        kernel.join(participant)
    bits_s = _time_frame_bits(kernel)
    kernel.start()
    began = time.perf_counter()
    kernel.run(scenario.duration_ns - 1)
    total = time.perf_counter() - began
    found = {participant.name: participant.wall_s for participant in timed}
    found["frame bits"] = bits_s[0]
    found["kernel"] = total - sum(found.values())
    simulated_ms = scenario.duration_ns / 1e6 + scenario.clock.setup_cycles
    return {name: wall_s * 1e6 / simulated_ms for name, wall_s in found.items()}


def _time_frame_bits(kernel: kernel_module.Kernel) -> list[float]:
    """Add up the time that exact frame lengths take in this kernel."""
    spent = [0.0]
    plain = kernel._bits

    def timed(identifier: int, data: bytes) -> int:
        began = time.perf_counter()
        bits = plain(identifier, data)
        spent[0] += time.perf_counter() - began
        return bits

    kernel._bits = timed  # type: ignore[method-assign]
    return spent


def command() -> tuple[float, float]:
    """Return (wall s of a whole `hil run --json`, MB of memory at their peaks, all processes together)."""
    began = time.perf_counter()
    subprocess.run([sys.executable, "-m", "hil", "run", "--json"], check=True, capture_output=True)
    return time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024


def main() -> None:
    """Print the tables."""
    console = Console()
    table = Table(title=f"simulated s / wall s, medians of {RUNS}")
    for column in ("scenario", "processes", "inline", "processes : inline"):
        table.add_column(column, justify="right")
    for name in SCENARIOS:
        found = speeds(scenario_file.load(name))
        ratio = found["processes"] / found["inline"]
        table.add_row(name, f"{found['processes']:.2f}", f"{found['inline']:.2f}", f"{ratio:.2f}")
    console.print(table)
    table = Table(title="where the time of an inline run goes, paper-joint")
    table.add_column("part")
    table.add_column("us a simulated ms", justify="right")
    for name, us in parts(scenario_file.load("paper-joint")).items():
        table.add_row(name, f"{us:.1f}")
    console.print(table)


if __name__ == "__main__":
    main()
