"""Two ways to compute the same arm, in the same closed loop: how far apart the Encoder frames are, and the angles.

As long as all Encoder frames are equal, all currents are, and the angles show what lies between the backends. Where a
count's edge falls between two angles, one frame differs, and from there on each loop answers counts of its own: that
multiplies any difference, wherever it comes from. How much, a control says: the closed form against itself with 1 mg
on the hand.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dbc.compiler import load_arm
from hil.errors import FaultError
from hil.evaluate import frames_of_cycles, recorded_truth
from hil.rig import Outcome, run_inline
from hil.scenario import Load, Scenario

CONTROL_KG = 1e-6

Array = npt.NDArray[np.float64]


class Place(NamedTuple):
    """A difference, the cycle in which it is, and the joint (from 1)."""

    size: float
    cycle: int
    joint: int


@dataclass(frozen=True)
class Difference:
    """Two runs, from cycle 0 on, as far as both got; a missing frame is no difference.

    counts: the largest of the Encoder counts. angle: the largest of the true angles, rad. first: the first frame that
    differs, and beyond: by more than one count; None if none does. angle_before: the largest, rad, up to `first`.
    """

    cycles: int
    counts: Place
    angle: Place
    first: Place | None
    beyond: Place | None
    angle_before: Place


@dataclass(frozen=True)
class BackendComparison:
    """A scenario on both backends, and its control."""

    scenario: Scenario
    backends: Difference
    control: Difference

    def __str__(self) -> str:
        found, name = self.backends, self.scenario.name
        if found.first is None:
            return f"{name}: {found.cycles} cycles, all Encoder frames equal, angles within {found.angle.size:.1e} rad"
        text = (
            f"{name}: angles within {found.angle_before.size:.1e} rad up to cycle {found.first.cycle}, where the first "
            f"Encoder frame differs (joint {found.first.joint}); in {found.cycles} cycles by at most "
            f"{found.counts.size:.0f} counts and {found.angle.size:.1e} rad"
        )
        if found.beyond is None:
            return text
        return (
            f"{text}, by more than 1 from cycle {found.beyond.cycle} on (joint {found.beyond.joint}): from its first "
            "other count on each loop answers its own; the closed form against itself with 1 mg on the hand differs by "
            f"{self.control.counts.size:.0f} counts and {self.control.angle.size:.1e} rad"
        )


def compare_backends(scenario: Scenario) -> BackendComparison:
    """Run a scenario on both backends, inline; ScenarioError if pymunk cannot carry its arm."""
    pymunk = run_inline(_on(scenario, "pymunk"), compiled=False)
    closed = run_inline(_on(scenario, "closed"), compiled=False)
    hand = Load(mass_kg=CONTROL_KG, at_s=0.0, until_s=scenario.duration_s)
    loaded = _on(scenario, "closed").model_copy(update={"load": (*scenario.load, hand)})
    control = difference(closed, run_inline(loaded, compiled=False))
    return BackendComparison(scenario, difference(closed, pymunk), control)


def difference(one: Outcome, other: Outcome) -> Difference:
    """Return how far apart two runs of the same cycles and joints are."""
    q, q_other = (recorded_truth(each)["q_rad"] for each in (one, other))
    cycles = min(len(q), len(q_other))
    if cycles == 0:
        raise FaultError(f"{one.scenario.name}: a run ended in its set-up, nothing is there to compare: run it alone")
    angles = abs(q[:cycles] - q_other[:cycles])
    counts = abs(_wrapped(_encoder_counts(one) - _encoder_counts(other)))[:cycles]
    first = _first(counts, counts > 0)
    return Difference(
        cycles=cycles,
        counts=_largest(counts),
        angle=_largest(angles),
        first=first,
        beyond=_first(counts, counts > 1),
        angle_before=_largest(angles if first is None else angles[: first.cycle + 1]),
    )


def _on(scenario: Scenario, backend: str) -> Scenario:
    return scenario.model_copy(update={"plant": scenario.plant.model_copy(update={"backend": backend})})


def _encoder_counts(outcome: Outcome) -> Array:
    """Return the position counters of the Encoder frames, (cycles, joints), from the frame log; NaN if missing."""
    scenario, codec = outcome.scenario, load_arm()
    counts = np.full((scenario.cycles, scenario.joints), np.nan)
    encoders = {codec[f"Encoder_{n}"].identifier: n - 1 for n in range(1, scenario.joints + 1)}
    for cycle, _, identifier, (position, _) in frames_of_cycles(outcome, codec, encoders):
        counts[cycle, encoders[identifier]] = position
    return counts


def _wrapped(difference: Array) -> Array:
    """Return the difference of two 16-bit counters that wrap, 0 where a frame is missing."""
    return np.nan_to_num((difference + 0x8000) % 0x10000 - 0x8000, nan=0.0)


def _largest(differences: Array) -> Place:
    return _place(differences, int(np.argmax(differences)))


def _first(differences: Array, chosen: npt.NDArray[np.bool_]) -> Place | None:
    return _place(differences, int(np.argmax(chosen))) if chosen.any() else None


def _place(differences: Array, at: int) -> Place:
    cycle, index = divmod(at, differences.shape[1])
    return Place(float(differences[cycle, index]), cycle, index + 1)
