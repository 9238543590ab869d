"""A point becomes a row: the run, and what it was worth.

Deviation is the analytic command minus the true angle at kT; at rest means the last 100 ms.
"""

from typing import Any

import numpy as np

from dbc.compiler import load_arm
from hil.engine import functional_run
from hil.engine.fast import quickest
from hil.engine.functional_run import FunctionalRun
from hil.errors import HilError, ScenarioError
from hil.evaluate import commands, final_rows, tip
from hil.rig import run_inline
from hil.scenario import Scenario
from hil.sweep.columns import KB_FRACTION, OF_A_JOINT, OK, REFUSED, SATURATED, STOPPED, TIP, TOTAL_BITS
from hil.sweep.paths import Base
from hil.sweep.sampling import Point
from hil.word_format import WordFormat


def rows(base: Base, chunk: list[Point]) -> list[dict[str, Any]]:
    """Return the rows of some points, in order: what a worker does."""
    return [{"sweep": point.sweep, "index": point.index, **row(base, point.values)} for point in chunk]


def row(base: Base, values: dict[str, Any]) -> dict[str, Any]:
    """Return status, reason and figures of one point; what is refused or fails has no figures."""
    try:
        scenario = base.scenario(values)
        found = run(scenario)
    except ScenarioError as error:
        return {"status": REFUSED, "reason": str(error)}
    except HilError as error:
        return {"status": STOPPED, "reason": _cause(error)}
    return {"status": STOPPED if found.stopped else OK, "reason": found.stopped, **figures(scenario, found)}


def run(scenario: Scenario) -> FunctionalRun:
    """Run a scenario: under the rule `functional`, or with every bit where the sweep asks for it."""
    if scenario.bus.fidelity == "bits":
        return functional_run.of(run_inline(scenario, compiled=False))
    return quickest(scenario)[0]


def _cause(error: HilError) -> str:
    """Return what failed, without the place in our source: it is the same wherever it runs."""
    return str(error) if error.__cause__ is None else f"{type(error.__cause__).__name__}: {error.__cause__}"


def figures(scenario: Scenario, found: FunctionalRun) -> dict[str, Any]:
    """Return what a run was worth: the figures that have a value."""
    counted = {name: int(count) for name, count in zip(SATURATED, found.saturations.sum(axis=0), strict=True)}
    counted["saturations_references"] = int(found.reference_saturations.sum())
    counted["saturations_amplifiers"] = int(found.amplifier_saturations.sum())
    form = WordFormat.of(scenario, load_arm())
    counted |= {TOTAL_BITS: form.total_bits, KB_FRACTION: form.kb_fraction}
    return counted | (_deviations(scenario, found) if len(found.q) else {})


def _deviations(scenario: Scenario, found: FunctionalRun) -> dict[str, float]:
    rest = final_rows(scenario)
    q_cmd, _, x_cmd, _ = commands(scenario, len(found.q))
    deviation = q_cmd - found.q
    noise = np.std(found.current[rest], axis=0) * load_arm().scale("Current_1", "Reference")
    by_joint = zip(
        np.max(np.abs(deviation), axis=0),
        np.sqrt(np.mean(deviation[rest] ** 2, axis=0)),
        np.ptp(deviation[rest], axis=0),
        noise,
        strict=True,
    )
    per_joint = {
        f"{name}_{n}": float(value)
        for n, each in enumerate(by_joint, 1)
        for name, value in zip(OF_A_JOINT, each, strict=True)
    }
    off = x_cmd - tip(scenario, found.q)
    return per_joint | {TIP: float(np.max(np.hypot(off[:, 0], off[:, 1])))}
