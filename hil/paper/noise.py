"""The noise claim: the encoder's resolution bounds g from above. Noise in the current, measured and in theory.

The position counter rounds down, which adds noise of variance LSB^2 / 12, white while the joint moves by several counts
a sample. Its way to the current is that of the sampled loop. Both, measured and predicted, are taken above what a mean
over SMOOTHED cycles leaves, so that the motion itself does not count.
"""

from concurrent.futures import Executor
from dataclasses import dataclass
from itertools import product
from math import pi, sqrt

import numpy as np

from dbc.compiler import load_arm
from hil import scenario_file
from hil.assemble import arm_parameters
from hil.evaluate import evaluate
from hil.paper.frequency_response import mean_delays
from hil.paper.sampled_loop import Array, Loop
from hil.rig import run_inline
from hil.scenario import Scenario
from hil.summary import summarise
from plant.array_form import inertia

COUNTS_PER_TURN = (65_536, 102_400, 204_800, 409_600, 819_200, 1_638_400)
G_RAD_S = (100.0, 200.0, 350.0, 500.0, 600.0, 700.0, 800.0)
SMOOTHED = 25
MOVING = slice(250, 750)
"""Cycles of paper-joint in which every joint moves by a count a sample and more."""
POINTS = 512


@dataclass(frozen=True)
class Noise:
    """One run: current noise (rms, A) measured and predicted, largest deviation (rad), one entry a joint.

    saturated: the amplifier's or a signal's limit was reached: a limit cycle, which no linear theory predicts.
    """

    counts_per_turn: int
    g_rad_s: float
    measured_A: list[float]
    predicted_A: list[float]
    largest_rad: list[float]
    saturated: bool


def heat_map(executor: Executor) -> list[Noise]:
    """Run paper-joint with every encoder and g."""
    return list(executor.map(measure, *zip(*product(COUNTS_PER_TURN, G_RAD_S), strict=True)))


def measure(counts_per_turn: int, g_rad_s: float) -> Noise:
    """Run paper-joint with one encoder and one g."""
    scenario = scenario_file.load(
        "paper-joint", [f"encoder.counts_per_turn={counts_per_turn}", f"joint.g_rad_s={g_rad_s}"]
    )
    outcome = run_inline(scenario)
    evaluation = evaluate(outcome)
    assert evaluation is not None
    summary = summarise(outcome, evaluation, 0.0)
    measured = np.std(_above_mean(evaluation.i_ref)[MOVING], axis=0)
    middle = evaluation.q[(MOVING.start + MOVING.stop) // 2]
    return Noise(
        counts_per_turn,
        g_rad_s,
        measured.tolist(),
        predict(scenario, mean_delays(outcome), middle).tolist(),
        summary["max_deviation_rad"],
        bool(summary["saturations"] or summary["faults"]),
    )


def _above_mean(values: Array) -> Array:
    """Take the mean over SMOOTHED rows around it off each row."""
    kernel = np.ones(SMOOTHED) / SMOOTHED
    above: Array = values - np.stack([np.convolve(column, kernel, mode="same") for column in values.T], axis=1)
    return above


def predict(scenario: Scenario, delay_s: Array, pose: Array) -> Array:
    """Return the rms noise [A] that the encoder's rounding makes in each joint's current, at this pose."""
    joint, T = scenario.joint, scenario.clock.period_s
    M = inertia(arm_parameters(scenario, load_arm()), pose[None], np.zeros(1))[0]
    felt = np.array(joint.inertia_kg_m2) * np.diag(np.linalg.inv(M))
    angles = (np.arange(POINTS) + 0.5) * pi / POINTS
    kernel = np.exp(1j * np.outer(angles, np.arange(SMOOTHED) - SMOOTHED // 2)).mean(axis=1)
    lsb = 2 * pi / scenario.encoder.counts_per_turn
    amperes = []
    for n in range(scenario.joints):
        loop = Loop(joint.g_rad_s, scenario.dsp.k1_1_s, scenario.dsp.k2_1_s2, T, float(delay_s[n]))
        gain = np.abs(loop.noise_to_reference(angles, felt[n]) * (1 - kernel))
        acceleration = lsb / sqrt(12) * float(np.sqrt(np.mean(gain**2)))
        amperes.append(acceleration * joint.inertia_kg_m2[n] / joint.torque_constant_N_m_A[n])
    return np.array(amperes)
