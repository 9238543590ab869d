"""A scenario's arm at rest without friction: its limit cycles, and the dead band that a slow torque finds.

First it is left alone: what the true angle does then is the limit cycle (peak to peak, mean, spectrum). Then a torque
on every joint, slow beside the loop, goes down and up again. In the dead band d does not move for an error, so it
carries the joint from one edge to the other; measured is the range of all true angles in steady state: alone, pushed
down and pushed up.

Within the band a joint turns as if on a spring, g K1 Jn, since d adds up what K1 w asks for. The torque is twice what
that spring takes for the predicted width, some counts of current at least, and at most half of what the drive has:
where it would be more, what is measured is too small.

Units: rad, s, Hz, N m. Times are multiples of the position control's slowest: K1 / K2, or 1 / sqrt(K2).
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt

from dbc.codec import Codec
from dbc.compiler import load_arm
from hil.engine.fast import quickest
from hil.engine.functional_run import FunctionalRun
from hil.errors import ScenarioError
from hil.exact_constants import rad_per_count
from hil.quantise.dead_band import DeadBand, dead_band
from hil.scenario import QuinticMove, Scenario, Torque, Wire
from hil.word_format import WordFormat

Values = npt.NDArray[np.float64]
Runner = Callable[[Scenario], tuple[FunctionalRun, str]]
"""Runs a scenario under the rule `functional`; says why it was not fast, "" if it was."""

SETTLES, ALONE, PUSHED = (10, 20, 40, 80, 160), 22, 44
"""Time constants: until a run counts, as it needs; left alone; one period of the torque."""
STEADY = 1 / 12, 1 / 4
"""Shares of the torque's period behind its zero between which the joint has come to the edge: from half its peak on."""
PUSH_OF_SPRING, PUSH_COUNTS, PUSH_OF_LIMIT = 2.0, 4, 0.5
LONGEST_S = 600.0
LINES = 8


