"""The DSP's part of a cycle as plain functions over arrays, which Numba takes as they are, to the same bits.

The sums are the firmware's own source; the loops round them over joints are written again (firmware_py.dsp.control has
them over sequences), and what is stored goes through single precision here too. Units: rad, rad/s^2, m; counts.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from firmware_py.dsp.control import JointSpace, TaskSpace, corrected
from firmware_py.dsp.kinematics import is_singular, jacobian_rate_times_speed, regular_solution, tip
from plant.flat_dynamics import Floats, Ints, copy
from plant.parameters import MAX_JOINTS

LARGEST = 1e18
"""Counts beyond this fit no int: whatever asks for them is not finite soon."""

FLAT_DSP = np.dtype(
    [
        ("joints", np.int64),
        ("in_task_space", np.int64),
        ("period_s", np.float64),
        ("k1", np.float64),
        ("k2", np.float64),
        ("lengths_m", np.float64, (3,)),
        ("zero_rad", np.float64, (MAX_JOINTS,)),
        ("rad_per_count", np.float64),
        ("counts_per_rad_s2", np.float64),
        ("last", np.int64),  # cycle of the command table
        ("counts", np.int64, (MAX_JOINTS,)),
        ("q", np.float64, (MAX_JOINTS,)),
        ("q_before", np.float64, (MAX_JOINTS,)),
        ("x_before", np.float64, (3,)),
        ("saturations", np.int64, (MAX_JOINTS,)),
    ]
)


class FlatDsp(NamedTuple):
    """What it is and remembers; its command table, positions from cycle -1 on; the references, in counts."""

    state: Any
    position: Floats
    acceleration: Floats
    a_ref: Ints


def flat_dsp(
    control: JointSpace | TaskSpace,
    position: Floats,
    acceleration: Floats,
    zero_rad: Sequence[float],
    gains: tuple[float, float],
    scales: tuple[float, float],
) -> FlatDsp:
    """Return the DSP before cycle 0.

    control: the position controller, whatever its gains; position, acceleration: its command table; gains: K1, K2;
    scales: rad a count of the encoders, counts of AccelRef a rad/s^2.
    """
    joints = len(zero_rad)
    state = np.zeros(1, FLAT_DSP).view(np.recarray)[0]
    state.joints, state.period_s, state.last = joints, control.commands.period_s, control.commands.last
    state.k1, state.k2 = gains
    state.rad_per_count, state.counts_per_rad_s2 = scales
    if isinstance(control, TaskSpace):
        state.in_task_space = 1
        state.lengths_m, state.x_before = control.lengths_m, control.x_before
    state.zero_rad[:joints] = zero_rad
    state.q_before[:joints] = control.q_before
    return FlatDsp(state, position, acceleration, np.zeros(MAX_JOINTS, dtype=np.int64))


def answer(dsp: FlatDsp, counters: Ints, cycle: int) -> bool:
    """Set the references of a cycle from its counters; return False at a singular point, or where none fits an int."""
    _measure(dsp.state, counters)
    if dsp.state.in_task_space == 0:
        return _in_joint_space(dsp, min(cycle, dsp.state.last))
    return _in_task_space(dsp, min(cycle, dsp.state.last))


def single(x: float) -> float:
    """Return x as single precision keeps it."""
    return np.float64(np.float32(x))


def _measure(state: Any, counters: Ints) -> None:
    """Carry the 16-bit counters on to angles."""
    for j in range(state.joints):
        state.counts[j] += ((counters[j] - state.counts[j] + 0x8000) & 0xFFFF) - 0x8000
        state.q[j] = single(state.zero_rad[j] + state.counts[j] * state.rad_per_count)


def _commanded(dsp: FlatDsp, cycle: int, i: int, x: float, v: float) -> float:
    """Return the acceleration of coordinate i that its command and its errors ask for."""
    state = dsp.state
    before, now = dsp.position[cycle, i], dsp.position[cycle + 1, i]
    velocity = (now - before) / state.period_s
    return corrected(now, velocity, dsp.acceleration[cycle, i], x, v, state.k1, state.k2)


def _in_joint_space(dsp: FlatDsp, cycle: int) -> bool:
    state, fits = dsp.state, True
    for j in range(state.joints):
        w = (state.q[j] - state.q_before[j]) / state.period_s
        fits = _refer(dsp, j, _commanded(dsp, cycle, j, state.q[j], w)) and fits
    copy(state.q, state.q_before)
    return fits


def _in_task_space(dsp: FlatDsp, cycle: int) -> bool:
    state = dsp.state
    lengths_m = (state.lengths_m[0], state.lengths_m[1], state.lengths_m[2])
    q = (state.q[0], state.q[1], state.q[2])
    before, period_s = state.q_before, state.period_s
    w = ((q[0] - before[0]) / period_s, (q[1] - before[1]) / period_s, (q[2] - before[2]) / period_s)
    bias = jacobian_rate_times_speed(lengths_m, q, w)
    x, y, phi = tip(lengths_m, q)
    wanted = (
        _carried(dsp, cycle, 0, x) - bias[0],
        _carried(dsp, cycle, 1, y) - bias[1],
        _carried(dsp, cycle, 2, phi) - bias[2],
    )
    copy(state.q, state.q_before)
    if is_singular(q):
        return False
    a = regular_solution(lengths_m, q, wanted)
    return _refer(dsp, 0, a[0]) and _refer(dsp, 1, a[1]) and _refer(dsp, 2, a[2])


def _carried(dsp: FlatDsp, cycle: int, i: int, measured: float) -> float:
    """Return what `_commanded` asks for tip coordinate i, and remember where it is."""
    state = dsp.state
    x = single(measured)
    v = (x - state.x_before[i]) / state.period_s
    state.x_before[i] = x
    return _commanded(dsp, cycle, i, x, v)


def _refer(dsp: FlatDsp, j: int, acceleration: float) -> bool:
    """Round the reference of joint j to counts, limited to 16 bits; return whether it fits an int at all."""
    exact = acceleration * dsp.state.counts_per_rad_s2
    if not -LARGEST < exact < LARGEST:
        return False
    count = int(np.rint(exact))
    dsp.a_ref[j] = max(-0x8000, min(0x7FFF, count))
    if dsp.a_ref[j] != count:
        dsp.state.saturations[j] += 1
    return True
