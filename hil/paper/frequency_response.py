"""Fig. 8, measured on the running rig: G and 1 - G from the plant's truth under sinusoidal torque from outside.

1 - G = (Ktn i_ref - Jn q") / t_dis with t_dis = Ktn i_a - Jn q", eqs. (3) and (7), all at the frequency of the torque.
q" is -w^2 times the Fourier coefficient of the plant's true angle; the currents are those that acted, each from the end
of its frame on, so their coefficients are exact integrals of steps. The joint's own estimate is not used.
The rig is linearised (no gravity, no Coulomb friction); the position loop is closed, with the paper's gains.
"""

from concurrent.futures import Executor
from dataclasses import dataclass
from math import pi

import numpy as np

from dbc.compiler import load_arm
from hil import scenario_file
from hil.assemble import dead_time
from hil.constants import action_delays_ns
from hil.evaluate import Evaluation, evaluate, frames_of_cycles
from hil.paper.sampled_loop import Array, Complex, Loop
from hil.rig import Outcome, run_inline
from hil.scenario import Scenario

FREQUENCIES_RAD_S = (10.0, 17.0, 30.0, 50.0, 90.0, 150.0, 250.0, 400.0, 550.0, 700.0, 1000.0, 1400.0, 2000.0)
SETTLE_CYCLES = 400
WINDOW_CYCLES = 1500
AMPLITUDE_N_M = (40.0, 16.0, 4.0)
"""For each joint: tens of encoder counts at 10 rad/s, and still a count at 2000 rad/s, below every limit."""
LINEAR = ("arm.gravity_m_s2=0", "arm.coulomb_N_m=[0,0,0]", "trajectory.by_rad=[0,0,0]", "trajectory.time_s=0.001")


@dataclass(frozen=True)
class FrequencyResponse:
    """Of every joint: measured and theoretical 1 - G (frequencies, joints)."""

    rad_s: Array
    measured: Complex
    theory: Complex
    loops: tuple[Loop, ...]

    @property
    def error_dB(self) -> Array:
        """How far the measured 1 - G is above the theory."""
        error: Array = dB(self.measured) - dB(self.theory)
        return error


def dB(value: Complex) -> Array:
    """Return 20 log10 of the modulus."""
    level: Array = 20 * np.log10(np.abs(value))
    return level


def measure(executor: Executor) -> FrequencyResponse:
    """Run the linearised paper-joint once a frequency, all joints driven at once."""
    found = list(executor.map(_measure_one, FREQUENCIES_RAD_S))
    rad_s = np.array([rad_s for rad_s, _, _ in found])
    loops = found[0][2]
    theory = np.stack([loop.sensitivity(rad_s) for loop in loops], axis=1)
    return FrequencyResponse(rad_s, np.array([values for _, values, _ in found]), theory, loops)


def _measure_one(wanted_rad_s: float) -> tuple[float, Complex, tuple[Loop, ...]]:
    period_s = 0.001
    periods = max(1, round(wanted_rad_s * WINDOW_CYCLES * period_s / (2 * pi)))
    window = round(2 * pi * periods / (wanted_rad_s * period_s))
    rad_s = 2 * pi * periods / (window * period_s)
    scenario = _scenario(rad_s, SETTLE_CYCLES + window + 2)
    outcome = run_inline(scenario)
    evaluation = evaluate(outcome)
    assert evaluation is not None
    return rad_s, _sensitivity(outcome, evaluation, rad_s, window), _loops(outcome)


def _scenario(rad_s: float, cycles: int) -> Scenario:
    duration_s = round(cycles * 0.001, 6)
    torques = ", ".join(
        f"{{joint={n}, amplitude_N_m={amplitude}, frequency_rad_s={rad_s!r}, until_s={duration_s}}}"
        for n, amplitude in enumerate(AMPLITUDE_N_M, start=1)
    )
    return scenario_file.load("paper-joint", [*LINEAR, f"duration_s={duration_s}", f"torque=[{torques}]"])


def _sensitivity(outcome: Outcome, evaluation: Evaluation, rad_s: float, window: int) -> Complex:
    """Return 1 - G of each joint over the last `window` cycles but one."""
    scenario = outcome.scenario
    rows = slice(SETTLE_CYCLES, SETTLE_CYCLES + window)
    turns = np.exp(-1j * rad_s * evaluation.t_s[rows])
    acceleration = -(rad_s**2) * (turns @ evaluation.q[rows]) / window
    instants = action_instants(outcome)
    # cycle k works with the reference of cycle k - 1
    held = {"u": evaluation.i_ref, "a": np.vstack([evaluation.a_ref[:1], evaluation.a_ref[:-1]])}
    begins_s, ends_s = evaluation.t_s[SETTLE_CYCLES], evaluation.t_s[SETTLE_CYCLES + window]
    found = {
        name: np.array([_coefficient(instants[:, n], values[:, n], begins_s, ends_s, rad_s) for n in range(3)])
        for name, values in held.items()
    }
    Jn, Ktn = np.array(scenario.joint.inertia_kg_m2), np.array(scenario.joint.torque_constant_N_m_A)
    disturbance = Ktn * found["u"] - Jn * acceleration
    sensitivity: Complex = (Jn * found["a"] - Jn * acceleration) / disturbance
    return sensitivity


def action_instants(outcome: Outcome) -> Array:
    """Return when each joint's current of every cycle acted [s], (K, n): behind its action delay and dead time."""
    scenario, codec = outcome.scenario, load_arm()
    delays_ns, dead = action_delays_ns(scenario), dead_time(scenario)
    instants = np.full((scenario.cycles, scenario.joints), np.nan)
    joints = {codec[f"Current_{n + 1}"].identifier: n for n in range(scenario.joints)}
    for cycle, end_ns, identifier, _ in frames_of_cycles(outcome, codec, joints):
        joint = joints[identifier]
        acts_ns = max(end_ns, cycle * scenario.period_ns + delays_ns[joint])
        if dead is not None:
            acts_ns = dead.applied_ns(joint, cycle, acts_ns)
        instants[cycle, joint] = acts_ns * 1e-9
    return instants


def _coefficient(instants_s: Array, values: Array, begins_s: float, ends_s: float, rad_s: float) -> complex:
    """Return the Fourier coefficient over [begins, ends) of a function that steps to values at instants."""
    edges = np.clip(np.append(instants_s, np.inf), begins_s, ends_s)
    phases = np.exp(-1j * rad_s * edges)
    return complex(values @ (phases[:-1] - phases[1:]) / (1j * rad_s * (ends_s - begins_s)))


def _loops(outcome: Outcome) -> tuple[Loop, ...]:
    """Return the loop of each joint with the mean delay that its currents had."""
    scenario = outcome.scenario
    gains = scenario.dsp.k1_1_s, scenario.dsp.k2_1_s2
    g, period_s = scenario.joint.g_rad_s, scenario.clock.period_s
    return tuple(Loop(g, *gains, period_s, float(delay_s)) for delay_s in mean_delays(outcome))


def mean_delays(outcome: Outcome) -> Array:
    """Return how long after the sample each joint's current acted, on the mean [s]."""
    cycles = np.arange(outcome.scenario.cycles)[:, None] * outcome.scenario.clock.period_s
    delays: Array = np.nanmean(action_instants(outcome) - cycles, axis=0)
    return delays
