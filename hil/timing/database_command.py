"""What `hil timing --dbc` does: options into numbers, the analysis, and what of it is a failure."""

import json
from collections.abc import Sequence
from decimal import Decimal, InvalidOperation
from math import isfinite
from pathlib import Path
from typing import Any

import typer

from hil.errors import FaultError
from hil.timing import show
from hil.timing.analysis import analyse
from hil.timing.database import MS, Given, fifo_nodes, messages_of
from hil.timing.response_time import Errors
from hil.wire.rates import Rates, of_bitrates

SHORTEST_MS, LONGEST_MS = Decimal("0.001"), Decimal(1_000_000)


def analyse_database(
    dbc: Path, rates: Rates, given: Given, errors: Errors | None, fifo: Sequence[str], depth: int | None, as_json: bool
) -> None:
    """Print the analysis of a DBC file; FaultError for messages that may be late and queues that may overflow."""
    messages = messages_of(dbc, rates.bit_ns, rates.data_bit_ns, given)
    nodes = fifo_nodes(messages, fifo, dbc)
    found = analyse(messages, rates.bit_ns, errors, data_bit_ns=rates.data_bit_ns, fifo=nodes, depth=depth)
    print(json.dumps(found)) if as_json else show.analysis(found)
    faults = [*_missed(found), *_overflowing(found)]
    if faults:
        raise FaultError("; ".join([*faults, f"utilisation {found['utilisation']:.1%}"]))


def _missed(found: dict[str, Any]) -> list[str]:
    """Say which messages have no bound, by reason, and which have one beyond their deadline."""
    by_reason: dict[str, list[str]] = {}
    for each in found["messages"]:
        if not each["meets_deadline"]:
            why = each["unbounded"] and f"may wait for ever: {each['unbounded']}"
            by_reason.setdefault(why or "may miss the deadline", []).append(each["name"])
    return [f"{', '.join(names)}: {reason}" for reason, names in by_reason.items()]


def _overflowing(found: dict[str, Any]) -> list[str]:
    """Say which transmit queues may overflow."""
    rows = [each for each in found["queues"] if each["holds"] is False]
    said = [
        f"{each['node']} may hold {each['frames_at_most']} frames at once, {each['depth']} have a place in its queue: "
        f"give it {each['frames_at_most']} places"
        for each in rows
        if each["frames_at_most"] is not None
    ]
    endless = [each["node"] for each in rows if each["frames_at_most"] is None]
    if endless:
        said.append(f"{', '.join(endless)}: no number of places is enough, for what may wait for ever")
    return said


def errors_of(burst: int | None, interval_ms: float) -> Errors | None:
    """Return the errors that the bus has to bear; a usage error where they come at no interval."""
    if not isfinite(interval_ms):
        raise typer.BadParameter(f"--error-interval {interval_ms}: write milliseconds, for example 10")
    return None if burst is None else Errors(burst, round(interval_ms * MS))


def rates_of(bitrate: int, data_bitrate: int | None) -> Rates:
    """Return the bit times; a usage error where one is no whole number of ns."""
    try:
        return of_bitrates(bitrate, data_bitrate)
    except ValueError as error:
        options = f"--bitrate {bitrate}" + (f", --data-bitrate {data_bitrate}" if data_bitrate else "")
        raise typer.BadParameter(f"{options}: {error}") from None


def by_name(option: str, given: Sequence[str], shortest_ms: Decimal = SHORTEST_MS) -> dict[str, int]:
    """Return what an option gives as [NAME=]MS in ns, by name, "" where there is none."""
    found = {}
    for each in given:
        name, _, text = each.rpartition("=")
        try:
            time_ms = Decimal(text)
            if not shortest_ms <= time_ms <= LONGEST_MS:
                raise InvalidOperation
        except InvalidOperation:
            raise typer.BadParameter(
                f"{option} {each}: write NAME=MS or MS, from {shortest_ms} to {LONGEST_MS}, for example Sync=1"
            ) from None
        if time_ms * MS % 1:
            cure = Decimal(int(time_ms * MS)) / MS
            raise typer.BadParameter(f"{option} {each}: no whole number of ns: round it, for example to {cure}")
        found[name] = int(time_ms * MS)
    return found