@dataclass(frozen=True)
class Timed:
    """When what happens, in cycles: the torque's beginning and period, and the rows that count."""

    pushed: int
    period: int
    alone: slice
    down: slice
    up: slice

    @property
    def cycles(self) -> int:
        """Of the whole run."""
        return int(self.up.stop)

    @classmethod
    def of(cls, scenario: Scenario, settles: int) -> "Timed":
        """Return it for a scenario; raise ScenarioError where rest would take too long. settles: time constants."""
        k1, k2, period_s = scenario.dsp.k1_1_s, scenario.dsp.k2_1_s2, scenario.clock.period_s
        settled, alone, period = (round(taus * max(k1 / k2, k2**-0.5) / period_s) for taus in (settles, ALONE, PUSHED))
        pushed = settled + alone
        steady = [round(share * period) for share in STEADY]
        down, up = (slice(*(pushed + turned * period // 2 + each for each in steady)) for turned in (1, 2))
        if up.stop * period_s > LONGEST_S:
            raise ScenarioError(
                f"dsp.k1_1_s = {k1:g}, dsp.k2_1_s2 = {k2:g}: at rest such a loop takes {up.stop * period_s:.0f} s to "
                f"be measured, and {LONGEST_S:.0f} s is the most: raise k2"
            )
        return cls(pushed, period, slice(settled, pushed), down, up)


@dataclass(frozen=True)
class Rest:
    """What one joint did. amplitude: peak to peak, left alone; mean: angle minus command then; edges: the mean where it
    was pushed down and up; spectrum: amplitudes of the lines at frequencies. slow: why the run was not fast.
    """

    joint: int
    scenario: Scenario
    predicted: DeadBand
    measured: float
    amplitude: float
    mean: float
    edges: tuple[float, float]
    frequencies: Values
    spectrum: Values
    slow: str

    @property
    def ratio(self) -> float:
        """Measured over predicted."""
        return self.measured / self.predicted.range

    @property
    def period_s(self) -> float | None:
        """Return that of the strongest line; None where nothing moves."""
        strongest = int(np.argmax(self.spectrum))
        return float(1.0 / self.frequencies[strongest]) if self.spectrum[strongest] > 0.0 else None


def rest(scenario: Scenario, run: Runner = quickest) -> list[Rest]:
    """Return what every joint of a scenario does at rest; raise ScenarioError where it never comes to rest.

    What has not settled when it should be alone is run again, and given twice the time.
    """
    codec = load_arm()
    bands = [dead_band(scenario, joint, codec) for joint in range(1, scenario.joints + 1)]
    for settles in SETTLES:
        timed = Timed.of(scenario, settles)
        ran, slow = run(experiment(scenario, bands, timed, codec))
        if ran.stopped:
            raise ScenarioError(f"{scenario.name} at rest, without friction, stops itself: {ran.stopped}")
        deviations = (ran.q - np.array(scenario.start_rad)).T
        of_joints = list(zip(range(1, scenario.joints + 1), bands, deviations, strict=True))
        if all(_settled(deviation[timed.alone], band) for _, band, deviation in of_joints):
            return [_of_joint(scenario, *each, timed, slow) for each in of_joints]
    raise ScenarioError(
        f"{scenario.name} at rest, without friction, has not settled after {timed.alone.start} periods of "
        f"clock.period_s = {scenario.clock.period_s:g}: raise joint.g_rad_s or dsp.k1_1_s"
    )


def _settled(alone: Values, band: DeadBand) -> bool:
    """Return whether a record is within its prediction, or its second half is neither quieter nor elsewhere.

    Halves of a limit cycle differ, too: by less than half of one, and a quarter of its range.
    """
    whole = float(np.ptp(alone))
    before, after = np.array_split(alone, 2)
    elsewhere = abs(float(np.mean(before) - np.mean(after))) > 0.25 * whole
    return whole <= band.range or (float(np.ptp(before)) <= 1.5 * float(np.ptp(after)) and not elsewhere)


def experiment(scenario: Scenario, bands: list[DeadBand], timed: Timed, codec: Codec) -> Scenario:
    """Return what is run: nothing of the scenario but arm, drives, sensors, words and gains; control in joint space.

    Every joint samples on its Encoder frame. bands: of all joints.
    """
    nowhere = (0.0,) * scenario.joints
    by_frames = {"crystal_ppm": None, "crystal_phase_s": None}
    one_by_one = {f"joint{n}": scenario.own(n).model_copy(update=by_frames) for n in range(1, scenario.joints + 1)}
    return scenario.model_copy(
        update={
            "duration_s": timed.cycles * scenario.period_ns * 1e-9,
            "arm": scenario.arm.model_copy(update={"coulomb_N_m": nowhere}),
            "joint": scenario.joint.model_copy(update={"crystal_ppm": None}),
            "dsp": scenario.dsp.model_copy(update={"space": "joint", "law": "acceleration"}),
            "trajectory": QuinticMove(kind="quintic", by_rad=nowhere, time_s=scenario.clock.period_s),
            "torque": tuple(_push(scenario, n, band, timed, codec) for n, band in enumerate(bands, start=1)),
            "load": (),
            "wall": (),
            "box": None,
            "grasp": (),
            "wire": Wire(),
            **one_by_one,
        }
    )


def _push(scenario: Scenario, joint: int, band: DeadBand, timed: Timed, codec: Codec) -> Torque:
    """Return the slow torque on a joint."""
    settings, torque_constant = scenario.joint, scenario.drive.torque_constant_N_m_A[joint - 1]
    spring = settings.g_rad_s * scenario.dsp.k1_1_s * settings.inertia_kg_m2[joint - 1]
    counts = PUSH_COUNTS * 0.5 ** WordFormat.of(scenario, codec).current * torque_constant
    push = PUSH_OF_SPRING * spring * (band.width - rad_per_count(scenario)) + counts
    period_s = scenario.period_ns * 1e-9
    return Torque(
        joint=joint,
        amplitude_N_m=min(push, PUSH_OF_LIMIT * scenario.drive.limit_A * torque_constant),
        frequency_rad_s=2 * pi / (timed.period * period_s),
        at_s=timed.pushed * period_s,
        until_s=timed.cycles * period_s,
    )


def _of_joint(scenario: Scenario, joint: int, band: DeadBand, deviation: Values, timed: Timed, slow: str) -> Rest:
    alone, down, up = (deviation[rows] for rows in (timed.alone, timed.down, timed.up))
    frequencies, spectrum = lines(alone, scenario.clock.period_s)
    return Rest(
        joint=joint,
        scenario=scenario,
        predicted=band,
        measured=float(np.ptp(np.concatenate([alone, down, up]))),
        amplitude=float(np.ptp(alone)),
        mean=float(np.mean(alone)),
        edges=(float(np.mean(down)), float(np.mean(up))),
        frequencies=frequencies,
        spectrum=spectrum,
        slow=slow,
    )


def lines(values: Values, period_s: float) -> tuple[Values, Values]:
    """Return frequencies above 0 and amplitudes of a signal's lines, behind a Hann window."""
    window = np.hanning(len(values))
    amplitudes = np.abs(np.fft.rfft((values - np.mean(values)) * window)) * 2 / np.sum(window)
    frequencies: Values = np.arange(len(amplitudes)) / (len(values) * period_s)
    return frequencies[1:], amplitudes[1:]


# -- as JSON --


def row_of(found: Rest, codec: Codec) -> dict[str, Any]:
    """Return a joint's row, ready for JSON; spectrum: its strongest lines, [Hz, rad]."""
    form, band = WordFormat.of(found.scenario, codec), found.predicted
    strongest = np.argsort(-found.spectrum, kind="stable")[:LINES]
    return {
        "joint": found.joint,
        "counts_per_turn": found.scenario.encoder.counts_per_turn,
        "d_fraction": form.d_fraction,
        "current_fraction": form.current,
        "acceleration_fraction": form.acceleration,
        "predicted": {
            **{f"{name}_rad": width for name, width in band.alone.items()},
            "low_rad": band.low,
            "high_rad": band.high,
            "limit_cycle_rad": band.cycle,
            "range_rad": band.range,
        },
        "dominant": band.dominant,
        "measured_rad": found.measured,
        "ratio": found.ratio,
        "amplitude_rad": found.amplitude,
        "mean_rad": found.mean,
        "pushed_rad": list(found.edges),
        "period_s": found.period_s,
        "spectrum": [[float(found.frequencies[k]), float(found.spectrum[k])] for k in strongest],
    }
