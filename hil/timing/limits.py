"""The limits of a scenario's loop: how much delay it bears, and how much g and Jn, as the rig runs and in theory.

A delay is a dead time of the amplifiers (`drive.dead_time_s`) on top of what bus, nodes and scenario have. Each
quantity is raised until the loop fails (hil/paper/stability.py), and taken to fail with all that is beyond.
The theory is linear: poles of the sampled loop at the poses of the command, with the mean delays of the scenario's own
run; friction, gravity, rounding, limits and contact are not in it. Units: s, rad/s; joints from 1.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dbc.compiler import load_arm
from hil.constants import constants_fit
from hil.evaluate import evaluate
from hil.paper.frequency_response import mean_delays
from hil.paper.sampled_loop import Array
from hil.paper.stability import FAILED_RAD, failed, inertias_along, why_failed, worst_radius
from hil.rig import run_inline
from hil.scenario import Scenario
from hil.scenario_joint import I8086, PYTHON
from hil.timing.search import Largest, largest

CEILING_PERIODS = 3
"""The longest dead time that is tried."""
LEAST_SHARE, MOST_FACTOR = 0.02, 4.0
"""From which share of its largest g is tried, and from which factor and up to which Jn is."""
COARSE, FINE = 256, 16_384
"""Steps in which a limit is sought: of 12 us of delay at 1 ms, 4 rad/s of g, 0.016 of Jn; theory costs less."""
DEVIATES = 4.0
"""Times the deviation of the scenario as it is, at which a loop counts as failed, but no less than FAILED_RAD."""

At = Callable[[float], tuple[Scenario, Array]]
"""From a quantity's value to the scenario that has it and the delay of every joint that theory is asked for."""


@dataclass(frozen=True)
class Rig:
    """A scenario that runs well as it is.

    delay_s: of each joint, from the sample to the current's action, on the mean. inertias: along the command (K, n, n).
    without_theory: why there is none, "" where there is.
    """

    scenario: Scenario
    delay_s: Array
    bound_rad: float
    inertias: Array
    without_theory: str


@dataclass(frozen=True)
class DelayMargin:
    """The dead time that one joint bears.

    With jitter, the part below it; predicted is then that of the mean delay, by_largest that of the largest.
    """

    joint: int
    jitter_s: float
    measured: Largest
    predicted: Largest | None
    by_largest: Largest | None


@dataclass(frozen=True)
class Raised:
    """The largest g or factor of every Jn with so much dead time more on all joints; latency_s: mean of all joints."""

    extra_s: float
    latency_s: float
    measured: Largest
    predicted: Largest | None


# -- the scenario as it is --


def examine(scenario: Scenario) -> Rig | str:
    """Run the scenario as it is; return what the limits need, or why it fails already."""
    outcome = run_inline(scenario)
    evaluation = evaluate(outcome)
    if evaluation is None:
        return "it ended before cycle 0"
    if reason := why_failed(outcome, evaluation):
        return reason
    largest_rad = float(np.max(np.abs(evaluation.deviation)))
    bound_rad = max(FAILED_RAD, DEVIATES * largest_rad)
    return Rig(scenario, mean_delays(outcome), bound_rad, inertias_along(scenario), _without_theory(scenario))


def _without_theory(scenario: Scenario) -> str:
    """Return why the sampled loop's theory does not describe a scenario; "" where it does."""
    if scenario.dsp.law != "acceleration":
        return f"dsp.law = {scenario.dsp.law!r}: the theory is that of the acceleration law"
    if not scenario.joint.observer:
        return "joint.observer = false: the theory is that of the observer"
    own = [n for n in range(1, scenario.joints + 1) if scenario.cpu(n) not in (PYTHON, I8086)]
    if own:
        return f"joint{own[0]}.cpu = {scenario.cpu(own[0])!r}: the theory knows the paper's law only"
    if scenario.drive.lag_s:
        return f"drive.lag_s = {scenario.drive.lag_s}: the theory knows amplifiers without lag"
    return ""


# -- limits, each to be run in a process of its own --


