"""What a run was worth: deviations against the plant's truth, and the signals behind them.

Deviation is the analytic command minus the plant's true value at kT, k = 0 to K-1; final is the rms of the last 100 ms.
Arrays have one row a cycle and, where a name says so, one column a joint (rad) or an axis x, y (m).

Ref: the paper's eqs. (3)-(4), figs. 15 and 16.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from dbc.codec import Codec
from dbc.compiler import load_arm
from firmware_py.dsp.cpu import ACCEL_REFS, JOINTS_A_FRAME
from firmware_py.dsp.trajectory import Trajectory
from hil.assemble import arm_parameters, build_trajectory, joint_trajectory
from hil.rig import Outcome
from hil.scenario import Scenario
from plant.array_form import tip_velocities, tips
from plant.disturbance import DisturbanceTerms, disturbance_terms

Array = npt.NDArray[np.float64]

FINAL_S = 0.1


@dataclass(frozen=True)
class Evaluation:
    """The signals of one run, one row a cycle.

    q_cmd, w_cmd: joint commands; q, w: truth; x, v: tip (x, y) of both; a_ref, i_ref, estimate: what was on the bus
    (NaN where a frame is missing); disturbance: the terms of (4), N m; current: A; world: what the plant recorded of
    contacts and bodies, by column, empty without a world.
    """

    scenario: Scenario
    t_s: Array
    q_cmd: Array
    w_cmd: Array
    q: Array
    w: Array
    x_cmd: Array
    v_cmd: Array
    x: Array
    v: Array
    a_ref: Array
    i_ref: Array
    current: Array
    estimate: Array
    disturbance: DisturbanceTerms
    world: dict[str, Array] = field(default_factory=dict)

    @property
    def deviation(self) -> Array:
        """Joint deviation, rad."""
        return self.q_cmd - self.q

    @property
    def final_rows(self) -> slice:
        """The last 100 ms."""
        return final_rows(self.scenario)


def evaluate(outcome: Outcome) -> Evaluation | None:
    """Return the evaluation of a run; None if it ended before cycle 0, or if somebody else played the plant."""
    if "plant" not in outcome.reports:
        return None
    scenario, codec = outcome.scenario, load_arm()
    truth = recorded_truth(outcome)
    cycles = len(truth["payload_kg"])
    if cycles == 0:
        return None
    q, w = truth["q_rad"], truth["w_rad_s"]
    q_cmd, w_cmd, x_cmd, v_cmd = commands(scenario, cycles)
    x, v = _tip(scenario, q, w)
    bus = _from_bus(outcome, codec, cycles)
    return Evaluation(
        scenario=scenario,
        t_s=np.arange(cycles, dtype=np.float64) * scenario.clock.period_s,
        q_cmd=q_cmd,
        w_cmd=w_cmd,
        q=q,
        w=w,
        x_cmd=x_cmd,
        v_cmd=v_cmd,
        x=x,
        v=v,
        a_ref=bus["a_ref"],
        i_ref=bus["i_ref"],
        current=truth["current_A"],
        estimate=bus["estimate"] * np.array(scenario.joint.torque_constant_N_m_A),
        disturbance=_disturbance(scenario, codec, truth),
        world={name: values for name, values in truth.items() if values.ndim == 1 and name != "payload_kg"},
    )


def recorded_truth(outcome: Outcome) -> dict[str, Array]:
    """Return what the plant recorded: (K, n) for each name with one value a joint, (K,) for the others."""
    report = outcome.reports["plant"]
    joints = outcome.scenario.joints
    rows = np.array(report["rows"], dtype=float).reshape(-1, len(report["columns"]))[: outcome.scenario.cycles]
    names = [column.removesuffix("_1") for column in report["columns"] if column.endswith("_1")]
    truth = {name: rows[:, k * joints : (k + 1) * joints] for k, name in enumerate(names)}
    first = len(names) * joints
    return truth | {name: rows[:, first + k] for k, name in enumerate(report["columns"][first:])}


def _disturbance(scenario: Scenario, codec: Codec, truth: dict[str, Array]) -> DisturbanceTerms:
    return disturbance_terms(
        arm_parameters(scenario, codec),
        truth["q_rad"],
        truth["w_rad_s"],
        truth["a_rad_s2"],
        truth["current_A"],
        truth["friction_Nm"],
        scenario.joint.inertia_kg_m2,
        scenario.joint.torque_constant_N_m_A,
        truth["payload_kg"],
        truth["external_Nm"],
    )


def final_rows(scenario: Scenario) -> slice:
    """Return the rows of the last 100 ms."""
    return slice(-max(1, round(FINAL_S / scenario.clock.period_s)), None)


def _tip(scenario: Scenario, q: Array, w: Array) -> tuple[Array, Array]:
    """Return the tip's (x, y) and (x', y'), eqs. (10) and (11)."""
    parameters = arm_parameters(scenario, load_arm())
    return tips(parameters, q)[:, :2], tip_velocities(parameters, q, w)[:, :2]


