"""How much delay a scenario's loop bears, and how much g and Jn at each delay: all limits of it, and as JSON."""

from collections.abc import Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import Any

from hil.rig import Progress, no_progress
from hil.scenario import Scenario
from hil.timing.limits import (
    CEILING_PERIODS,
    DelayMargin,
    Raised,
    delay_margin,
    examine,
    largest_g,
    largest_inertia,
)
from hil.timing.search import Largest

JITTERS = (0.1, 0.2)
"""Widths of the jitter, in periods: 100 and 200 us of 1 ms."""
EXTRAS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Dead times at which g and Jn are raised, in periods."""


@dataclass(frozen=True)
class Margins:
    """All of it. fails: why the scenario fails as it is, "" if it does not; then there is nothing else."""

    scenario: Scenario
    fails: str = ""
    without_theory: str = ""
    delay_margins: Sequence[DelayMargin] = ()
    with_jitter: Sequence[DelayMargin] = ()
    largest_g: Sequence[Raised] = ()
    largest_inertia: Sequence[Raised] = ()


def margins(scenario: Scenario, executor: Executor, progress: Progress = no_progress) -> Margins:
    """Measure and predict everything, each limit as a task of its own; progress: told the share done."""
    rig = executor.submit(examine, scenario).result()
    if isinstance(rig, str):
        return Margins(scenario, fails=rig)
    joints, period_s = range(1, scenario.joints + 1), scenario.clock.period_s
    jitters = [] if any(scenario.drive.dead_time_jitter_s) else [share * period_s for share in JITTERS]
    extras = [share * period_s for share in EXTRAS] if scenario.joint.observer else []
    tasks: dict[str, list[Future[Any]]] = {
        "delay_margins": [executor.submit(delay_margin, rig, joint) for joint in joints],
        "with_jitter": [executor.submit(delay_margin, rig, joint, width) for width in jitters for joint in joints],
        "largest_g": [executor.submit(largest_g, rig, extra_s) for extra_s in extras],
        "largest_inertia": [executor.submit(largest_inertia, rig, extra_s) for extra_s in extras],
    }
    return Margins(scenario, "", rig.without_theory, **_gathered(tasks, progress))


def _gathered(tasks: dict[str, list[Future[Any]]], progress: Progress) -> dict[str, list[Any]]:
    total = sum(map(len, tasks.values()))
    found: dict[str, list[Any]] = {name: [] for name in tasks}
    for done, (name, task) in enumerate([(name, task) for name, part in tasks.items() for task in part]):
        progress(done / total)
        found[name].append(task.result())
    progress(1.0)
    return found


# -- as JSON --


def to_json(found: Margins) -> dict[str, Any]:
    """Return the figures ready for JSON, in s and rad/s.

    None: not even the least value holds, or there is no theory. `.._beyond`: the figure is the largest that was tried.
    """
    return {
        "scenario": found.scenario.name,
        "fails": found.fails or None,
        "without_theory": found.without_theory or None,
        "ceiling_s": CEILING_PERIODS * found.scenario.clock.period_s,
        "delay_margins": [{"joint": each.joint, **_pair(each, "s")} for each in found.delay_margins],
        "with_jitter": [_with_jitter(each) for each in found.with_jitter],
        "largest_g": [_raised(each, "rad_s") for each in found.largest_g],
        "largest_inertia": [_raised(each, "factor") for each in found.largest_inertia],
    }


def _with_jitter(found: DelayMargin) -> dict[str, Any]:
    row = {"joint": found.joint, "jitter_s": found.jitter_s, **_pair(found, "s")}
    return row | {"by_largest_delay_s": None if found.by_largest is None else found.by_largest.value}


def _raised(found: Raised, unit: str) -> dict[str, Any]:
    return {"extra_delay_s": found.extra_s, "latency_s": found.latency_s, **_pair(found, unit)}


def _pair(found: DelayMargin | Raised, unit: str) -> dict[str, Any]:
    measured, predicted = found.measured, found.predicted or Largest(None)
    return {
        f"measured_{unit}": measured.value,
        f"predicted_{unit}": predicted.value,
        "ratio": ratio(found),
        "measured_beyond": measured.beyond,
        "predicted_beyond": predicted.beyond,
    }


def ratio(found: DelayMargin | Raised) -> float | None:
    """Return measured over predicted, where both are known."""
    measured, predicted = found.measured, found.predicted
    if predicted is None or not predicted.value or measured.value is None or measured.beyond or predicted.beyond:
        return None
    return measured.value / predicted.value
