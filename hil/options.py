"""Options that several commands share, and what they mean."""

import json
from typing import Annotated, Any

import typer

Interface = Annotated[str, typer.Option("--interface", "-i", help="python-can interface; hil has virtual time.")]
BusKwargs = Annotated[str, typer.Option("--bus-kwargs", help="More keywords for the interface, as JSON.")]


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
