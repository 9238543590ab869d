"""What a run under the rule `functional` leaves for a study: whole counts of every cycle, and the true angles.

The inline run is the reference; whatever else runs a scenario under this rule gives the same integers and bits.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dbc.compiler import load_arm
from firmware_py.dsp.cpu import ACCEL_REFS, JOINTS_A_FRAME
from firmware_py.joint_cpu import SIGNALS
from hil.evaluate import frames_of_cycles, recorded_truth
from hil.rig import Outcome, run_inline
from hil.scenario import Scenario
from hil.summary import faults

Counts = npt.NDArray[np.int64]
Truth = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FunctionalRun:
    """One row a cycle from 0 on, one column a joint.

    q: true angles at kT, rad; a_ref, current, estimate: counts as the frames of cycle k say them; saturations: of each
    joint's signals (in the order of firmware_py.joint_cpu.SIGNALS); reference_saturations: of the DSP's references;
    amplifier_saturations: of current references. stopped: why the run ended early, empty if it came to its end; the
    rows end there.
    """

    q: Truth
    a_ref: Counts
    current: Counts
    estimate: Counts
    saturations: Counts
    reference_saturations: Counts
    amplifier_saturations: Counts
    stopped: str = ""


def functional(scenario: Scenario) -> Scenario:
    """Return the same scenario under the rule `functional`."""
    return scenario.model_copy(update={"bus": scenario.bus.model_copy(update={"fidelity": "functional"})})


def inline(scenario: Scenario) -> FunctionalRun:
    """Run a scenario inline under the rule `functional`."""
    return of(run_inline(functional(scenario), compiled=False))


def of(outcome: Outcome) -> FunctionalRun:
    """Return what a run left."""
    scenario = outcome.scenario
    reports, joints = outcome.reports, range(1, scenario.joints + 1)
    stopped = faults(outcome)
    return FunctionalRun(
        q=recorded_truth(outcome)["q_rad"],
        **_from_bus(outcome),
        saturations=_columns([reports[f"joint{n}"]["saturations"] for n in joints], SIGNALS),
        reference_saturations=np.array(list(reports["dsp"]["saturations"].values()), dtype=np.int64),
        amplifier_saturations=np.array(list(reports["plant"]["saturations"].values()), dtype=np.int64),
        stopped=f"{stopped[0]['node']}: {stopped[0]['cause']}" if stopped else "",
    )


def _columns(rows: list[dict[str, int]], names: tuple[str, ...]) -> Counts:
    return np.array([[row.get(name, 0) for name in names] for row in rows], dtype=np.int64)


def _from_bus(outcome: Outcome) -> dict[str, Any]:
    """Return what AccelRef and Current frames of every cycle say; 0 where one is missing."""
    codec, joints = load_arm(), outcome.scenario.joints
    cycles = min(len(outcome.reports["plant"]["rows"]), outcome.scenario.cycles)  # a row more, of Stop's instant
    found = {name: np.zeros((cycles, joints), dtype=np.int64) for name in ("a_ref", "current", "estimate")}
    current = {codec[f"Current_{n}"].identifier: n - 1 for n in range(1, joints + 1)}
    references = {codec[name].identifier: m * JOINTS_A_FRAME for m, name in enumerate(ACCEL_REFS)}
    frames = [*frames_of_cycles(outcome, codec, {*references, *current})]
    for cycle, _, identifier, fields in reversed(frames):  # the first of a cycle counts: Stop is answered by a second
        if cycle >= cycles:
            continue
        if identifier in references:
            first = references[identifier]
            last = min(joints, first + JOINTS_A_FRAME)
            found["a_ref"][cycle, first:last] = fields[: last - first]
        else:
            joint = current[identifier]
            found["current"][cycle, joint], found["estimate"][cycle, joint] = fields[:2]
    return found
