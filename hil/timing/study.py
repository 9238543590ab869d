"""A scenario's timing: every frame of a cycle bounded and measured, the chains through it, the bit rate it takes."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from dbc.compiler import describe_arm, load_arm
from hil.constants import cycle_frames
from hil.errors import ScenarioError
from hil.rig import Outcome, Progress, no_progress
from hil.scenario import Scenario
from hil.timing.analysis import NS_A_SECOND
from hil.timing.chains import Chain, Run, to_json
from hil.timing.chains import chains as chains_of
from hil.timing.cycle import Bound, Late
from hil.timing.measured import Array, by_cycle, responses, seconds
from hil.timing.response_time import Errors
from hil.timing.rig_cycle import STATUS, Cycle, Spans, by_joints, cycle_of, lowest_bitrate, worst_spans
from hil.timing.timeline import Timeline, run_with_timeline
from hil.wire.bits import INTERMISSION_BITS, worst_case_bits
from hil.wire.rates import Rates

SLOW = ("State", "Heartbeat")


@dataclass(frozen=True)
class Study:
    """What was found. found: as JSON; timeline, outcome, chains: of the run; None where the frames do not fit."""

    found: dict[str, Any]
    outcome: Outcome | None = None
    timeline: Timeline | None = None
    chains: tuple[Chain, ...] = ()


def study(
    scenario: Scenario, data_bit_ns: int, errors: Errors | None = None, progress: Progress = no_progress
) -> Study:
    """Bound and measure a scenario; data_bit_ns: of CAN FD, to be put beside. Raises ScenarioError."""
    if scenario.bus.fidelity == "functional":
        raise ScenarioError("bus.fidelity = 'functional': frames take no time, there is nothing to measure: set 'bits'")
    cycle, rates = cycle_of(scenario), Rates(scenario.bit_ns)
    late, worst = _bounded(cycle, rates, errors)
    found = {
        "scenario": scenario.name,
        "bitrate": rates.bitrate,
        "period_s": scenario.clock.period_s,
        "utilisation": _utilisation(cycle, rates),
        "meets_deadlines": late is None,
        "late": late,
        "lowest_bitrate": lowest_bitrate(cycle, errors=errors),
        "by_joints": by_joints(cycle, data_bit_ns),
        "data_bitrate": NS_A_SECOND / data_bit_ns,
    }
    flexible = _bounded(cycle, Rates(rates.bit_ns, data_bit_ns), errors)[1]
    if worst is None:
        return Study(found | {"messages": _rows(scenario, None, None, flexible, {}), "chains": []})
    outcome, timeline = run_with_timeline(scenario, progress)
    codec = load_arm()
    seen = responses(timeline, scenario, codec)
    actual = _bounded(cycle, rates, errors, _actual_spans(cycle, rates, seen))[1]
    links = tuple(chains_of(_run(scenario, timeline, by_cycle(timeline, scenario, codec)), worst))
    found |= {
        "messages": _rows(scenario, worst, actual, flexible, seen),
        "chains": [to_json(chain) for chain in links],
    }
    return Study(found, outcome, timeline, links)


def _run(scenario: Scenario, timeline: Timeline, instants: dict[str, Array]) -> Run:
    nodes = scenario.node_names
    woken = {name: np.array(timeline.woken(name, scenario.period_ns, scenario.cycles)) for name in nodes}
    return Run(scenario, instants, woken)


def _bounded(
    cycle: Cycle, rates: Rates, errors: Errors | None, spans: Spans | None = None
) -> tuple[str | None, dict[str, Bound] | None]:
    """Return (None, bounds), or the frame that may not end with its cycle and no bounds."""
    try:
        return None, cycle.bounds(rates, spans, errors)
    except Late as late:
        return str(late), None


def _actual_spans(cycle: Cycle, rates: Rates, seen: dict[str, dict[str, Any]]) -> Spans:
    """Return the shortest and longest frame of each slot that a run has shown."""
    spans = dict(worst_spans(cycle.joints, rates))
    for slot in spans:
        names = [name for name in seen if (name.startswith(SLOW) if slot == STATUS else name == slot)]
        shown = [seen[name]["spans_ns"] for name in names]
        if shown:
            spans[slot] = min(shortest for shortest, _ in shown), max(longest for _, longest in shown)
    return spans


def _utilisation(cycle: Cycle, rates: Rates) -> float:
    """Return the share of time that the longest frames of a cycle take."""
    rest_ns = INTERMISSION_BITS * rates.bit_ns
    spans = worst_spans(cycle.joints, rates).values()
    return sum(longest_ns + rest_ns for _, longest_ns in spans) / cycle.period_ns


def _rows(
    scenario: Scenario,
    worst: dict[str, Bound] | None,
    actual: dict[str, Bound] | None,
    flexible: dict[str, Bound] | None,
    seen: dict[str, dict[str, Any]],
) -> list[dict[str, Any]]:
    """Return a row for each message of the run, by identifier; those of set-up and Stop have none."""
    slots = cycle_frames(scenario.joints)
    rows = []
    for message in describe_arm(scenario.joints):
        slot = STATUS if message.name.startswith(SLOW) else message.name
        if slot in slots:
            bounds = [None if each is None else each[slot] for each in (worst, actual, flexible)]
            rows.append(_row(scenario, message.name, message.identifier, slots[slot], bounds, seen.get(message.name)))
    return rows


def _row(
    scenario: Scenario,
    name: str,
    identifier: int,
    length: int,
    bounds: list[Bound | None],
    seen: dict[str, Any] | None,
) -> dict[str, Any]:
    """Return one message's row. bounds: with the longest frames, with those of the run, as CAN FD."""
    worst = bounds[0]
    turns = 2 * (scenario.joints + 2) if name.startswith(SLOW) else 1
    deadline_ns = None if worst is None else scenario.period_ns - worst.latest_ns
    response = None if seen is None else seen["response"]
    largest_s = None if response is None else response["max_s"]
    bound_s, actual_s, flexible_s = (None if each is None else seconds(each.response_ns) for each in bounds)
    return {
        "name": name,
        "identifier": identifier,
        "period_s": turns * scenario.clock.period_s,
        "queued_s": None if worst is None else [seconds(worst.earliest_ns), seconds(worst.latest_ns)],
        "deadline_s": seconds(deadline_ns),
        "bits_worst": worst_case_bits(length) + INTERMISSION_BITS,
        "bits_max": None if seen is None else seen["spans_ns"][1] // scenario.bit_ns + INTERMISSION_BITS,
        "response_bound_s": bound_s,
        "response_bound_actual_s": actual_s,
        "response_bound_fd_s": flexible_s,
        "response_max_s": largest_s,
        "max_to_bound": _ratio(largest_s, bound_s),
        "max_to_bound_actual": _ratio(largest_s, actual_s),
        "response": response,
        "meets_deadline": worst is not None and deadline_ns is not None and worst.response_ns <= deadline_ns,
    }


def _ratio(measured_s: float | None, bound_s: float | None) -> float | None:
    return None if measured_s is None or bound_s is None else measured_s / bound_s
