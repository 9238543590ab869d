"""The command `hil timing`."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.errors import FaultError
from hil.options import (
    At,
    BusKwargs,
    External,
    Interface,
    Settings,
    channels_of,
    dilated,
    new_folder,
    place_of,
    with_clock,
)
from hil.reported import reported

if TYPE_CHECKING:
    from hil.timing.response_time import Errors


@reported
def timing(
    scenario: Annotated[str | None, typer.Argument(help="A built-in scenario's name, or a .toml file.")] = None,
    dbc: Annotated[
        Path | None, typer.Option("--dbc", help="Analyse a database alone: messages, lengths, GenMsgCycleTime.")
    ] = None,
    bitrate: Annotated[int, typer.Option(min=1_000, max=1_000_000, help="Of --dbc: bits per second.")] = 1_000_000,
    period: Annotated[
        list[str],
        typer.Option(
            "--period",
            metavar="[NAME=]MS",
            help="Of --dbc: a message's period (repeatable); of all without one, if no NAME.",
        ),
    ] = [],  # noqa: B006 (typer reads the default, nobody writes it)
    burst: Annotated[int | None, typer.Option(min=1, help="Errors of the bus that come at once, at most.")] = None,
    error_interval: Annotated[float, typer.Option(min=0.1, help="Milliseconds between errors, at least.")] = 10.0,
    data_bitrate: Annotated[
        int, typer.Option(min=125_000, max=20_000_000, help="CAN FD beside: bits per second of the data phase.")
    ] = 4_000_000,
    settings: Settings = [],  # noqa: B006 (as above)
    interface: Interface = "hil",
    channel: Annotated[str | None, typer.Option("--channel", "-c", help="Name of the bus: measure by `wall`.")] = None,
    bus_kwargs: BusKwargs = "{}",
    pace: Annotated[float, typer.Option(min=1e-6, max=1.0, help="On such a bus: emulated seconds a second.")] = 1.0,
    external: External = [],  # noqa: B006 (as above)
    at: At = [],  # noqa: B006 (as above)
    bus_only: Annotated[bool, typer.Option("--bus", help="The bus alone: no CPUs, no delay margins; 1 s.")] = False,
    jobs: Annotated[int | None, typer.Option(min=1, max=256, help="Runs at a time; default: one a CPU.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for figures, trace and results.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Bound and measure when every frame arrives and every current acts, and how much delay the loops bear."""
    from hil import scenario_file, show
    from hil.timing import scenario_command
    from hil.timing.response_time import Errors

    errors = None if burst is None else Errors(burst, round(error_interval * 1e6))
    if dbc is not None and scenario is None:
        _of_database(dbc, bitrate, period, errors, as_json)
        return
    if dbc is not None or scenario is None:
        raise typer.BadParameter("name a scenario, for example paper-joint, or a database with --dbc; one of both")
    clock = "virtual" if interface == "hil" and channel is None else "wall"
    chosen = scenario_file.load(scenario, with_clock(settings, clock))
    place, data_bit_ns = place_of(interface, channel, bus_kwargs, clock), bit_of("--data-bitrate", data_bitrate)
    if out is not None:
        new_folder(out, as_json, chosen.name)
    with show.progress(f"{chosen.name}", quiet=as_json) as (step, notice):
        if place is None:
            found = scenario_command.in_virtual_time(chosen, data_bit_ns, errors, bus_only, jobs, step)
        else:
            chosen = dilated(chosen, pace)
            where = place, external, channels_of(at)
            found = scenario_command.by_the_clock(chosen, *where, data_bit_ns, errors, step, notice)
    scenario_command.conclude(found, as_json, out)


def _of_database(dbc: Path, bitrate: int, period: list[str], errors: "Errors | None", as_json: bool) -> None:
    """Analyse a database alone."""
    from hil.timing import show
    from hil.timing.analysis import analyse, messages_of

    bit_ns = bit_of("--bitrate", bitrate)
    found = analyse(messages_of(dbc, bit_ns, _periods(period)), bit_ns, errors)
    print(json.dumps(found)) if as_json else show.analysis(found)
    missed = [each["name"] for each in found["messages"] if not each["meets_deadline"]]
    if missed:
        raise FaultError(f"{', '.join(missed)}: may miss the deadline; utilisation {found['utilisation']:.1%}")


def bit_of(option: str, bitrate: int) -> int:
    """Return how long a bit lasts, in ns."""
    from hil.wire.rates import bit_time_ns

    try:
        return bit_time_ns(bitrate)
    except ValueError as error:
        raise typer.BadParameter(f"{option} {bitrate}: {error}") from None


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
