"""How much inertia error, payload and g the loop bears, measured on the rig beside the theory of the sampled loop."""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import product

from hil import scenario_file
from hil.paper.deviation import evaluated
from hil.paper.frequency_response import mean_delays
from hil.paper.sampled_loop import Array
from hil.paper.stability import failed, inertias_along, worst_radius
from hil.rig import run_inline
from hil.scenario import Scenario
from hil.summary import deviations

INERTIA_FACTORS = (0.5, 0.7, 0.85, 1.0, 1.15)
PAYLOADS_KG = (0.0, 1.0, 2.0)
TURNS = 8
"""Halvings of the interval in which a limit is sought."""


@dataclass(frozen=True)
class Tolerated:
    """One run: factor on every Jn, payload, and what it left: rad, one entry a joint."""

    factor: float
    payload_kg: float
    largest_rad: list[float]
    final_rad: list[float]


@dataclass(frozen=True)
class Limit:
    """Up to where a quantity can be raised: what, in the run, in theory."""

    what: str
    measured: float
    predicted: float


# -- a grid of errors --


def tolerated(executor: Executor) -> list[Tolerated]:
    """Run paper-joint with every inertia factor and payload."""
    return list(executor.map(_tolerate, *zip(*product(INERTIA_FACTORS, PAYLOADS_KG), strict=True)))


def _tolerate(factor: float, payload_kg: float) -> Tolerated:
    plain = scenario_file.load("paper-joint")
    load = f"load=[{{mass_kg={payload_kg}, at_s=0.0, until_s={plain.duration_s}}}]"
    settings = [_nominal(plain, (factor,) * plain.joints), *([load] if payload_kg else [])]
    found = deviations(evaluated("paper-joint", *settings))
    return Tolerated(factor, payload_kg, found["max_deviation_rad"], found["final_deviation_rad"])


def _nominal(scenario: Scenario, factors: tuple[float, ...]) -> str:
    values = [factor * Jn for factor, Jn in zip(factors, scenario.joint.inertia_kg_m2, strict=True)]
    return f"joint.inertia_kg_m2={values}"


# -- limits --


def limits(executor: Executor) -> list[Limit]:
    """Return the limits of Jn of each joint, as a factor, and of g, in rad/s, on paper-joint."""
    plain = scenario_file.load("paper-joint")
    delay_s = executor.submit(_delays, plain).result()
    quantities = [*range(plain.joints), None]
    return list(executor.map(_limit, quantities, [delay_s] * len(quantities)))


def _delays(scenario: Scenario) -> Array:
    return mean_delays(run_inline(scenario))


def _limit(joint: int | None, delay_s: Array) -> Limit:
    plain = scenario_file.load("paper-joint")
    inertias = inertias_along(plain)

    def at(value: float) -> Scenario:
        if joint is None:
            return scenario_file.load("paper-joint", [f"joint.g_rad_s={value}"])
        factors = tuple(value if n == joint else 1.0 for n in range(plain.joints))
        return scenario_file.load("paper-joint", [_nominal(plain, factors)])

    what, low, high = ("g, rad/s", 500.0, 999.0) if joint is None else (f"Jn of joint {joint + 1}, factor", 1.0, 2.5)
    measured = bisect(lambda value: not failed(at(value)), low, high)
    predicted = bisect(lambda value: worst_radius(at(value), inertias, delay_s) < 1.0, low, high)
    return Limit(what, measured, predicted)


def bisect(holds: Callable[[float], bool], low: float, high: float) -> float:
    """Return the largest value that holds, between low, which does, and high, to (high - low) / 2^TURNS."""
    for _ in range(TURNS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low
