"""What a person sees of an analysis."""

from typing import Any

from rich.console import Console
from rich.table import Table


def analysis(found: dict[str, Any]) -> None:
    """Print the bound of every message beside its deadline, ms."""
    console = Console(markup=False, highlight=False)
    table = Table(title="ms, intermission included")
    for column in ("message", "identifier"):
        table.add_column(column, no_wrap=True)
    for column in ("period", "worst bits", "response\nat most", "deadline"):
        table.add_column(column, justify="right")
    table.add_column("")
    for each in found["messages"]:
        bound = each["response_bound_s"]
        table.add_row(
            each["name"],
            f"{each['identifier']:#x}",
            f"{each['period_s'] * 1e3:g}",
            str(each["bits_worst"]),
            "for ever" if bound is None else f"{bound * 1e3:.3f}",
            f"{each['deadline_s'] * 1e3:g}",
            "met" if each["meets_deadline"] else "MISSED",
        )
    console.print(table)
    lowest = found["lowest_bitrate"]
    limit = (
        "no bit rate up to 1 Mbit/s meets all deadlines" if lowest is None else f"all are met from {lowest} bit/s on"
    )
    console.print(
        f"utilisation {found['utilisation']:.1%} at {found['bitrate']:g} bit/s; {limit} (ms; intermission included)"
    )
