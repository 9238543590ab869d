"""One experiment from the command to the folder: the run, its counterpart, what they say."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.evaluate import Evaluation, evaluate
from hil.record import run_folder, write_run
from hil.rig import Outcome, run_inline
from hil.scenario import Model, Scenario
from hil.summary import deviations, summarise, world


@dataclass(frozen=True)
class Result:
    """A run, its evaluation (None if it never reached cycle 0), its summary, and its counterpart's evaluation.

    The counterpart is the same scenario with the observer switched the other way, run inline; None after a fault. That
    of computed torque is the observer, at the same gains.
    """

    outcome: Outcome
    evaluation: Evaluation | None
    summary: dict[str, Any]
    counterpart: Evaluation | None

    @property
    def observer_on_off(self) -> tuple[Evaluation, Evaluation] | None:
        """Both evaluations, the one with the observer first."""
        if self.evaluation is None or self.counterpart is None:
            return None
        both = self.evaluation, self.counterpart
        return both if self.outcome.scenario.joint.observer else both[::-1]


def examine(outcome: Outcome, startup_s: float) -> Result:
    """Evaluate a run, and run its counterpart."""
    evaluation = evaluate(outcome)
    summary = summarise(outcome, evaluation, startup_s)
    counterpart = None
    if evaluation is not None and not summary["faults"]:
        # not compiled: in the rig's process Numba would cost more than it saves
        counterpart = evaluate(run_inline(switched(outcome.scenario), compiled=False))
    if counterpart is not None:
        other = counterpart.scenario
        figures = {**deviations(counterpart), **world(counterpart)}
        summary["counterpart"] = {"observer": other.joint.observer, "law": other.dsp.law, **figures}
    return Result(outcome, evaluation, summary, counterpart)


def switched(scenario: Scenario) -> Scenario:
    """Return the scenario with the observer the other way, and with the law that suits an observer."""
    joint = scenario.joint.model_copy(update={"observer": not scenario.joint.observer})
    dsp = scenario.dsp.model_copy(update={"law": "acceleration"})
    return scenario.model_copy(update={"joint": joint, "dsp": dsp, "model": Model()})


def write(result: Result, path: Path) -> None:
    """Write the run folder, whole or not at all; raise OutputError or MissingExtraError."""
    with run_folder(path) as folder:
        write_run(folder, result.outcome, result.evaluation, result.summary)
        if result.observer_on_off is not None:
            from hil.figures import write_figures

            write_figures(folder, *result.observer_on_off)
        if "real_time" in result.summary:
            from hil.wall_figure import write_latency

            write_latency(folder, result.summary)
