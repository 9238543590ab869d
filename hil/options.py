"""Options that several commands share, and what they mean."""

import json
import os
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

Interface = Annotated[str, typer.Option("--interface", "-i", help="python-can interface; hil has virtual time.")]
BusKwargs = Annotated[str, typer.Option("--bus-kwargs", help="More keywords for the interface, as JSON.")]

ScenarioName = Annotated[str, typer.Argument(help="A built-in scenario's name, or a .toml file.")]
Settings = Annotated[list[str], typer.Option("--set", metavar="PATH=VALUE", help="Set one value of the scenario.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")]
ScenarioOption = Annotated[str, typer.Option("--scenario", help="Built-in scenario or .toml file.")]
ChannelName = Annotated[str, typer.Option("--channel", "-c", help="Name of the bus.")]
ClockKind = Annotated[
    Literal["virtual", "sync", "wall"] | None,
    typer.Option("--clock", help="Who advances time; default: virtual on the interface hil, sync on all others."),
]
External = Annotated[
    list[str], typer.Option("--external", metavar="NODE", help="Somebody else plays this node (repeatable).")
]
At = Annotated[
    list[str], typer.Option("--at", metavar="NODE=CHANNEL", help="This node is at another channel (repeatable).")
]


def bus_options(bus_kwargs: str) -> dict[str, Any]:
    """Return the keywords for an interface."""
    try:
        options = json.loads(bus_kwargs)
    except ValueError:
        options = None
    if not isinstance(options, dict):
        raise typer.BadParameter(
            f"--bus-kwargs {bus_kwargs}: write a JSON object, for example '{{\"bitrate\": 500000}}'"
        )
    for taken in ("interface", "channel", "can_filters"):
        if taken in options:
            raise typer.BadParameter(
                f"--bus-kwargs {bus_kwargs}: {taken} is not for here: use --interface and --channel; filters are ours"
            )
    return options


def place_of(interface: str, channel: str | None, bus_kwargs: str, clock: str) -> Any:
    """Return where the bus is that has no virtual time, None for the rig's own."""
    from hil.can_node import Place

    if interface == "hil" and clock == "virtual":
        return None
    options = bus_options(bus_kwargs)
    if channel is None:
        raise typer.BadParameter(f"--interface {interface} needs --channel, for example --channel vcan0")
    return Place(interface, channel, options)


def channels_of(at: list[str]) -> dict[str, str]:
    """Return the channel of each node that is not at the rig's."""
    pairs = [each.partition("=") for each in at]
    if not all(equals and channel for _, equals, channel in pairs):
        raise typer.BadParameter(f"--at {' '.join(at)}: write NODE=CHANNEL, for example --at joint2=can1")
    return {name: channel for name, _, channel in pairs}


def with_clock(settings: list[str], clock: str | None) -> list[str]:
    """Return settings that choose this clock, too."""
    return settings if clock is None else [*settings, f"clock.kind={clock}"]


def dilated(scenario: Any, pace: float) -> Any:
    """Return the scenario with this pace of the clock `wall`."""
    if scenario.clock.kind != "wall" or pace > 1.0:
        raise typer.BadParameter(
            f"--pace {pace:g} on a bus without time of its own: only --clock wall has one, of at most 1"
        )
    return scenario.model_copy(update={"clock": scenario.clock.model_copy(update={"pace": pace})})


def new_folder(out: Path | None, as_json: bool, name: str) -> Path | None:
    """Return the folder to write to, one of its own in runs/ by default; refuse one that holds something."""
    from hil import record

    if out is None and not as_json:
        out = Path("runs") / f"{name}-{datetime.now():%Y%m%d-%H%M%S}-{os.getpid()}"
    if out is not None:
        record.check_new(out)
    return out
