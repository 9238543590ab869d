"""The disturbance observer and computed torque on the same arm at equal gains: what each makes of wrong parameters.

Every rival runs the same scenario inline. What is wrong is wrong in what the controller believes, or put on the hand
without its knowledge; the arm stays the same.

Ref: the paper's table 1, eqs. (4), (9), fig. 15.
"""

from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

from hil import scenario_file
from hil.evaluate import evaluate
from hil.rig import run_inline
from hil.scenario import Scenario
from hil.summary import deviations, summarise

PAYLOAD_KG = 2.0
WRONG = {"- 20 %": 0.8, "+ 20 %": 1.2}
UNKNOWN = f"{PAYLOAD_KG:g} kg unknown"
SAME_ERROR = [*((f"Jn {error}", f"model {error}") for error in WRONG), (UNKNOWN, UNKNOWN)]
"""What names the same error of the observer and of computed torque."""


@dataclass(frozen=True)
class Rival:
    """A controller, and what is put on the hand for the whole run; settings as on the command line."""

    name: str
    settings: tuple[str, ...]
    payload_kg: float = 0.0

    def scenario(self, scenario: Scenario) -> Scenario:
        """Return the scenario with this controller; raise ScenarioError where it does not fit."""
        values: dict[str, Any] = scenario.model_dump(mode="json", exclude_none=True)
        if self.payload_kg:
            values["load"].append({"mass_kg": self.payload_kg, "at_s": 0.0, "until_s": scenario.duration_s})
        return scenario_file.build(values, self.settings)


@dataclass(frozen=True)
class Row:
    """What a rival was worth, one entry a joint; final is the rms of the last 100 ms. fault: why it ended early."""

    name: str
    largest_rad: tuple[float, ...]
    final_rad: tuple[float, ...]
    saturations: int
    fault: str


def rivals(scenario: Scenario) -> Iterator[Rival]:
    """Yield every rival, the observer first; on the scenario's arm each with and without a payload on the hand."""
    observer = _observer(True)
    yield Rival("observer", observer)
    for error, factor in WRONG.items():
        wrong = [factor * Jn for Jn in scenario.joint.inertia_kg_m2]
        yield Rival(f"observer, Jn {error}", (*observer, f"joint.inertia_kg_m2={wrong}"))
    yield Rival(f"observer, {UNKNOWN}", observer, PAYLOAD_KG)
    yield Rival("computed torque, exact", _computed_torque())
    for error, factor in WRONG.items():
        yield Rival(f"computed torque, model {error}", _computed_torque(factor))
    yield Rival(f"computed torque, {UNKNOWN}", _computed_torque(), PAYLOAD_KG)
    yield Rival(f"computed torque, {PAYLOAD_KG:g} kg known", _computed_torque(payload_kg=PAYLOAD_KG), PAYLOAD_KG)
    yield Rival("neither", _observer(False))
    yield Rival(f"neither, {UNKNOWN}", _observer(False), PAYLOAD_KG)


def _observer(on: bool) -> tuple[str, ...]:
    return (*_model(1.0, 0.0), "dsp.law=acceleration", f"joint.observer={'true' if on else 'false'}")


def _computed_torque(scale: float = 1.0, payload_kg: float = 0.0) -> tuple[str, ...]:
    return (*_model(scale, payload_kg), "dsp.law=computed-torque", "joint.observer=false")


def _model(scale: float, payload_kg: float) -> tuple[str, ...]:
    return f"model.scale={scale}", f"model.payload_kg={payload_kg}"


def compare_rivals(scenario: Scenario, executor: Executor) -> tuple[Row, ...]:
    """Run every rival, each a call of the executor's, and return their rows in order."""
    chosen = list(rivals(scenario))
    return tuple(executor.map(run, [rival.name for rival in chosen], [rival.scenario(scenario) for rival in chosen]))


def run(name: str, scenario: Scenario) -> Row:
    """Run one rival."""
    outcome = run_inline(scenario, compiled=False)
    evaluation = evaluate(outcome)
    summary = summarise(outcome, evaluation, 0.0)
    found: dict[str, Any] = {} if evaluation is None else deviations(evaluation)
    return Row(
        name,
        tuple(found.get("max_deviation_rad", ())),
        tuple(found.get("final_deviation_rad", ())),
        summary["saturations"],
        "; ".join(fault["cause"] for fault in summary["faults"]),
    )
