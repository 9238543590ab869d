"""The arm's dynamics as loops over arrays: the sums of `closed_form` in the same order, so to the same bits.

Loops, because joints and which of them are free are numbers here: one machine code serves every arm. In CPython they
would cost ten times what the straight-line text of `closed_form` and `rk4` does, hence two forms of one thing; the
tests hold them to each other. Plain Python that Numba takes as it is. Units: SI. Ref: eq. (1).
A sum begins with -0.0, which is the only number that leaves every other as it is (0.0 would make 0.0 of -0.0).
"""

from math import cos, exp, sin
from typing import Any

import numpy as np
import numpy.typing as npt

from plant.closed_form import constants
from plant.parameters import MAX_JOINTS, ArmParameters, Vector

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

_EACH = (MAX_JOINTS,)
_PAIR = (MAX_JOINTS, MAX_JOINTS)
FLAT_ARM = np.dtype(
    [
        ("joints", np.int64),
        ("coupling", np.float64, _PAIR),  # A_ij, i <= j
        ("moment", np.float64, _EACH),  # G_i
        ("rotor", np.float64, _EACH),  # J_i
        ("viscosity", np.float64, _EACH),  # D_i
        ("torque_constant", np.float64, _EACH),
        ("ripple", np.float64, _EACH),
        ("ripple_order", np.float64, _EACH),
        ("lag_s", np.float64),
        # the state
        ("q", np.float64, _EACH),
        ("w", np.float64, _EACH),
        ("current", np.float64, _EACH),
        ("reference", np.float64, _EACH),
        ("external", np.float64, _EACH),
        ("limit", np.float64, _EACH),  # of friction, brakes included
        ("modes", np.int64, _EACH),  # as in `friction`: a joint is free if its mode is not 0
        ("constant", np.float64, _EACH),  # torque that is constant while the modes are
        ("lost", np.int64),  # whether a step ever led to a number that is not finite
        # where a step led
        ("q_then", np.float64, _EACH),
        ("w_then", np.float64, _EACH),
        ("current_then", np.float64, _EACH),
        ("slopes", np.float64, (4, MAX_JOINTS)),  # q" of its four stages
        # room to compute in, by the symbols of `closed_form`
        ("sine", np.float64, _PAIR),  # S_ij
        ("cosine", np.float64, _PAIR),
        ("inertia", np.float64, _PAIR),  # m_ij, i <= j
        ("upper", np.float64, _PAIR),
        ("lower", np.float64, _PAIR),
        ("bias", np.float64, _EACH),  # b_i
        ("squares", np.float64, _EACH),  # p_i
        ("driving", np.float64, _EACH),  # f_i
        ("right", np.float64, _EACH),  # y_i
        ("held", np.float64, _EACH),  # what holds the joints that stand
    ]
)
"""An arm, its state, and room to compute in: one value of a size that no number of joints changes."""

FlatArm = np.record


def flat_arm(parameters: ArmParameters, q: Vector) -> Any:
    """Return an arm at rest at q, brakes engaged, with nothing on its hand."""
    arm = np.zeros(1, FLAT_ARM).view(np.recarray)[0]
    n = arm.joints = parameters.joints
    arm.lag_s = parameters.amplifier_lag_s
    arm.coupling, arm.moment = couplings(parameters, 0.0)
    columns = {
        "rotor": parameters.rotor_inertia_kgm2,
        "viscosity": parameters.viscosity_Nms,
        "torque_constant": parameters.torque_constant_Nm_A,
        "ripple": parameters.ripple,
        "ripple_order": parameters.ripple_order,
        "q": q,
        "limit": [c + b for c, b in zip(parameters.coulomb_Nm, parameters.brake_torque_Nm, strict=True)],
    }
    for name, column in columns.items():
        arm[name][:n] = column
    return arm


def couplings(parameters: ArmParameters, payload_kg: float) -> tuple[Floats, Floats]:
    """Return A_ij and G_i with a payload on the hand."""
    values, n = constants(parameters, payload_kg), parameters.joints
    coupling, moment = np.zeros(_PAIR), np.zeros(_EACH)
    for i in range(n):
        moment[i] = values[f"G{i + 1}"]
        for j in range(i, n):
            coupling[i, j] = values[f"A{i + 1}{j + 1}"]
    return coupling, moment


def accelerate(arm: FlatArm, q: Floats, w: Floats, current: Floats, result: Floats) -> None:
    """Set result to q" of the free joints, and to 0.0 for those that stand; the terms stay in the arm."""
    n = arm.joints
    _set_inertia(arm, q)
    _set_bias(arm, q, w)
    for j in range(n):
        ripple = arm.ripple[j]
        factor = 1.0 + ripple * cos(arm.ripple_order[j] * q[j]) if ripple != 0.0 else 1.0
        arm.driving[j] = arm.torque_constant[j] * factor * current[j] + arm.constant[j]
    _solve(arm, w, result)


