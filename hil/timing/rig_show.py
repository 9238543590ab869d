"""What a person sees of a scenario's timing."""

from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table


def show(console: Console, found: dict[str, Any]) -> None:
    """Print messages, chains, and the bit rates that would do."""
    console.print(_messages(found))
    if found["chains"]:
        console.print(_chains(found["chains"]))
    console.print(_by_joints(found))
    lowest = found["lowest_bitrate"]
    does = "no bit rate up to 1 Mbit/s does" if lowest is None else f"every frame meets its deadline from {lowest} on"
    console.print(
        "bound: of the longest frames; run's: of this run's; FD's: as CAN FD; missed: by bus, by CPU, by this host"
    )
    console.print(
        f"utilisation {found['utilisation']:.1%} at {found['bitrate']:.0f} bit/s with the longest frames; {does}",
        soft_wrap=True,
    )


def _messages(found: dict[str, Any]) -> Table:
    """Return a row a message; State and Heartbeat, which take turns, as their longest."""
    asked, of_time = "queued", ""
    if found["clock"] == "wall":
        dilated = f", dilated {1 / found['pace']:g} times" if found["pace"] < 1 else ""
        asked, of_time = "the frame that it answers", f" of wall time{dilated}"
    table = _table(f"every frame's response: from {asked} to the end of intermission, us{of_time}")
    table.add_column("message", no_wrap=True)
    for head in ("bits", "queued", "p50", "p99.9", "max", "bound", "run's", "FD's", "deadline"):
        table.add_column(head, justify="right", no_wrap=True)
    for row in _merged(found["messages"]):
        measured = row["response"] or {}
        queued = row["queued_s"]
        table.add_row(
            row["name"],
            str(row["bits_worst"]),
            "-" if queued is None else "..".join(dict.fromkeys(_us(each) for each in queued)),
            *(_us(measured.get(key)) for key in ("p50_s", "p99.9_s", "max_s")),
            *(_us(row[f"response_bound{of}_s"]) for of in ("", "_actual", "_fd")),
            _us(row["deadline_s"]) if row["meets_deadline"] else "missed",
        )
    return table


def _merged(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows with one for all State and one for all Heartbeat frames: that with the longest response."""
    chosen: dict[str, dict[str, Any]] = {}
    for row in rows:
        kind = row["name"].partition("_")[0]
        name = f"{kind}_n" if kind in ("State", "Heartbeat") else row["name"]
        before = chosen.get(name)
        if before is None or (row["response_max_s"] or 0.0) > (before["response_max_s"] or 0.0):
            chosen[name] = row | {"name": name}
    return list(chosen.values())


def _chains(chains: list[dict[str, Any]]) -> Table:
    """Return a row a chain."""
    table = _table("from the sample to the current's action, us")
    table.add_column("of", no_wrap=True)
    for head in ("least", "p50", "p99.9", "max", "bound", "deadline", "missed"):
        table.add_column(head, justify="right")
    for chain in chains:
        measured = chain["measured"] or {}
        table.add_row(
            chain["name"].replace("sample to action", "observer").replace("sample, DSP, action", "by the DSP"),
            *(_us(measured.get(key)) for key in ("min_s", "p50_s", "p99.9_s", "max_s")),
            *(_us(chain[key]) for key in ("bound_s", "deadline_s")),
            ", ".join(str(count) for count in chain["misses"].values()),
        )
    return table


def _by_joints(found: dict[str, Any]) -> Table:
    """Return the lowest bit rate for every number of joints."""
    fast = found["data_bitrate"] / 1e6
    table = _table(f"lowest bit rate at which a cycle of {found['period_s'] * 1e3:g} ms holds, kbit/s")
    table.add_column("joints", justify="right")
    table.add_column("CAN", justify="right")
    table.add_column(f"CAN FD, data at {fast:g} Mbit/s", justify="right")
    for row in found["by_joints"]:
        rates = (row["lowest_bitrate"], row["lowest_bitrate_fd"])
        table.add_row(str(row["joints"]), *("none to 1000" if rate is None else f"{rate / 1e3:.1f}" for rate in rates))
    return table


def _us(value_s: float | None) -> str:
    return "-" if value_s is None else f"{value_s * 1e6:.0f}"


def _table(title: str) -> Table:
    """Return a table that leaves 80 columns to its numbers."""
    return Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
