"""M, h, g, q" and inverse dynamics against MuJoCo, and subsets of free joints against numpy."""

from random import Random

import mujoco
import numpy as np
import pytest

from plant.array_form import coriolis, gravity, inertia
from plant.parameters import DEFAULT_ARM
from plant.rigid_body import RigidBody

TOLERANCE = 1e-12  # relative to the largest entry where that is above 1
STATES = 200


def states(joints, seed=7):
    draw = Random(seed)
    for _ in range(STATES):
        yield tuple(tuple(draw.uniform(-reach, reach) for _ in range(joints)) for reach in (np.pi, 5.0, 20.0))


def off(got, expected):
    got, expected = np.asarray(got), np.asarray(expected)
    return np.abs(got - expected).max() / max(1.0, np.abs(expected).max())


def full_mass_matrix(model, data):
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    return M


@pytest.mark.parametrize("payload_kg", [0.0, 1.5])
@pytest.mark.parametrize("joints", [1, 2, 3, 4, 5, 6])
def test_terms_and_acceleration_agree_with_mujoco(joints, payload_kg, random_arm, mujoco_arm):
    arm = random_arm(joints, seed=joints)
    body = RigidBody(arm, payload_kg)
    model, data = mujoco_arm(arm, payload_kg)
    worst = dict.fromkeys(("M", "h", "g", "a", "inverse"), 0.0)
    for q, w, torque in states(joints):
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, 0.0, torque
        mujoco.mj_forward(model, data)
        g_expected = data.qfrc_bias.copy()
        data.qvel[:] = w
        mujoco.mj_forward(model, data)
        M, h, g = body.terms(q, w)
        worst["M"] = max(worst["M"], off(M, full_mass_matrix(model, data)))
        worst["g"] = max(worst["g"], off(g, g_expected))
        worst["h"] = max(worst["h"], off(h, data.qfrc_bias - g_expected))
        a = body.acceleration(q, w, torque)
        worst["a"] = max(worst["a"], off(a, data.qacc))
        worst["inverse"] = max(worst["inverse"], off(body.inverse_dynamics(q, w, a), torque))
    assert max(worst.values()) <= TOLERANCE, worst


@pytest.mark.parametrize("joints", [1, 2, 3, 6])
def test_array_form_agrees_with_scalars(joints, random_arm):
    arm = random_arm(joints, seed=20 + joints)
    rows = list(states(joints))
    q, w = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    payload = np.linspace(0.0, 3.0, len(rows))
    M, h, g = inertia(arm, q, payload), coriolis(arm, q, w, payload), gravity(arm, q, payload)
    for k, (angles, speeds, _) in enumerate(rows):
        scalar = RigidBody(arm, payload[k]).terms(angles, speeds)
        assert max(off(M[k], scalar[0]), off(h[k], scalar[1]), off(g[k], scalar[2])) <= TOLERANCE


@pytest.mark.parametrize("free", [(), (1,), (2,), (3,), (1, 2), (1, 3), (2, 3), (1, 2, 3)])
def test_joints_that_stand_leave_the_mass_matrix(free):
    body = RigidBody(DEFAULT_ARM, 1.0)
    here = [joint - 1 for joint in free]
    for q, w, torque in states(3):
        w = tuple(speed if j in here else 0.0 for j, speed in enumerate(w))
        M, h, g = map(np.array, body.terms(q, w))
        right = np.array(torque) - h - g - np.array(DEFAULT_ARM.viscosity_Nms) * w
        expected = np.zeros(3)
        if free:
            expected[here] = np.linalg.solve(M[np.ix_(here, here)], right[here])
        assert off(body.acceleration(q, w, torque, free), expected) <= TOLERANCE
        a, held = body.balance(free)(q, w, (0.0, 0.0, 0.0), torque)
        assert off(a, expected) <= TOLERANCE
        stands = [j for j in range(3) if j not in here]
        assert off(np.array(held)[stands], (right - M @ expected)[stands]) <= TOLERANCE if stands else held == (0, 0, 0)


def test_holding_torque_leaves_no_acceleration(frictionless):
    body = RigidBody(frictionless)
    zero = (0.0, 0.0, 0.0)
    worst = max(np.abs(body.acceleration(q, zero, body.terms(q, zero)[2])).max() for q, _, _ in states(3))
    assert worst <= 1e-12
