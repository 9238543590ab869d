"""The options of `hil timing`: of a scenario, of a database alone, of both."""

from pathlib import Path
from typing import Annotated

import typer

ScenarioArgument = Annotated[str | None, typer.Argument(help="A built-in scenario's name, or a .toml file.")]
Database = Annotated[
    Path | None, typer.Option("--dbc", help="Analyse a database alone: messages, lengths, senders, GenMsgCycleTime.")
]
Bitrate = Annotated[
    int | None, typer.Option(min=1_000, max=1_000_000, help="Of --dbc: bits per second; default: 1000000.")
]
DataBitrate = Annotated[
    int | None,
    typer.Option(
        min=1_000, max=20_000_000, help="Of CAN FD, shown beside what is classic; default of scenarios: 4000000."
    ),
]
Periods = Annotated[
    list[str],
    typer.Option(
        "--period",
        metavar="[NAME=]MS",
        help="Of --dbc: a message's period (repeatable); of all without one, if no NAME.",
    ),
]
Jitters = Annotated[
    list[str],
    typer.Option(
        "--jitter", metavar="[NAME=]MS", help="Of --dbc: how late it may be queued (repeatable); all, if no NAME."
    ),
]
Deadlines = Annotated[
    list[str],
    typer.Option(
        "--deadline", metavar="[NAME=]MS", help="Of --dbc: in place of its period (repeatable); all, if no NAME."
    ),
]
Fifo = Annotated[
    list[str],
    typer.Option("--fifo", metavar="NODE", help="Of --dbc: it sends first-in-first-out (repeatable); all: every node."),
]
Depth = Annotated[int | None, typer.Option(min=1, help="Of --dbc: frames that each node's transmit queue holds.")]
Burst = Annotated[int | None, typer.Option(min=1, help="Errors of the bus that come at once, at most.")]
ErrorInterval = Annotated[
    float | None, typer.Option(min=0.1, help="Of --burst: milliseconds between errors, at least; default: 10.")
]
WallChannel = Annotated[
    str | None, typer.Option("--channel", "-c", help="Name of the bus: measure there, by the clock `wall`.")
]
Pace = Annotated[
    float | None, typer.Option(min=1e-6, max=1.0, help="On such a bus: emulated seconds a second; default: 1.")
]
BusOnly = Annotated[bool, typer.Option("--bus", help="The bus alone: no CPUs, no delay margins.")]
Jobs = Annotated[int | None, typer.Option(min=1, max=256, help="Runs at a time; default: one a CPU.")]
Out = Annotated[Path | None, typer.Option(help="Folder for figures, trace and results.")]