def tip(scenario: Scenario, q: Array) -> Array:
    """Return the tip's (x, y), eq. (10)."""
    return tips(arm_parameters(scenario, load_arm()), q)[:, :2]


def commands(scenario: Scenario, cycles: int) -> tuple[Array, Array, Array, Array]:
    """Return (q, q', x, x') as commanded, without any rounding of the DSP's."""
    told = {key: getattr(scenario, key) for key in ("start_rad", "duration_s", "clock", "arm", "trajectory")}
    q, w, *tip_cmd = _motions(Scenario(name="motion", **told), cycles)
    x, v = tip_cmd or _tip(scenario, q, w)
    return q, w, x, v


@lru_cache(maxsize=16)
def _motions(scenario: Scenario, cycles: int) -> tuple[Array, ...]:
    """Return (q, q'), in task space also (x, x'), once for all runs of a motion: it takes some 0.2 s.

    scenario: told nothing that the motion does not depend on.
    """
    times = [k * scenario.clock.period_s for k in range(cycles)]
    found = _sampled(joint_trajectory(scenario), times)
    if scenario.in_task_space:
        x, v = _sampled(build_trajectory(scenario), times)
        found = (*found, x[:, :2], v[:, :2])
    for values in found:
        values.flags.writeable = False
    return found


def _sampled(motion: Trajectory, times: list[float]) -> tuple[Array, ...]:
    """Return position and velocity at every time."""
    commands = [motion.at(t) for t in times]
    return np.array([position for position, _, _ in commands]), np.array([velocity for _, velocity, _ in commands])


def frames_of_cycles(
    outcome: Outcome, codec: Codec, identifiers: Collection[int]
) -> Iterator[tuple[int, int, int, tuple[int, ...]]]:
    """Yield (cycle, end in ns, identifier, raw values) of these frames, which end with the cycle they belong to.

    Damaged ones and those of other cycles than the run's are left out.
    """
    period_ns = outcome.scenario.period_ns
    for end_ns, identifier, data, _ in outcome.log.frames:
        fields = codec.by_identifier[identifier].unpack(data) if identifier in identifiers else None
        if fields is None:
            continue
        period = end_ns // period_ns
        cycle = period - ((period - fields[-1]) & 0xFF)
        if 0 <= cycle < outcome.scenario.cycles:
            yield cycle, end_ns, identifier, fields


def _from_bus(outcome: Outcome, codec: Codec, cycles: int) -> dict[str, Array]:
    """Return what AccelRef and Current frames of each cycle say, in rad/s^2 and A."""
    joints = outcome.scenario.joints
    nothing = np.full((cycles, joints), np.nan)
    found = {"a_ref": nothing.copy(), "i_ref": nothing.copy(), "estimate": nothing.copy()}
    current = {codec[f"Current_{n}"].identifier: n for n in range(1, joints + 1)}
    accel_refs = {codec[name].identifier: m * JOINTS_A_FRAME for m, name in enumerate(ACCEL_REFS)}
    amperes, rad_s2 = codec.scale("Current_1", "Reference"), codec.scale("AccelRef", "Joint1")
    for cycle, _, identifier, fields in frames_of_cycles(outcome, codec, {*accel_refs, *current}):
        if cycle >= cycles:
            continue
        if identifier in accel_refs:
            first = accel_refs[identifier]
            last = min(joints, first + JOINTS_A_FRAME)
            found["a_ref"][cycle, first:last] = [value * rad_s2 for value in fields[: last - first]]
        else:
            joint = current[identifier] - 1
            found["i_ref"][cycle, joint], found["estimate"][cycle, joint] = (value * amperes for value in fields[:2])
    return found
