"""The command `hil timing`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from hil.errors import FaultError
from hil.reported import reported


@reported
def timing(
    dbc: Annotated[Path, typer.Option("--dbc", help="The database: messages, lengths, GenMsgCycleTime.")],
    bitrate: Annotated[int, typer.Option(min=1_000, max=1_000_000, help="Bits per second.")] = 1_000_000,
    period: Annotated[
        list[str],
        typer.Option(
            "--period", metavar="[NAME=]MS", help="A message's period (repeatable); of all without one, if no NAME."
        ),
    ] = [],  # noqa: B006 (typer reads the default, nobody writes it)
    burst: Annotated[int | None, typer.Option(min=1, help="Errors of the bus that come at once, at most.")] = None,
    error_interval: Annotated[float, typer.Option(min=0.1, help="Milliseconds between errors, at least.")] = 10.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Bound the response time of every message of a database, and say which miss their deadlines."""
    from hil.timing import show
    from hil.timing.analysis import NS_A_SECOND, analyse, messages_of
    from hil.timing.response_time import Errors

    if NS_A_SECOND % bitrate:
        raise typer.BadParameter(
            f"--bitrate {bitrate}: a bit lasts no whole number of ns; take 1000000, 500000, 250000"
        )
    bit_ns = NS_A_SECOND // bitrate
    errors = None if burst is None else Errors(burst, round(error_interval * 1e6))
    found = analyse(messages_of(dbc, bit_ns, _periods(period)), bit_ns, errors)
    print(json.dumps(found)) if as_json else show.analysis(found)
    missed = [each["name"] for each in found["messages"] if not each["meets_deadline"]]
    if missed:
        raise FaultError(f"{', '.join(missed)}: may miss the deadline; utilisation {found['utilisation']:.1%}")


def _periods(given: list[str]) -> dict[str, float]:
    """Return the periods in ms by name, "" for all that have none."""
    found = {}
    for each in given:
        name, _, text = each.rpartition("=")
        try:
            found[name] = float(text)
        except ValueError:
            found[name] = 0.0
        if not 1e-3 <= found[name] <= 1e6:
            raise typer.BadParameter(f"--period {each}: write NAME=MS or MS, from 0.001 to 1000000, for example Sync=1")
    return found
