"""`hil timing SCENARIO`: its parts one after the other, in virtual time or by the clock; and the folder of results."""

import json
from collections.abc import Collection, Mapping
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from hil.errors import FaultError
from hil.record import SCENARIO, run_folder, to_toml
from hil.rig import Progress
from hil.scenario import Scenario
from hil.summary import faults
from hil.timing import rig_show
from hil.timing.response_time import Errors
from hil.timing.study import Study, study
from hil.timing.wall_study import wall_study
from hil.watchdog import Notice

if TYPE_CHECKING:
    from hil.can_node import Place

TIMING = "timing.json"
USUAL_BITRATES = (10_000, 20_000, 50_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
"""CiA 301, table 1."""
BUS_SHARE = 0.1
"""Of the time that a whole report takes."""


def in_virtual_time(scenario: Scenario, data_bit_ns: int, errors: Errors | None, step: Progress) -> Study:
    """Return what was found of a scenario on the rig's own bus."""
    return study(scenario, data_bit_ns, errors, lambda share: step(BUS_SHARE * share))


def by_the_clock(
    scenario: Scenario,
    place: "Place",
    external: Collection[str],
    elsewhere: Mapping[str, str],
    data_bit_ns: int,
    errors: Errors | None,
    step: Progress,
    notice: Notice,
) -> Study:
    """Return what was found on a bus without time of its own, by the clock `wall`."""
    from hil.bus_rig import run_on_bus

    outcome = run_on_bus(scenario, place, external, elsewhere, step, notice, inf)
    return Study(wall_study(outcome, data_bit_ns, errors), outcome)


def conclude(found: Study, as_json: bool, out: Path | None) -> None:
    """Write and show what was found; raise FaultError where a deadline may be missed, or the run stopped itself."""
    if out is not None:
        _write(found, out)
    print(json.dumps(found.found, allow_nan=False)) if as_json else rig_show.show(Console(), found.found, out)
    if found.found["late"] is not None:
        raise FaultError(_too_late(found.found))
    for fault in [] if found.outcome is None else faults(found.outcome):
        raise FaultError(f"the run stopped at {fault['time_s']:.3f} s: {fault['node']}: {fault['cause']}")


def _too_late(found: dict[str, Any]) -> str:
    """Say which frame does not get through in its cycle, and what would help."""
    lowest = found["lowest_bitrate"]
    enough = [rate for rate in USUAL_BITRATES if lowest is not None and rate >= lowest]
    cure = f"take bus.bitrate = {enough[0]}" if enough else "no bit rate up to 1 Mbit/s is enough: take"
    return (
        f"{found['late']} may not end within clock.period_s = {found['period_s']:g}: the cycle's frames need "
        f"{found['utilisation']:.1%} of the bus at {found['bitrate']:.0f} bit/s, and wait for what is computed: "
        f"{cure}{', or' if enough else ''} a longer period, fewer joints, faster CPUs"
    )


def _write(found: Study, path: Path) -> None:
    """Write the folder, whole or not at all."""
    with run_folder(path) as folder:
        (folder / TIMING).write_text(json.dumps(found.found, indent=2, allow_nan=False) + "\n")
        if found.outcome is not None:
            (folder / SCENARIO).write_text(to_toml(found.outcome.scenario))
