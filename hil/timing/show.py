"""What a person sees of an analysis."""

from typing import Any

from rich.console import Console
from rich.table import Table


def analysis(found: dict[str, Any]) -> None:
    """Print the bound of every message beside its deadline, ms, and what the transmit queues may hold."""
    console = Console(markup=False, highlight=False)
    console.print(_messages(found["messages"]))
    if any(each["holds"] is not None for each in found["queues"]):
        console.print(_queues(found["queues"]))
    lowest = found["lowest_bitrate"]
    limit = (
        "no bit rate up to 1 Mbit/s meets all deadlines" if lowest is None else f"all are met from {lowest} bit/s on"
    )
    data = "" if found["data_bitrate"] is None else f", {found['data_bitrate']:.0f} bit/s in FD data"
    console.print(
        f"utilisation {found['utilisation']:.1%} at {found['bitrate']:.0f} bit/s{data}; {limit} "
        "(ms; intermission included)"
    )


def _messages(rows: list[dict[str, Any]]) -> Table:
    beside = any(each["response_bound_fd_s"] is not None for each in rows)
    table = Table(title="ms, intermission included")
    for column in ("message", "id"):
        table.add_column(column, no_wrap=True)
    for column in ("period", "worst\nbits", "response\nat most", *["as\nCAN FD"] * beside, "deadline"):
        table.add_column(column, justify="right")
    table.add_column("", no_wrap=True)
    for each in rows:
        table.add_row(
            each["name"],
            f"{each['identifier']:#x}",
            f"{each['period_s'] * 1e3:g}",
            str(each["bits_worst"]),
            _bound(each["response_bound_s"]),
            *[_bound(each["response_bound_fd_s"])] * beside,
            f"{each['deadline_s'] * 1e3:g}",
            "met" if each["meets_deadline"] else "MISSED",
        )
    return table


def _bound(bound_s: float | None) -> str:
    return "no end" if bound_s is None else f"{bound_s * 1e3:.3f}"


def _queues(rows: list[dict[str, Any]]) -> Table:
    table = Table(title="transmit queues")
    table.add_column("node", no_wrap=True)
    for column in ("frames\nat most", "places"):
        table.add_column(column, justify="right")
    table.add_column("")
    verdicts = {True: "holds", False: "MAY OVERFLOW", None: "nobody is known to send these"}
    for each in rows:
        most = "?" if each["frames_at_most"] is None else str(each["frames_at_most"])
        table.add_row(each["node"] or "", most, str(each["depth"]), verdicts[each["holds"]])
    return table
