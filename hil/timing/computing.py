"""How long the nodes compute: on the target by its documented clocks, on this host as measured.

The step's clocks are those of its machine code while nothing saturates, and so are an interrupt's where joints are of
machine code; else it takes what they declare, `clocks`. Neither CAN nor the prefetch queue nor wait states are counted:
by a model the last two add 7 to 13 % to a step.

Ref: Intel 8086 instruction timing tables (Intel 8086 Family User's Manual 1979).
"""

from typing import Any

from rich.console import Console
from rich.table import Table

from hil.i8086 import straight_line
from hil.latency import distribution
from hil.scenario import Scenario
from hil.scenario_joint import I8086
from hil.timed import time_nodes
from hil.timing.rig_cycle import cycle_of
from hil.wire.rates import Rates
from plant.parameters import MAX_JOINTS

TARGET = "8086"
CLOCKS_HZ = (5e6, 8e6, 10e6)
"""Of the 8086, the 8086-2 and the 8086-1."""
BASIS = "clocks are documented sums, IMUL's fitted to captures, without CAN, prefetch queue and wait states"


def computing(scenario: Scenario) -> dict[str, Any]:
    """Return computing times by processor clock, and the host's by node (one inline run), s; ready for JSON."""
    wakes_s, _ = time_nodes(scenario)
    return {
        "scenario": scenario.name,
        "period_s": scenario.clock.period_s,
        "target": TARGET,
        "basis": BASIS,
        "step_clocks": list(step_clocks(scenario)),
        "interrupt_clocks": interrupt_clocks(scenario),
        "clocks": [at_clock(scenario, clock_hz) for clock_hz in CLOCKS_HZ],
        "host": {name: distribution(each_s) for name, each_s in wakes_s.items()},
    }


def interrupt_clocks(scenario: Scenario) -> int:
    """Return the clocks that a control interrupt is declared with, of the joint that takes the most."""
    return max(
        straight_line.most_clocks(scenario, n) if scenario.cpu(n) == I8086 else scenario.of_joint(n, "clocks")
        for n in range(1, scenario.joints + 1)
    )


def step_clocks(scenario: Scenario) -> tuple[int, int]:
    """Return the least and most clocks of all joints' steps as machine code, while nothing saturates."""
    least, most = zip(*(straight_line.step_clocks(scenario, n) for n in range(1, scenario.joints + 1)), strict=True)
    return min(least), max(most)


def at_clock(scenario: Scenario, clock_hz: float) -> dict[str, Any]:
    """Return what a processor clock means: the longest times, their share of a period, and whether a cycle fits.

    current_end_s: latest end of each joint's Current after its cycle's start; None where nothing bounds it.
    """
    interrupt_s = interrupt_clocks(scenario) / clock_hz
    cycle = cycle_of(with_clock(scenario, clock_hz))
    bounds = cycle.judged(Rates(scenario.bit_ns))[1] if interrupt_s < scenario.clock.period_s else None
    joints = range(1, scenario.joints + 1)
    return {
        "clock_hz": clock_hz,
        "step_s": [step / clock_hz for step in step_clocks(scenario)],
        "interrupt_s": interrupt_s,
        "share": interrupt_s / scenario.clock.period_s,
        "current_end_s": {
            f"joint{n}": None
            if bounds is None or scenario.crystal_ppb(n) is not None
            else bounds[f"Current_{n}"].end_ns / 1e9
            for n in joints
        },
        "fits": bounds is not None,
    }


def with_clock(scenario: Scenario, clock_hz: float) -> Scenario:
    """Return the scenario with every joint's CPU at this clock."""
    unset = {"compute_s": None, "clock_hz": None}
    parts: dict[str, Any] = {f"joint{n}": scenario.own(n).model_copy(update=unset) for n in range(1, MAX_JOINTS + 1)}
    parts["joint"] = scenario.joint.model_copy(update={"compute_s": None, "clock_hz": clock_hz})
    return scenario.model_copy(update=parts)


def show_computing(console: Console, found: dict[str, Any]) -> None:
    """Print the target's computing times by clock, what they leave of a cycle, and the host's by node."""
    console.print(_target(found))
    console.print(f"{found['interrupt_clocks']} clocks an interrupt; {found['basis']}", soft_wrap=True)
    console.print(_cycle(found))
    console.print(_host(found["host"]))


def _target(found: dict[str, Any]) -> Table:
    table = Table(title=f"control interrupt, {found['target']}, us of {found['period_s'] * 1e6:g}")
    for column in ("MHz", "the step in it", "interrupt", "of a period"):
        table.add_column(column, justify="right")
    for row in found["clocks"]:
        step = " to ".join(f"{step_s * 1e6:.1f}" for step_s in row["step_s"])
        share = f"{row['share']:.1%}"
        table.add_row(f"{row['clock_hz'] / 1e6:g}", step, f"{row['interrupt_s'] * 1e6:.1f}", share)
    return table


def _cycle(found: dict[str, Any]) -> Table:
    table = Table(title=f"{found['scenario']}: latest ends in a cycle, us")
    joints = found["clocks"][0]["current_end_s"]
    for column in ("MHz", *(f"Current_{name.removeprefix('joint')}" for name in joints), ""):
        table.add_column(column, justify="right")
    for row in found["clocks"]:
        ends = ["-" if end_s is None else f"{end_s * 1e6:.0f}" for end_s in row["current_end_s"].values()]
        fits = "fits" if row["fits"] else "TOO LONG"
        table.add_row(f"{row['clock_hz'] / 1e6:g}", *ends, fits)
    return table


def _host(host: dict[str, Any]) -> Table:
    table = Table(title="a wake-up on this host, inline, measured: wall us")
    for column in ("node", "wake-ups", "p50", "p99", "p99.9", "largest"):
        table.add_column(column, justify="left" if column == "node" else "right")
    for name, wakes in host.items():
        if wakes is not None:
            times = [f"{wakes[key] * 1e6:.1f}" for key in ("p50_s", "p99_s", "p99.9_s", "max_s")]
            table.add_row(name, str(wakes["count"]), *times)
    return table
