"""What a person sees of a finished sweep, in 80 columns."""

from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from hil.sweep.row import OK, REFUSED, STOPPED, TIP


def show(console: Console, found: dict[str, Any], folder: Path | None) -> None:
    """Print how many points came to what, the best and worst run of every sweep, and why others have no figures."""
    console.print(f"{found['scenario']}: {found['points']} points, {status(found)}", soft_wrap=True)
    for sweep in found["sweeps"]:
        console.print(_runs(sweep))
        for name in (STOPPED, REFUSED):
            if (row := sweep[f"first_{name}"]) is not None:
                console.print(f"first {name}: point {row['index']}: {row['reason']}", soft_wrap=True)
    console.print("tip: its largest deviation")
    console.print(f"table sha256 {found['table_sha256']}", soft_wrap=True)
    if folder is not None:
        console.print(f"sweep folder: {folder}", soft_wrap=True)


def status(counts: dict[str, int]) -> str:
    """Return counts by status in a line."""
    return ", ".join(f"{counts.get(name, 0)} {name}" for name in (OK, STOPPED, REFUSED))


def _runs(sweep: dict[str, Any]) -> Table:
    """Return a table of the best and the worst run."""
    title = f"{sweep['name']} ({sweep['method']}): {status(sweep)}"
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("")
    for head in ("point", "tip, mm"):
        table.add_column(head, justify="right", no_wrap=True)
    table.add_column("at")
    for name in ("best", "worst"):
        if (row := sweep[name]) is not None:
            values = "\n".join(f"{path} = {_number(value)}" for path, value in row["values"].items())
            table.add_row(name, str(row["index"]), f"{row[TIP] * 1000:.4g}", values)
    return table


def _number(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
