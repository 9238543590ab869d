"""Two ways to compute the same arm, in the same closed loop: how far apart the Encoder frames are, and the angles."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dbc.compiler import load_arm
from hil.rig import Outcome, run_inline
from hil.scenario import Scenario
from plant.motion import BACKENDS

Array = npt.NDArray[np.float64]


class Place(NamedTuple):
    """A difference, the cycle in which it is, and the joint (from 1)."""

    size: float
    cycle: int
    joint: int


@dataclass(frozen=True)
class BackendComparison:
    """A scenario on both backends, inline, from cycle 0 on.

    counts: the largest difference of Encoder counts. angle: that of the true angles, rad. beyond: the first difference
    of more than one count, None if there is none. A run that ends early is compared as far as both got.
    """

    scenario: Scenario
    cycles: int
    counts: Place
    angle: Place
    beyond: Place | None
    angle_before_rad: float
    """The largest difference of angles before `beyond`, or in all."""

    def __str__(self) -> str:
        text = (
            f"{self.scenario.name}, {self.cycles} cycles: Encoder frames differ by at most {self.counts.size:.0f} counts "
            f"(joint {self.counts.joint}, cycle {self.counts.cycle}), angles by {self.angle.size:.1e} rad"
        )
        if self.beyond is None:
            return text
        return (
            f"{text}; by more than 1 count first in cycle {self.beyond.cycle} at joint {self.beyond.joint}: "
            f"until then angles were within {self.angle_before_rad:.1e} rad, and one count that falls the other way "
            "changes currents by as much as one count is worth"
        )


def compare_backends(scenario: Scenario) -> BackendComparison:
    """Run a scenario on both backends; ScenarioError if pymunk cannot carry its arm."""
    outcomes = [run_inline(_on(scenario, backend), compiled=False) for backend in BACKENDS]
    closed, pymunk = (_angles(outcome) for outcome in outcomes)
    cycles = min(len(closed), len(pymunk), scenario.cycles)
    angles = abs(closed[:cycles] - pymunk[:cycles])
    closed, pymunk = (_encoder_counts(outcome) for outcome in outcomes)
    counts = abs(_wrapped(closed - pymunk))[:cycles]
    beyond = _first(counts > 1)
    before = angles if beyond is None else angles[: beyond[0] + 1]
    return BackendComparison(
        scenario=scenario,
        cycles=cycles,
        counts=_largest(counts),
        angle=_largest(angles),
        beyond=None if beyond is None else Place(float(counts[beyond]), beyond[0], beyond[1] + 1),
        angle_before_rad=float(before.max()),
    )


def _on(scenario: Scenario, backend: str) -> Scenario:
    return scenario.model_copy(update={"plant": scenario.plant.model_copy(update={"backend": backend})})


def _encoder_counts(outcome: Outcome) -> Array:
    """Return the position counters of the Encoder frames, (cycles, joints), from the frame log; NaN if missing."""
    scenario, codec = outcome.scenario, load_arm()
    counts = np.full((scenario.cycles, scenario.joints), np.nan)
    encoders = {codec[f"Encoder_{n}"].identifier: n - 1 for n in range(1, scenario.joints + 1)}
    for end_ns, identifier, data, _ in outcome.log.frames:
        fields = codec.by_identifier[identifier].unpack(data) if identifier in encoders else None
        if fields is not None:
            position, cycle_byte = fields
            period = end_ns // scenario.period_ns
            cycle = period - ((period - cycle_byte) & 0xFF)
            if 0 <= cycle < scenario.cycles:
                counts[cycle, encoders[identifier]] = position
    return counts


def _angles(outcome: Outcome) -> Array:
    report, joints = outcome.reports["plant"], outcome.scenario.joints
    rows = np.array(report["rows"], dtype=float).reshape(-1, len(report["columns"]))
    return rows[:, :joints]


def _wrapped(difference: Array) -> Array:
    """Return the difference of two 16-bit counters that wrap, 0 where a frame is missing."""
    return np.nan_to_num((difference + 0x8000) % 0x10000 - 0x8000, nan=0.0)


def _largest(differences: Array) -> Place:
    cycle, index = np.unravel_index(np.argmax(differences), differences.shape)
    return Place(float(differences[cycle, index]), int(cycle), int(index) + 1)


def _first(beyond: npt.NDArray[np.bool_]) -> tuple[int, int] | None:
    found = np.argwhere(beyond)
    return (int(found[0][0]), int(found[0][1])) if len(found) else None
