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
    try:
        check_budget(scenario)
    except ScenarioError as error:
        return Study(analysis.to_json({}) | {"refused": str(error)})
    outcome, timeline = run_with_timeline(scenario, progress)
    codec, cycles = load_arm(), cycles_of(outcome)
    silent = {name: np.array(each) for name, each in timeline.silent(scenario.period_ns, cycles).items()}
    links = chains(Run(scenario, cycles, by_cycle(timeline, scenario, codec, cycles), silent), analysis.worst)
    found = analysis.to_json(responses(timeline, scenario, codec))
    return Study(
        found | {"cycles": cycles, "chains": [to_json(link) for link in links]}, outcome, timeline, tuple(links)
    )


def cycles_of(outcome: Outcome) -> int:
    """Return how many cycles a run has had, whole: all of them, or those before its Stop."""
    ended_ns = outcome.log.frames[-1][0] if outcome.log.frames else 0
    return min(outcome.scenario.cycles, ended_ns // outcome.scenario.period_ns)
