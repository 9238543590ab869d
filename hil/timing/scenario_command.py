"""`hil timing SCENARIO`: its parts one after the other, in virtual time or by the clock; and the folder of results."""

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from hil.errors import FaultError, ScenarioError
from hil.record import SCENARIO, run_folder, to_toml
from hil.reported import refuse_faults
from hil.rig import Progress
from hil.scenario import Scenario
from hil.summary import faults
from hil.timing import margin, rig_show
from hil.timing.computing import computing, show_computing
from hil.timing.drift import Comparison, compare, describe, show_drift
from hil.timing.margin_show import show_margins
from hil.timing.response_time import Errors
from hil.timing.study import Study, study
from hil.timing.wall_study import wall_study
from hil.wall_summary import real_time
from hil.watchdog import Notice

if TYPE_CHECKING:
    from hil.can_node import Place

TIMING = "timing.json"
BUS_SHARE = 0.1
"""Of the time that a whole report takes."""


@dataclass
class Report:
    """What was found of a scenario: of its bus; and of its CPUs, timers and loops, where that was asked for."""

    bus: Study
    computing: dict[str, Any] | None = None
    drift: Comparison | None = None
    margins: margin.Margins | None = None
    json: dict[str, Any] = field(init=False)

    def __post_init__(self) -> None:
        """Put it together for JSON, with None for what was not asked for."""
        self.json = self.bus.found | {
            "computing": self.computing,
            "drift": None if self.drift is None else describe(self.drift),
            "margins": None if self.margins is None else margin.to_json(self.margins),
        }


def in_virtual_time(
    scenario: Scenario, data_bit_ns: int, errors: Errors | None, bus_only: bool, jobs: int | None, step: Progress
) -> Report:
    """Return what was found of a scenario on the rig's own bus; bus_only: without CPUs, timers and loops."""
    from hil.pool import pool

    found = study(scenario, data_bit_ns, errors, lambda share: step(BUS_SHARE * share))
    if bus_only or found.outcome is None or faults(found.outcome):
        return Report(found)
    own_timers = any(scenario.crystal_ppb(n) is not None for n in range(1, scenario.joints + 1))
    drifted = compare(scenario) if own_timers else None
    with pool(jobs) as executor:
        margins = margin.margins(scenario, executor, lambda share: step(BUS_SHARE + (1 - BUS_SHARE) * share))
    return Report(found, computing(scenario), drifted, margins)


def by_the_clock(
    scenario: Scenario,
    place: "Place",
    external: Collection[str],
    elsewhere: Mapping[str, str],
    data_bit_ns: int,
    errors: Errors | None,
    step: Progress,
    notice: Notice,
) -> Report:
    """Return what was found on a bus without time of its own, by the clock `wall`."""
    from hil.bus_rig import run_on_bus

    outcome = run_on_bus(scenario, place, external, elsewhere, step, notice, inf)
    return Report(Study(wall_study(outcome, data_bit_ns, errors), outcome))


def conclude(report: Report, as_json: bool, out: Path | None) -> None:
    """Write and show what was found; raise FaultError where a deadline may be missed, or the run stopped itself.

    Raises ScenarioError where it was not run.
    """
    if out is not None:
        _write(report, out)
    print(json.dumps(report.json, allow_nan=False)) if as_json else _show(report, out)
    found, outcome = report.json, report.bus.outcome
    if found["late"] is not None:
        raise FaultError(_too_late(found))
    if found["refused"] is not None:
        raise ScenarioError(f"not run: {found['refused']}")
    refuse_faults([] if outcome is None else faults(outcome))
    if missed := [chain["name"] for chain in found["chains"] if sum(chain["misses"].values())]:
        raise FaultError(f"deadlines missed: {', '.join(missed)}")


def _too_late(found: dict[str, Any]) -> str:
    """Say which frame does not get through in its cycle, and what would help."""
    lowest = found["lowest_bitrate"]
    enough = [rate for rate in rig_show.USUAL_BITRATES if lowest is not None and rate >= lowest]
    cure = f"take bus.bitrate = {enough[0]}, or" if enough else "no bit rate up to 1 Mbit/s is enough: take"
    return (
        f"{found['late']} may not end within clock.period_s = {found['period_s']:g}: the cycle's frames need "
        f"{found['utilisation']:.1%} of the bus at {found['bitrate']:.0f} bit/s, and wait for what is computed: "
        f"{cure} a longer period, fewer joints, faster CPUs"
    )


def _show(report: Report, out: Path | None) -> None:
    console = Console(markup=False, highlight=False)
    rig_show.show(console, report.json)
    if report.computing is not None:
        show_computing(console, report.computing)
    if report.drift is not None:
        show_drift(console, report.json["drift"])
    if report.margins is not None:
        show_margins(console, report.margins)
    if out is not None:
        console.print(f"results: {out}", soft_wrap=True)


def _write(report: Report, path: Path) -> None:
    """Write the folder, whole or not at all: figures first, for which an extra may be missing."""
    from hil.timing import drift_figure, margin_figures, pictures
    from hil.wall_figure import write_latency

    with run_folder(path) as folder:
        pictures.write(folder, report.bus)
        if report.bus.outcome is not None and report.bus.outcome.clock:
            write_latency(folder, {"scenario": report.json["scenario"], **real_time(report.bus.outcome)})
        if report.drift is not None:
            drift_figure.write_drift(folder, report.drift)
        if report.margins is not None:
            margin_figures.write_figures(folder, report.margins)
        (folder / TIMING).write_text(json.dumps(report.json, indent=2, allow_nan=False) + "\n")
        if report.bus.outcome is not None:
            (folder / SCENARIO).write_text(to_toml(report.bus.outcome.scenario))
