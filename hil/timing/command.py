"""The command `hil timing`."""

from decimal import Decimal
from pathlib import Path
from typing import Annotated

import typer

from hil.reported import reported

Times = list[str]


@reported
def timing(
    dbc: Annotated[Path, typer.Option("--dbc", help="The database: messages, lengths, senders, GenMsgCycleTime.")],
    bitrate: Annotated[int, typer.Option(min=1_000, max=1_000_000, help="Bits per second.")] = 1_000_000,
    data_bitrate: Annotated[
        int | None,
        typer.Option(min=1_000, max=10_000_000, help="Of CAN FD; what is classic is shown as CAN FD beside it."),
    ] = None,
    period: Annotated[
        Times,
        typer.Option(
            "--period", metavar="[NAME=]MS", help="A message's period (repeatable); of all without one, if no NAME."
        ),
    ] = [],  # noqa: B006 (typer reads the default, nobody writes it)
    jitter: Annotated[
        Times,
        typer.Option("--jitter", metavar="[NAME=]MS", help="How late it may be queued (repeatable); all, if no NAME."),
    ] = [],  # noqa: B006
    deadline: Annotated[
        Times,
        typer.Option("--deadline", metavar="[NAME=]MS", help="In place of its period (repeatable); all, if no NAME."),
    ] = [],  # noqa: B006
    fifo: Annotated[
        list[str],
        typer.Option("--fifo", metavar="NODE", help="It sends first-in-first-out (repeatable); all: every node."),
    ] = [],  # noqa: B006
    depth: Annotated[int | None, typer.Option(min=1, help="Frames that each node's transmit queue holds.")] = None,
    burst: Annotated[int | None, typer.Option(min=1, help="Errors of the bus that come at once, at most.")] = None,
    error_interval: Annotated[float, typer.Option(min=0.1, help="Milliseconds between errors, at least.")] = 10.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Bound the response time of every message of a database, and say which miss their deadlines."""
    from hil.timing.database import Given
    from hil.timing.database_command import analyse_database, by_name, errors_of, rates_of

    jitters = by_name("--jitter", jitter, Decimal(0))
    given = Given(by_name("--period", period), jitters, by_name("--deadline", deadline))
    errors = errors_of(burst, error_interval)
    analyse_database(dbc, rates_of(bitrate, data_bitrate), given, errors, fifo, depth, as_json)