def _set_inertia(arm: FlatArm, q: Floats) -> None:
    """Set m_ij (i <= j), and S_ij = A_ij sin(t_j - t_i)."""
    n = arm.joints
    coupling, inertia = arm.coupling, arm.inertia
    for i in range(n - 1):
        angle = -0.0
        for j in range(i + 1, n):
            angle += q[j]
            arm.sine[i, j] = coupling[i, j] * sin(angle)
            arm.cosine[i, j] = coupling[i, j] * cos(angle)
    for i in range(n - 1, -1, -1):
        row = -0.0
        for j in range(n - 1, i, -1):
            row += arm.cosine[i, j]
            inertia[i, j] = inertia[i + 1, j] + row
        inertia[i, i] = coupling[i, i] if i == n - 1 else inertia[i, i + 1] + row + coupling[i, i]


def _set_bias(arm: FlatArm, q: Floats, w: Floats) -> None:
    """Set b_i to the joint torque of h and g; after `_set_inertia`."""
    n = arm.joints
    sine, squares, bias = arm.sine, arm.squares, arm.bias
    angle = speed = -0.0
    for i in range(n):
        angle += q[i]
        speed += w[i]
        squares[i] = speed * speed
        bias[i] = arm.moment[i] * cos(angle)
    beyond = -0.0
    for i in range(n - 1, -1, -1):
        torque = beyond + bias[i]
        for j in range(i):
            torque += sine[j, i] * squares[j]
        for j in range(i + 1, n):
            torque -= sine[i, j] * squares[j]
        bias[i] = beyond = torque


def _solve(arm: FlatArm, w: Floats, x: Floats) -> None:
    """Set x so that M x = f - D w - b over the free joints alone, by L D L^T."""
    for k in range(arm.joints):
        x[k] = 0.0
        if arm.modes[k] != 0:
            arm.right[k] = arm.driving[k] - arm.viscosity[k] * w[k] - arm.bias[k]
            _eliminate(arm, k)
    for k in range(arm.joints - 1, -1, -1):
        if arm.modes[k] == 0:
            continue
        value = arm.right[k] / arm.upper[k, k]
        for m in range(k + 1, arm.joints):
            if arm.modes[m] != 0:
                value -= arm.lower[m, k] * x[m]
        x[k] = value


def _eliminate(arm: FlatArm, k: int) -> None:
    """Take the free joints before joint k out of its row, and of its right side."""
    upper, lower = arm.upper, arm.lower
    for p in range(k):
        if arm.modes[p] != 0:
            arm.right[k] -= lower[k, p] * arm.right[p]
    for m in range(k, arm.joints):
        u = arm.inertia[k, k] + arm.rotor[k] if m == k else arm.inertia[k, m]
        for p in range(k):
            if arm.modes[p] != 0:
                u -= lower[k, p] * upper[p, m]
        upper[k, m] = u
        lower[m, k] = u / upper[k, k]


def balance(arm: FlatArm, q: Floats, w: Floats, current: Floats, result: Floats) -> None:
    """Set result as `accelerate` does, and arm.held to what holds the joints that stand, else 0.0."""
    accelerate(arm, q, w, current, result)
    for i in range(arm.joints):
        arm.held[i] = 0.0
        if arm.modes[i] != 0:
            continue
        needed = -0.0
        for j in range(arm.joints):
            if arm.modes[j] != 0:
                needed += arm.inertia[min(i, j), max(i, j)] * result[j]
        arm.held[i] = arm.driving[i] - (needed + arm.bias[i])


def copy(source: Floats, target: Floats) -> None:
    """Set target to source: a slice would do, and take Numba most of a second each to compile."""
    for j in range(len(target)):
        target[j] = source[j]


def current_after(arm: FlatArm, span_s: float, result: Floats) -> None:
    """Set result to the currents after span_s."""
    if arm.lag_s == 0.0:
        copy(arm.current, result)
        return
    left = exp(-span_s / arm.lag_s)
    for j in range(arm.joints):
        result[j] = arm.reference[j] + (arm.current[j] - arm.reference[j]) * left


def runge_kutta_step(arm: FlatArm, h: float) -> bool:
    """Set q_then, w_then to where the free joints are after h; return whether the step was calm, as in `rk4`."""
    n = arm.joints
    half, sixth = 0.5 * h, h / 6.0
    q, w, a = arm.q_then, arm.w_then, arm.slopes
    copy(arm.q, q)
    copy(arm.w, w)
    accelerate(arm, q, w, arm.current, a[0])
    current_after(arm, half, arm.current_then)
    for stage in range(1, 4):
        span = h if stage == 3 else half
        for i in range(n):
            if arm.modes[i] != 0:
                q[i] = arm.q[i] + span * w[i]  # w_i is still the speed of the stage before
                w[i] = arm.w[i] + span * a[stage - 1, i]
        if stage == 3:
            current_after(arm, h, arm.current_then)
        accelerate(arm, q, w, arm.current_then, a[stage])
    calm = True
    for i in range(n):
        if arm.modes[i] != 0:
            c = a[1, i] + a[2, i]
            q[i] = arm.q[i] + h * (arm.w[i] + sixth * (a[0, i] + c))
            w[i] = arm.w[i] + sixth * (a[0, i] + c + c + a[3, i])
            if not (q[i] - q[i] == 0.0 and w[i] - w[i] == 0.0):
                arm.lost = 1
            if arm.limit[i] > 0.0:
                s = arm.modes[i]
                calm = calm and w[i] * s > 0.0 and (arm.w[i] + h * a[0, i]) * s > 0.0
    return calm
