"""What a person sees of a scenario's timing."""

from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from hil.constants import BY_TURNS
from hil.wire.rates import NS_PER_S

USUAL_BITRATES = (10_000, 20_000, 50_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
"""CiA 301, table 1."""


def show(console: Console, found: dict[str, Any]) -> None:
    """Print messages, chains, and the bit rates that would do."""
    console.print(_messages(found))
    if found["chains"]:
        console.print(_chains(found["chains"]))
    console.print(_by_joints(found))
    console.print(
        "bound: of the longest frames; run's: of this run's; FD's: as CAN FD; share: max / bound", soft_wrap=True
    )
    if found["chains"]:
        console.print(f"missed, of {found['cycles']} cycles: by bus, CPU, drive's dead time, this host")
    for line in [*_rates(found), *_beyond(found), *_saturating(found["beyond_declared_s"])]:
        console.print(line, soft_wrap=True)


def _rates(found: dict[str, Any]) -> list[str]:
    """Return what the longest frames take of the bus, and what bit rate would do."""
    lowest = found["lowest_bitrate"]
    does = "no bit rate up to 1 Mbit/s does"
    if lowest is not None:
        usual = min(rate for rate in USUAL_BITRATES if rate >= lowest)
        bit_ns = round(NS_PER_S / lowest)
        does = f"every frame meets its deadline from {lowest} on (a bit of {bit_ns} ns), so at {usual}"
    return [f"utilisation {found['utilisation']:.1%} at {found['bitrate']:.0f} bit/s with the longest frames; {does}"]


def _beyond(found: dict[str, Any]) -> list[str]:
    """Return why something is beyond its bound."""
    beyond = [row["name"] for row in found["messages"] if (row["max_to_bound"] or 0.0) > 1.0]
    if not beyond:
        return []
    why = (
        "bounds are those of an undisturbed bus: see --burst"
        if found["with_faults"]
        else "a node sends otherwise than declared"
    )
    if found["clock"] == "wall":
        why = "bounds are of nodes that compute as declared, in real time: this host takes longer"
    return [f"beyond their bounds: {', '.join(beyond)}: {why}"]


def _saturating(beyond_s: dict[str, float]) -> list[str]:
    """Return what bounds leave out of joints of machine code."""
    if not beyond_s:
        return []
    each = ", ".join(f"{name} up to {longer_s * 1e6:.1f} us" for name, longer_s in beyond_s.items())
    return [f"bounds hold while nothing saturates in the machine code, where it takes longer: {each}"]


def _messages(found: dict[str, Any]) -> Table:
    """Return a row a message; State and Heartbeat, which take turns, as their longest."""
    asked, of_time = "queued", ""
    if found["clock"] == "wall":
        dilated = f", dilated {1 / found['pace']:g} times" if found["pace"] < 1 else ""
        asked, of_time = "the frame that it answers", f" of wall time{dilated}"
    table = _table(f"every frame's response: from {asked} to the end of intermission, us{of_time}")
    table.add_column("message", no_wrap=True)
    for head in ("queued", "p50", "p99.9", "max", "bound", "share", "run's", "FD's", "deadline"):
        table.add_column(head, justify="right", no_wrap=True)
    for row in _merged(found["messages"]):
        measured = row["response"] or {}
        queued = row["queued_s"]
        table.add_row(
            row["name"],
            "-" if queued is None else "..".join(dict.fromkeys(_us(each) for each in queued)),
            *(_us(measured.get(key)) for key in ("p50_s", "p99.9_s", "max_s")),
            _us(row["response_bound_s"]),
            "-" if row["max_to_bound"] is None else f"{row['max_to_bound']:.2f}",
            *(_us(row[f"response_bound{of}_s"]) for of in ("_actual", "_fd")),
            "missed" if row["meets_deadline"] is False else _us(row["deadline_s"]),
        )
    return table


def _merged(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows with one for all State and one for all Heartbeat frames: that with the longest response."""
    chosen: dict[str, dict[str, Any]] = {}
    for row in rows:
        kind = row["name"].partition("_")[0]
        name = f"{kind}_n" if kind in BY_TURNS else row["name"]
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
