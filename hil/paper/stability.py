"""Whether the loop of a scenario is stable: as the rig runs, and in the theory of the sampled loop.

A run has failed where it ends in a fault, an amplifier or a signal saturates, a joint deviates too far, or an
oscillation grows. Units: rad, s.
"""

import numpy as np

from dbc.compiler import load_arm
from hil.assemble import arm_parameters, joint_trajectory
from hil.evaluate import Evaluation, evaluate
from hil.exact_constants import rad_per_count
from hil.paper.sampled_loop import Array, spectral_radius
from hil.rig import Outcome, run_inline
from hil.scenario import Scenario
from hil.summary import summarise
from plant.array_form import inertia

FAILED_RAD = 0.01
POSES = 31
"""Along the command, at which theory is asked; the least stable one counts."""
GROWN = 2.0
"""From the second third of a run to the last one: what only rings dies away, or stays."""


# -- as the rig runs --


def failed(scenario: Scenario, bound_rad: float = FAILED_RAD) -> bool:
    """Return whether the loop of a scenario fails; bound_rad: how far a joint may deviate."""
    outcome = run_inline(scenario)
    evaluation = evaluate(outcome)
    if evaluation is None or why_failed(outcome, evaluation):
        return True
    return bool(np.max(np.abs(evaluation.deviation)) > bound_rad)


def why_failed(outcome: Outcome, evaluation: Evaluation) -> str:
    """Return what a run shows of an unstable loop, whatever its motion; "" for a run that shows nothing of it."""
    summary = summarise(outcome, evaluation, 0.0)
    if summary["faults"]:
        fault = summary["faults"][0]
        return f"{fault['reason']} at {fault['time_s']:.3f} s ({fault['node']}: {fault['cause']})"
    if summary["saturations"]:
        return f"saturations: {', '.join(f'{k} {n}' for k, n in summary['saturations_by_signal'].items())}"
    return "an oscillation grows" if grows(evaluation) else ""


def grows(evaluation: Evaluation) -> bool:
    """Return whether some joint oscillates by more than an encoder's count in the end, and by less before.

    The oscillation is what a cycle's deviation has above the mean of its neighbours; a motion has next to none.
    """
    deviation = evaluation.deviation
    above = deviation[1:-1] - 0.5 * (deviation[:-2] + deviation[2:])
    if len(above) < 3:
        return False
    _, middle, last = (np.sqrt(np.mean(third**2, axis=0)) for third in np.array_split(above, 3))
    return bool(np.any((last > rad_per_count(evaluation.scenario)) & (last > GROWN * middle)))


# -- in theory --


def inertias_along(scenario: Scenario) -> Array:
    """Return M (K, n, n) at poses along the commanded motion, without payload, which only steadies the loop."""
    motion = joint_trajectory(scenario)
    q = np.array([motion.at(t_s)[0] for t_s in np.linspace(0.0, motion.time_s, POSES)])
    return inertia(arm_parameters(scenario, load_arm()), q, np.zeros(len(q)))


def worst_radius(scenario: Scenario, inertias: Array, delay_s: Array) -> float:
    """Return the largest spectral radius at these inertia matrices (K, n, n), with these delays [s].

    A current i makes Kt i: to the loop a torque constant that is wrong is a wrong Jn.
    """
    joint, dsp, period_s = scenario.joint, scenario.dsp, scenario.clock.period_s
    gains = dsp.k1_1_s, dsp.k2_1_s2
    true_over_nominal = np.divide(scenario.drive.torque_constant_N_m_A, joint.torque_constant_N_m_A)
    felt = (true_over_nominal * joint.inertia_kg_m2).tolist()
    return max(spectral_radius(M, felt, joint.g_rad_s, gains, period_s, delay_s) for M in inertias)
