"""What a person sees of `hil cpu`: 80 columns."""

from collections.abc import Iterator
from typing import Any

from rich.console import Console
from rich.table import Table

from hil.quantise.show import new_table

OPERATIONS = ("multiplications", "additions")
LEGEND = (
    "step: from its first instruction to its RET; interrupt: from its acknowledgement to its IRET; straight: the most "
    "while nothing saturates, which the rig declares; bounds: least and most over all paths."
)
CYCLE = (
    "straight; at most: over all paths; cycle: straight, its frames at {:g} kbit/s and each queued when its sender has "
    "computed; shortest period, CPU alone: the interrupt at most and nothing else; with bus: those frames. Constants "
    "and loops have limits of their own."
)
ESTIMATED = (
    "alone: {:.1f} clocks a multiplication, IMUL's mean in this run, and {} an addition, ADD and ADC of registers, "
    "nothing around them; as steps: {:.2f} times that, as the step takes {:.1f} and its own operations alone {:.1f}."
)
LIMITS = (
    "Clocks are sums of the 8086's documented ones, IMUL's fitted to captures of silicon; no whole step was timed on "
    "silicon. Not counted: CAN, and what the prefetch queue and wait states add. The machine code is ours, not the "
    "robot's."
)


def show_cpu(console: Console, found: dict[str, Any]) -> None:
    """Print what step and interrupt take, of what, at which clock, and what inverse dynamics would."""
    console.print(_clocks(found))
    console.print(LEGEND)
    for line in _counts(found):
        console.print(line)
    console.print(_kinds(found["joints"]))
    console.print(_by_clock(found))
    console.print(CYCLE.format(found["bitrate"] / 1e3))
    if (cost := found["cost"]) is not None:
        step = cost["step"]
        console.print(_newton_euler(cost, [row["clock_hz"] for row in found["clocks"]]))
        figures = cost["add_clocks"], step["clocks"] / step["floor_clocks"], step["clocks"], step["floor_clocks"]
        console.print(ESTIMATED.format(cost["imul_clocks"], *figures))
    console.print(LIMITS)


def _clocks(found: dict[str, Any]) -> Table:
    heads = ("instructions", "least", "mean", "most", "straight", "bounds")
    table = new_table(f"{found['scenario']}: clocks of the joints' 8086s", ("joint", ""), heads)
    for joint in found["joints"]:
        for what in ("step", "interrupt"):
            row = joint[what]
            table.add_row(
                str(joint["joint"]) if what == "step" else "",
                what,
                _span([row["instructions"]]),
                *(_number(row["clocks"][key], form) for key, form in (("least", "d"), ("mean", ".1f"), ("most", "d"))),
                str(row["straight"]),
                "{} to {}".format(*row["bounds"]),
            )
    return table


def _counts(found: dict[str, Any]) -> Iterator[str]:
    """Yield how many steps, operations and bytes there are."""
    law, joints, size = found["law"], found["joints"], found["bytes"]
    steps, saturated = (", ".join(str(joint[key]) for joint in joints) for key in ("steps", "saturated_steps"))
    yield f"steps by joint: {steps}; in which anything saturated: {saturated}"
    made = [_span([joint[key] for joint in joints]) for key in OPERATIONS]
    yield (
        f"a step of the law: {law['multiplications']} multiplications, {law['additions']} additions; of the code: "
        f"{made[0]} IMUL, {made[1]} ADD, ADC, SUB, SBB"
    )
    yield (
        f"bytes: code {size['code']} (entries {size['entries']}, interrupt {size['interrupt']}, step {size['step']}, "
        f"where it saturates {size['saturating']}), data {size['data']}, stack {size['stack']} "
        f"({size['stack_saturating']} where d saturates)"
    )


def _kinds(joints: list[dict[str, Any]]) -> Table:
    table = new_table(
        "clocks of an interrupt by kind of instruction, mean", ("joint",), tuple(joints[0]["clocks_by_kind"])
    )
    for joint in joints:
        table.add_row(str(joint["joint"]), *(f"{clocks:.1f}" for clocks in joint["clocks_by_kind"].values()))
    return table


def _by_clock(found: dict[str, Any]) -> Table:
    heads = ("step", "interrupt", "share", "at most", "share", "cycle", "CPU alone", "with bus")
    table = new_table(f"us of a period of {found['period_s'] * 1e6:g}; and the shortest period", ("MHz",), heads)
    for row in found["clocks"]:
        table.add_row(
            f"{row['clock_hz'] / 1e6:g}",
            _us(row["step_s"][1]),
            _us(row["interrupt_s"]),
            f"{row['share']:.1%}",
            _us(row["bound_s"]),
            f"{row['bound_s'] / found['period_s']:.1%}",
            "fits" if row["fits"] else "TOO LONG",
            *(_us(row["shortest_period_s"][key]) for key in ("cpu", "bus")),
        )
    return table


def _newton_euler(cost: dict[str, Any], clocks_hz: list[float]) -> Table:
    heads = ("mult.", "add.", "clocks", *(f"{clock_hz / 1e6:g} MHz" for clock_hz in clocks_hz), "times")
    table = new_table("beside inverse dynamics on one such CPU (an estimate), us", ("",), heads)
    step = cost["step"]
    for row in cost["newton_euler"]:
        n = row["joints"]
        steps = n * step["clocks"]
        counted = (str(n * step[key]) for key in OPERATIONS)
        table.add_row(f"{n} step{'s' * (n > 1)}", *counted, *_at(steps, clocks_hz), "")
        for what, clocks in (("alone", row["floor_clocks"]), ("as steps", row["clocks_as_the_step"])):
            counted = (str(row[key]) for key in OPERATIONS)
            table.add_row(f"Newton-Euler, {what}", *counted, *_at(clocks, clocks_hz), f"{clocks / steps:.0f}")
    return table


def _at(clocks: float, clocks_hz: list[float]) -> list[str]:
    return [f"{clocks:.0f}", *(f"{clocks / clock_hz * 1e6:.0f}" for clock_hz in clocks_hz)]


def _span(spreads: list[dict[str, Any]]) -> str:
    """Return the least to the most of all of them."""
    seen = sorted({spread[key] for spread in spreads for key in ("least", "most")} - {None})
    return " to ".join(str(each) for each in dict.fromkeys(seen[:1] + seen[-1:])) or "-"


def _us(value_s: float) -> str:
    return f"{value_s * 1e6:.1f}"


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
