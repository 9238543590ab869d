"""What a person sees of a scenario at all word lengths: 80 columns."""

from collections.abc import Iterator
from typing import Any

from rich.console import Console
from rich.table import Table

from hil.quantise.show import new_table
from hil.quantise.word_length import COUNTER, SHORTEST

HEADS = ("beyond", "largest, urad", "at the end, urad", "overflows")


def show_words(console: Console, found: dict[str, Any]) -> None:
    """Print every word length, the knee, and why."""
    console.print(_lengths(found["lengths"]))
    for line in explained(found):
        console.print(line, soft_wrap=True)


def _lengths(rows: list[dict[str, Any]]) -> Table:
    table = new_table("word lengths: joint deviation under the rule functional", ("bits",), HEADS)
    for row in rows:
        figures = (_urad(row["max_deviation_rad"], ".0f"), _urad(row["final_deviation_rad"], ".1f"))
        table.add_row(str(row["bits"]), _excess(row["excess"]), *figures, str(row["overflows"]))
    return table


def explained(found: dict[str, Any]) -> Iterator[str]:
    """Yield where the knee is, what fails first below it, and what else was tried alone."""
    yield "beyond: the worst joint's excess over 32 bits, in what is allowed (10 % and an"
    yield "encoder count); -: the run had none of these figures, or overflowed"
    for row in found["lengths"]:
        if row["reason"]:
            yield f"{row['bits']} bits: {row['reason']}"
    knee, first = found["knee_bits"], found["fails_first"]
    if knee is None:
        yield "no knee: even 32 bits overflow, or their run stops"
    elif knee == SHORTEST:
        yield f"no knee: {SHORTEST} bits are enough"
    else:
        yield f"knee: {knee} bits are enough, {knee - 1} are not"
        yield from _first(first, knee - 1)
    for bits in sorted({row["bits"] for row in found["alone"]}, reverse=True):
        yield f"  each alone as in {bits} bits:"
        costs = [f"{row['what']} {_alone(row)}" for row in found["alone"] if row["bits"] == bits]
        yield f"    {', '.join(costs[:3])},"
        yield f"    {', '.join(costs[3:])}"


def _first(first: dict[str, Any] | None, below: int) -> Iterator[str]:
    if first is None or first["bits"] < below:
        yield f"  at {below} bits none of their formats fails alone: it takes them together"
    if first is not None:
        yield f"  fails first: {first['what']}, from {first['bits']} bits down"


def _alone(row: dict[str, Any]) -> str:
    if row["what"] == COUNTER:
        return "fits" if row["excess"] is not None else "does not fit"
    return _excess(row["excess"])


def _excess(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _urad(values: list[float] | None, form: str) -> str:
    return "-" if values is None else ", ".join(format(value * 1e6, form) for value in values)
