"""A scenario's timing: every frame of a cycle bounded and measured, the chains through it, the bit rate it takes."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dbc.compiler import load_arm
from hil.constants import check_budget
from hil.errors import ScenarioError
from hil.rig import Outcome, Progress, no_progress
from hil.scenario import Scenario
from hil.timing.chains import Chain, Run, chains, to_json
from hil.timing.measured import by_cycle, responses
from hil.timing.response_time import Errors
from hil.timing.rig_analysis import Analysis
from hil.timing.timeline import Timeline, run_with_timeline


@dataclass(frozen=True)
class Study:
    """What was found, as JSON; and the run that it is from, None where the frames do not fit."""

    found: dict[str, Any]
    outcome: Outcome | None = None
    timeline: Timeline | None = None
    chains: tuple[Chain, ...] = ()


def study(
    scenario: Scenario, data_bit_ns: int, errors: Errors | None = None, progress: Progress = no_progress
) -> Study:
    """Bound a scenario, and measure it in virtual time; data_bit_ns: of CAN FD, beside. Raises ScenarioError."""
    if scenario.bus.fidelity == "functional":
        raise ScenarioError("bus.fidelity = 'functional': frames take no time, there is nothing to measure: set 'bits'")
    analysis = Analysis(scenario, data_bit_ns, errors)
    if not runs(scenario):
        return Study(analysis.to_json({}))
    outcome, timeline = run_with_timeline(scenario, progress)
    codec = load_arm()
    silent = {name: np.array(each) for name, each in timeline.silent(scenario.period_ns, scenario.cycles).items()}
    links = chains(Run(scenario, by_cycle(timeline, scenario, codec), silent), analysis.worst)
    found = analysis.to_json(responses(timeline, scenario, codec))
    return Study(found | {"chains": [to_json(chain) for chain in links]}, outcome, timeline, tuple(links))


def runs(scenario: Scenario) -> bool:
    """Return whether a scenario's cycle is not refused; with errors, or own timers, a frame may still be late in it."""
    try:
        check_budget(scenario)
    except ScenarioError:
        return False
    return True
