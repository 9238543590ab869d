"""`robot` as plain functions over arrays, which Numba takes as they are: the same stops in time, to the same bits.

What is to happen stands in lists, in order of time, with a mark at what is next. Units: integer ns, rad, A, N m.
Ref: eq. (1). Not here: the world, backends other than `closed`, brakes that engage.
"""

from collections.abc import Sequence
from math import floor, tau
from typing import Any, NamedTuple

import numpy as np

from plant.flat_dynamics import FlatArm, Floats, Ints, copy, couplings, flat_arm
from plant.flat_motion import advance
from plant.parameters import MAX_JOINTS, ArmParameters, Vector

GOES_ON, NOT_FINITE, NO_END = 0, 1, 2
"""Why a motion ends: a number that is not finite; changes of friction without end."""

FLAT_STATE = np.dtype(
    [
        ("now_ns", np.int64),
        ("longest_ns", np.int64),  # of a step
        ("counts_per_A", np.float64),
        ("limit_A", np.float64),
        ("zero_rad", np.float64, (MAX_JOINTS,)),
        ("counts_per_rad", np.float64),
        ("counter_mask", np.int64),
        ("saturations", np.int64, (MAX_JOINTS,)),
        ("next_current", np.int64, (MAX_JOINTS,)),
        ("next_payload", np.int64),
        ("next_torque", np.int64),
    ]
)


class FlatRobot(NamedTuple):
    """A robot and what will happen to it.

    applied_ns, counts: by joint and cycle, when the cycle's current is applied, and the current; couplings, moments:
    A_ij and G_i from each payload_ns on; torque_Nm: from outside on torque_joint (from 0) from each torque_ns on.
    """

    arm: FlatArm
    state: Any
    applied_ns: Ints
    counts: Ints
    payload_ns: Ints
    couplings: Floats
    moments: Floats
    torque_ns: Ints
    torque_joint: Ints
    torque_Nm: Floats


def flat_robot(
    parameters: ArmParameters,
    start_rad: Vector,
    start_ns: int,
    max_step_ns: int,
    applied_ns: Ints,
    payloads: Sequence[tuple[float, int]],
    torques: Sequence[tuple[int, int, float]],
) -> FlatRobot:
    """Return a robot at rest, brakes engaged. payloads: (mass, from when on); torques: (when, joint from 1, torque)."""
    state = np.zeros(1, FLAT_STATE).view(np.recarray)[0]
    state.now_ns = start_ns
    lag_ns = round(parameters.amplifier_lag_s * 1e9)
    state.longest_ns = min(max_step_ns, max(1, lag_ns // 4)) if lag_ns else max_step_ns
    state.counts_per_A, state.limit_A = parameters.current_counts_per_A, parameters.current_limit_A
    state.zero_rad[: parameters.joints] = start_rad
    state.counts_per_rad = parameters.counts_per_turn / tau
    state.counter_mask = (1 << parameters.counter_bits) - 1
    loaded = [couplings(parameters, mass_kg) for mass_kg, _ in payloads]
    return FlatRobot(
        arm=flat_arm(parameters, start_rad),
        state=state,
        applied_ns=applied_ns,
        counts=np.zeros_like(applied_ns),
        payload_ns=np.array([at_ns for _, at_ns in payloads], dtype=np.int64),
        couplings=np.array([coupling for coupling, _ in loaded]).reshape(-1, MAX_JOINTS, MAX_JOINTS),
        moments=np.array([moment for _, moment in loaded]).reshape(-1, MAX_JOINTS),
        torque_ns=np.array([at_ns for at_ns, _, _ in torques], dtype=np.int64),
        torque_joint=np.array([joint - 1 for _, joint, _ in torques], dtype=np.int64),
        torque_Nm=np.array([torque_Nm for _, _, torque_Nm in torques], dtype=np.float64),
    )


def advance_to(robot: FlatRobot, t_ns: int, cycles: int) -> int:
    """Integrate to t_ns, through every event up to and at t_ns, with the currents of so many cycles; return why not."""
    while True:
        at_ns = min(t_ns, _next_ns(robot, cycles))
        failed = _integrate_to(robot, at_ns)
        if failed != GOES_ON or not _act(robot, at_ns, cycles):
            return failed


def position_counts(robot: FlatRobot, j: int) -> int:
    """Return the counter of joint j (from 0): `encoder.Encoder.counts`."""
    state = robot.state
    counts: int = floor((robot.arm.q[j] - state.zero_rad[j]) * state.counts_per_rad) & state.counter_mask
    return counts


def release_brakes(robot: FlatRobot, coulomb_Nm: Floats) -> None:
    """Leave only the joints' own friction."""
    copy(coulomb_Nm, robot.arm.limit)


def _next_ns(robot: FlatRobot, cycles: int) -> int:
    """Return when something happens next."""
    state = robot.state
    first = 1 << 62
    for j in range(robot.arm.joints):
        if state.next_current[j] < cycles:
            first = min(first, robot.applied_ns[j, state.next_current[j]])
    if state.next_payload < len(robot.payload_ns):
        first = min(first, robot.payload_ns[state.next_payload])
    if state.next_torque < len(robot.torque_ns):
        first = min(first, robot.torque_ns[state.next_torque])
    return first


def _act(robot: FlatRobot, now_ns: int, cycles: int) -> bool:
    """Let all that is due now happen; return whether there was anything."""
    state, acted = robot.state, False
    for j in range(robot.arm.joints):
        while state.next_current[j] < cycles and robot.applied_ns[j, state.next_current[j]] == now_ns:
            _command(robot, j, robot.counts[j, state.next_current[j]])
            state.next_current[j] += 1
            acted = True
    while state.next_payload < len(robot.payload_ns) and robot.payload_ns[state.next_payload] == now_ns:
        copy(robot.moments[state.next_payload], robot.arm.moment)
        for i in range(robot.arm.joints):
            copy(robot.couplings[state.next_payload, i], robot.arm.coupling[i])
        state.next_payload += 1
        acted = True
    while state.next_torque < len(robot.torque_ns) and robot.torque_ns[state.next_torque] == now_ns:
        robot.arm.external[robot.torque_joint[state.next_torque]] = robot.torque_Nm[state.next_torque]
        state.next_torque += 1
        acted = True
    return acted


def _command(robot: FlatRobot, j: int, counts: int) -> None:
    """Set the reference of joint j, limited to the largest current: `drive.Amplifiers.command`."""
    arm, limit_A = robot.arm, robot.state.limit_A
    asked_A = counts / robot.state.counts_per_A
    given_A = asked_A
    if not -limit_A <= asked_A <= limit_A:
        given_A = limit_A if asked_A > 0.0 else -limit_A
        robot.state.saturations[j] += 1
    arm.reference[j] = given_A
    if arm.lag_s == 0.0:
        arm.current[j] = given_A


def _integrate_to(robot: FlatRobot, t_ns: int) -> int:
    """Integrate without events, in equal steps of at most the longest; return why not."""
    arm, state = robot.arm, robot.state
    span_ns = t_ns - state.now_ns
    if span_ns == 0:
        return GOES_ON
    parts = -(-span_ns // state.longest_ns)
    span_s = span_ns * 1e-9 if parts == 1 else span_ns * 1e-9 / parts
    for _ in range(parts):
        if not advance(arm, span_s):
            return NO_END
    state.now_ns = t_ns
    return NOT_FINITE if arm.lost else GOES_ON
