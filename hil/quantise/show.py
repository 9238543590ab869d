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
    "min, max, error: counts; room: bits of head-room above what was measured / above\n"
    "what no run leaves within twice the commanded speeds, from rest; under:\n"
    "underflows. SQNR (dB)\n"
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
            for line in database(compared["joints"]):
                console.print(line, soft_wrap=True)
    if (proposal := found.get("proposal")) is not None:
        for line in proposed(proposal):
            console.print(line, soft_wrap=True)


def events(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield a line for everything that overflowed or went to nothing: how often, and when first."""
    for row in rows:
        for key, (what, first) in EVENTS.items():
            if row[key]:
                yield f"joint {row['joint']}: {row['name']} {what} {row[key]} x, first at {row[first]:.6f} s"


def database(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield what the scales of the database cost the joints in float64."""
    yield "database: what its counts add, by AccelRef and Current, to joints in float64"
    adds = ["-" if row["database_penalty"] is None else f"{row['database_penalty']:+.1%}" for row in rows]
    yield f"  largest deviation {', '.join(adds)}"
    finals = ([row[f"final_deviation_{name}_rad"] for row in rows] for name in ("unrounded", "float"))
    before, after = (_listed(each, 1e6, ".2f") for each in finals)
    yield f"  final (rms), urad: {before} without, {after} with it"
    apart = [row["database_largest_difference_rad"] for row in rows]
    yield f"  apart up to, urad: {_listed(apart, 1e6, '.2f')}"


def proposed(proposal: dict[str, Any]) -> Iterator[str]:
    """Yield what the ranges ask for, and what a run in these formats showed."""
    if not proposal["formats"]:
        yield "formats: those it has; none with more bits behind the point holds its constants and ranges"
        return
    yield f"proposed: {' '.join(f'--set {path}={value}' for path, value in proposal['formats'].items())}"
    joints = proposal["joints"]
    for what, key, scale, form in (
        ("SQNR of i, dB", "sqnr{}_db", 1.0, ".1f"),
        ("largest deviation, urad", "max_deviation{}_rad", 1e6, ".2f"),
    ):
        before, after = ([row[key.format(each)] for row in joints] for each in ("", "_proposed"))
        yield f"  {what}: {_listed(before, scale, form)} -> {_listed(after, scale, form)}"
    if proposal["proved"]:
        yield "  proved by a run: no overflow, no current less exact, no larger deviation"
    else:
        yield f"  NOT proved, so keep what it has: {', '.join(proposal['against'])}"


def _listed(values: list[float | None], scale: float, form: str) -> str:
    return ", ".join("-" if value is None else format(value * scale, form) for value in values)


def _signals(joint: int, rows: list[dict[str, Any]]) -> Table:
    table = new_table(f"joint {joint}", ("signal", "format"), HEADS)
    for row in rows:
        counted = (str(row[key]) for key in EVENTS)
        ratios = (_decimal(row[key]) for key in ("sqnr_db", "sqnr_same_constants_db"))
        table.add_row(
            row["name"],
            row["q_format"],
            *(_number(row[key]) for key in ("min", "max")),
            _room(row),
            *(("", "", "") if row["constant"] else counted),
            *ratios,
            _error(row["largest_error"]),
        )
    return table


def _closed_loop(rows: list[dict[str, Any]]) -> Table:
    heads = ("largest", "in float64", "words add", "final (rms)", "in float64", "apart")
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


def _room(row: dict[str, Any]) -> str:
    """Return the head-room, measured, and derived where that is known."""
    derived = row.get("derived_headroom_bits")
    return f"{row['headroom_bits']}" if derived is None else f"{row['headroom_bits']}/{derived}"


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
