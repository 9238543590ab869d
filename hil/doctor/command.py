"""The command `hil doctor`."""

import json
from typing import Annotated

import typer

from hil.errors import ChannelError
from hil.options import BusKwargs, ChannelName, ScenarioOption, bus_options
from hil.reported import reported


@reported
def doctor(
    interface: Annotated[str, typer.Option("--interface", "-i", help="python-can interface.")] = "socketcan",
    channel: ChannelName = "can0",
    bus_kwargs: BusKwargs = "{}",
    scenario: ScenarioOption = "paper-joint",
    listen: Annotated[float, typer.Option(min=0.0, max=3600.0, help="Seconds to listen for other traffic.")] = 1.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")] = False,
) -> None:
    """Check an interface and this machine for runs of a scenario, and say how to mend what is wrong."""
    from hil import scenario_file
    from hil.can_node import Place
    from hil.doctor.examine import examine
    from hil.doctor.finding import worst
    from hil.doctor.link_checks import CLAIMS
    from hil.doctor.show import findings

    chosen = scenario_file.load(scenario)
    place = Place(interface, channel, bus_options(bus_kwargs))
    found = examine(place, chosen, listen)
    if as_json:
        about = {"interface": interface, "channel": channel, "scenario": chosen.name, "verdict": worst(found)}
        claims = {"timing_claims": any(each.name == CLAIMS and each.verdict == "ok" for each in found)}
        print(json.dumps(about | claims | {"findings": [each._asdict() for each in found]}))
    else:
        findings(f"{interface} {channel} for {chosen.name}", found)
    bad = [each.name for each in found if each.verdict == "bad"]
    if bad:
        raise ChannelError(f"{interface} {channel}: {', '.join(bad)}: mend this first")
