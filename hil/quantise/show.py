"""What a person sees of a scenario's quantisation: 80 columns, a table a joint."""

from collections.abc import Iterator
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

EVENTS = {
    "saturations": ("saturated", "first_saturation_s"),
    "wraps": ("wrapped", "first_wrap_s"),
    "underflows": ("underflowed", "first_underflow_s"),
}
HEADS = ("min", "max", "room", "sat.", "wrap", "under", "SQNR", "same", "error")
LEGEND = (
    "min, max, error: counts; room: bits of head-room; under: underflows. SQNR (dB)\n"
    "and error: beside float64 with exact constants; same: with the joint's own.\n"
    "Both hear what this run's joints heard (open loop). -: no error, or no signal.\n"
    "w wraps where count did, which undoes it."
)


def show(console: Console, found: dict[str, Any]) -> None:
    """Print every joint's signals, when they overflowed first, and the closed loops."""
    for joint in sorted({row["joint"] for row in found["signals"]}):
        rows = [row for row in found["signals"] if row["joint"] == joint]
        console.print(_signals(joint, rows))
        for line in events(rows):
            console.print(line, soft_wrap=True)
    console.print(LEGEND, soft_wrap=True)
    if (compared := found["closed_loop"]) is not None:
        if compared["fault"] is not None:
            console.print(f"in float64 the run stops itself: {compared['fault']['cause']}", soft_wrap=True)
        else:
            console.print(_closed_loop(compared["joints"]))


def events(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield a line for everything that overflowed or went to nothing: how often, and when first."""
    for row in rows:
        for key, (what, first) in EVENTS.items():
            if row[key]:
                yield f"joint {row['joint']}: {row['name']} {what} {row[key]} x, first at {row[first]:.6f} s"


def _signals(joint: int, rows: list[dict[str, Any]]) -> Table:
    table = new_table(f"joint {joint}", ("signal", "format"), HEADS)
    for row in rows:
        counted = (str(row[key]) for key in EVENTS)
        ratios = (_decimal(row[key]) for key in ("sqnr_db", "sqnr_same_constants_db"))
        table.add_row(
            row["name"],
            row["q_format"],
            *(_number(row[key]) for key in ("min", "max")),
            str(row["headroom_bits"]),
            *(("", "", "") if row["constant"] else counted),
            *ratios,
            _error(row["largest_error"]),
        )
    return table


def _closed_loop(rows: list[dict[str, Any]]) -> Table:
    heads = ("largest", "in float64", "16 bits add", "final (rms)", "in float64", "apart")
    table = new_table("closed loop: joint deviation, urad, beside joints in float64", ("joint",), heads)
    for row in rows:
        share = row["penalty"]
        figures = {key: f"{value * 1e6:.2f}" for key, value in row.items() if key.endswith("_rad")}
        table.add_row(
            str(row["joint"]),
            figures["max_deviation_rad"],
            figures["max_deviation_float_rad"],
            "-" if share is None else f"{share:+.1%}",
            figures["final_deviation_rad"],
            figures["final_deviation_float_rad"],
            figures["largest_difference_rad"],
        )
    return table


def _number(value: float) -> str:
    """Return a value in six characters."""
    return f"{value:.0f}" if value == int(value) or abs(value) >= 1000 else f"{value:.4g}"


def _error(value: float) -> str:
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}" if value >= 1e-3 else f"{value:.1g}"


def _decimal(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def new_table(title: str, left: tuple[str, ...], right: tuple[str, ...]) -> Table:
    """Return a table that leaves 80 columns to its numbers."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for head in left:
        table.add_column(head, no_wrap=True)
    for head in right:
        table.add_column(head, justify="right", no_wrap=True)
    return table
