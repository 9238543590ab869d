"""What a person sees of a scenario at rest: 80 columns, a table a joint; and what it comes to."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from rich.console import Console

from hil.quantise.show import new_table

HEADS = ("d", "i", "a_ref", "count", "range", "measured", "ratio", "cycle", "Hz")
SHOWN_D_FRACTIONS = (0, 1)
"""The rest is in JSON and in the figure: it hardly differs from the scenario as it is."""
SHORT = {"d_fraction": "d", "current_fraction": "i", "acceleration_fraction": "a_ref"}
LEGEND = (
    "Without friction, urad. d, i, a_ref, count: the errors that each resolution\n"
    "alone leaves standing; range: of the angles that all of them and the encoder's\n"
    "limit cycle leave, and as measured while a slow torque goes down and up; cycle:\n"
    "peak to peak where nothing pushes, and its frequency. Formats: bits behind the\n"
    "point; fine: in front of an encoder whose count is too small to matter."
)
Row = dict[str, Any]


def show_rest(console: Console, found: Row) -> None:
    """Print a table a joint, which resolution dominates where, and what was refused."""
    rows = found["rest"]
    for joint in sorted({row["joint"] for row in rows}):
        _table(console, joint, [row for row in rows if row["joint"] == joint])
    console.print(LEGEND, soft_wrap=True)
    for line in summary(rows):
        console.print(line, soft_wrap=True)
    if found["rest_not_fast"] is not None:
        console.print(f"not fast: {found['rest_not_fast']}", soft_wrap=True)
    causes = Counter((refused["swept"], refused["cause"]) for refused in found["rest_refused"])
    for (swept, cause), times in causes.items():
        console.print(f"not at rest: {swept}: {cause}{f' ({times} x)' if times > 1 else ''}", soft_wrap=True)


def summary(rows: Sequence[Row]) -> Iterator[str]:
    """Yield what dominates each joint as it is and in front of the finer encoder; then how far predictions are off."""
    for joint in sorted({row["joint"] for row in rows}):
        own = [row for row in rows if row["joint"] == joint]
        fine = [row for row in own if row["finer_encoder"] and row["swept"] == "d_fraction"]
        by_d = [row["d_fraction"] for row in fine if row["dominant"] == "d"]
        finer = f"; with the finer encoder by the {fine[-1]['dominant']}" if fine else ""
        of_d = f", by d at {max(by_d)} bits" if by_d else ""
        yield f"joint {joint}: dominated by the {own[0]['dominant']}{finer}{of_d}"
    ratios = [row["ratio"] for row in rows]
    yield f"measured over predicted: {min(ratios):.2f} to {max(ratios):.2f} in {len(ratios)} cases"
    if far := sum(not 0.5 <= ratio <= 2.0 for ratio in ratios):
        yield f"beyond a factor of 2 in {far} of them: no prediction holds near the limit of"
        yield "stability, and too little is measured where the torque that pushes is limited"


def _table(console: Console, joint: int, rows: Sequence[Row]) -> None:
    table = new_table(f"joint {joint} at rest, urad", ("format",), HEADS)
    for row in rows:
        if row["swept"] == "d_fraction" and row["d_fraction"] not in SHOWN_D_FRACTIONS:
            continue
        predicted, period_s = row["predicted"], row["period_s"]
        alone = (predicted[f"{name}_rad"] for name in ("d", "current", "reference", "encoder"))
        table.add_row(
            _named(row),
            *(_urad(width) for width in (*alone, predicted["range_rad"], row["measured_rad"])),
            f"{row['ratio']:.2f}",
            _urad(row["amplitude_rad"]),
            "-" if period_s is None else f"{1.0 / period_s:.0f}",
        )
    console.print(table)


def _named(row: Row) -> str:
    """Return what a case has of its own."""
    swept = row["swept"]
    if swept not in SHORT:
        return str(swept)
    return f"{'fine, ' if row['finer_encoder'] else ''}{SHORT[swept]}: {row[swept]}"


def _urad(rad: float) -> str:
    urad = rad * 1e6
    return f"{urad:.{0 if urad >= 99.95 else 1 if urad >= 9.995 else 2}f}"