def delay_margin(rig: Rig, joint: int, jitter_s: float = 0.0) -> DelayMargin:
    """Raise the dead time of one joint (from 1), the others as they are; jitter_s: the width of its jitter."""
    ceiling_s = CEILING_PERIODS * rig.scenario.clock.period_s

    def at(share_of_jitter: float) -> At:
        def found(extra_s: float) -> tuple[Scenario, Array]:
            alone = np.arange(1, rig.scenario.joints + 1) == joint
            delay_s = rig.delay_s + alone * (extra_s + share_of_jitter * jitter_s)
            return delayed(rig.scenario, alone * extra_s, alone * jitter_s), delay_s

        return found

    measured, by_mean = _sought(rig, at(0.5), 0.0, 0.0, ceiling_s)
    by_largest = _predicted(rig, at(1.0), 0.0, 0.0, ceiling_s) if jitter_s else by_mean
    return DelayMargin(joint, jitter_s, measured, by_mean, by_largest)


def largest_g(rig: Rig, extra_s: float) -> Raised:
    """Raise g with so much dead time more on all joints, as far as the joints' integers allow."""
    slow, delay_s = _slower(rig, extra_s)

    def at(g: float) -> tuple[Scenario, Array]:
        return _with_joint(slow, g_rad_s=g), delay_s

    own = slow.joint.g_rad_s
    most = _fitting(at, own, 1.0 / slow.clock.period_s)
    return _raised(rig, extra_s, at, min(own, LEAST_SHARE * most), own, most)


def largest_inertia(rig: Rig, extra_s: float) -> Raised:
    """Raise the factor on every Jn with so much dead time more on all joints, as far as the joints' integers allow."""
    slow, delay_s = _slower(rig, extra_s)

    def at(factor: float) -> tuple[Scenario, Array]:
        return _with_joint(slow, inertia_kg_m2=tuple(factor * Jn for Jn in slow.joint.inertia_kg_m2)), delay_s

    return _raised(rig, extra_s, at, _fitting(at, 1.0, LEAST_SHARE), 1.0, _fitting(at, 1.0, MOST_FACTOR))


def _slower(rig: Rig, extra_s: float) -> tuple[Scenario, Array]:
    none = np.zeros(rig.scenario.joints)
    return delayed(rig.scenario, none + extra_s, none), rig.delay_s + extra_s


def _fitting(at: At, fits: float, end: float) -> float:
    """Return the value nearest to the end whose parameters fit the joints' integers, from one on whose do."""
    codec = load_arm()
    share = largest(lambda share: constants_fit(at(fits + share * (end - fits))[0], codec), 0.0, 1.0, FINE, 1.0).value
    return fits + (share or 0.0) * (end - fits)


def _raised(rig: Rig, extra_s: float, at: At, low: float, own: float, high: float) -> Raised:
    latency_s = float(np.mean(rig.delay_s)) + extra_s
    return Raised(extra_s, latency_s, *_sought(rig, at, low, own, high))


def _sought(rig: Rig, at: At, low: float, own: float, high: float) -> tuple[Largest, Largest | None]:
    """Return the limit as measured and as predicted; the prediction only says where to begin to measure."""
    predicted = _predicted(rig, at, low, own, high)
    begin = own if predicted is None or predicted.value is None else predicted.value
    return largest(lambda value: not failed(at(value)[0], rig.bound_rad), low, high, COARSE, begin), predicted


def _predicted(rig: Rig, at: At, low: float, own: float, high: float) -> Largest | None:
    def stable(value: float) -> bool:
        scenario, delay_s = at(value)
        return worst_radius(scenario, rig.inertias, delay_s) < 1.0

    return None if rig.without_theory else largest(stable, low, high, FINE, own)


# -- the same scenario with other values --


def delayed(scenario: Scenario, extra_s: Array, jitter_s: Array) -> Scenario:
    """Return the scenario with so much more dead time and jitter on every joint."""
    drive = scenario.drive
    dead, jitter = (each or (0.0,) * scenario.joints for each in (drive.dead_time_s, drive.dead_time_jitter_s))
    values = {
        "dead_time_s": tuple(np.round(dead + extra_s, 9).tolist()),
        "dead_time_jitter_s": tuple(np.round(jitter + jitter_s, 9).tolist()),
    }
    return scenario.model_copy(update={"drive": drive.model_copy(update=values)})


def _with_joint(scenario: Scenario, **values: object) -> Scenario:
    return scenario.model_copy(update={"joint": scenario.joint.model_copy(update=values)})
