"""The DSP's inverse dynamics against the plant's closed form, which was derived another way."""

from dataclasses import replace
from random import Random

import numpy as np
import pytest

from firmware_py.dsp.inverse_dynamics import ArmModel, joint_torques
from plant.parameters import ArmParameters
from plant.rigid_body import RigidBody

TOLERANCE = 1e-12  # of the largest torque, where that is above 1 N m
STATES = 200


def random_pair(joints, payload_kg):
    """The same arm for both."""
    draw = Random(100 * joints)

    def column(low, high):
        return tuple(draw.uniform(low, high) for _ in range(joints))

    lengths, masses, rotors = column(0.1, 0.5), column(0.3, 4.0), column(0.0, 1.0)
    viscosity, coulomb, ones = column(0.0, 2.0), column(0.5, 4.0), (1.0,) * joints
    body = RigidBody(ArmParameters(lengths, masses, rotors, viscosity, coulomb, ones, ones), payload_kg)
    return ArmModel(lengths, masses, rotors, viscosity, coulomb, 9.80665, payload_kg), body


def states(joints):
    draw = Random(joints)
    for _ in range(STATES):
        yield tuple(tuple(draw.uniform(-reach, reach) for _ in range(joints)) for reach in (np.pi, 5.0, 20.0))


@pytest.mark.parametrize("payload_kg", [0.0, 1.5])
@pytest.mark.parametrize("joints", [1, 2, 3, 4, 5, 6])
def test_torques_are_the_plants_and_its_friction(joints, payload_kg):
    model, body = random_pair(joints, payload_kg)
    draw = Random(7)
    worst = 0.0
    for q, w, a in states(joints):
        w_cmd = [draw.choice((-0.3, 0.0, 1e-9)) for _ in range(joints)]
        expected = np.array(body.inverse_dynamics(q, w, a)) + np.array(model.coulomb_N_m) * np.sign(w_cmd)
        error = np.abs(np.array(joint_torques(model, q, w, a, w_cmd)) - expected).max()
        worst = max(worst, error / max(1.0, np.abs(expected).max()))
    assert worst <= TOLERANCE


def test_a_mass_at_rest_on_a_level_link_weighs_at_half_its_length():
    arm = ArmModel((0.4,), (3.0,), (0.7,), (2.0,), (5.0,), 10.0, 1.0)
    assert joint_torques(arm, (0.0,), (0.0,), (0.0,), (0.0,)) == pytest.approx([3.0 * 10.0 * 0.2 + 1.0 * 10.0 * 0.4])


def test_rotor_viscosity_and_friction_are_the_joints_own():
    """Upright, without gravity: m l^2 / 3 of the rod, then one term after the other."""
    arm = ArmModel((0.6,), (2.0,), (0.7,), (3.0,), (5.0,), 0.0)
    rod = 2.0 * 0.6**2 / 3

    def torque(w, a, w_cmd):
        (tau,) = joint_torques(arm, (1.2,), (w,), (a,), (w_cmd,))
        return tau

    assert torque(0.0, 4.0, 0.0) == pytest.approx((rod + 0.7) * 4.0)
    assert torque(-2.0, 0.0, 0.0) == pytest.approx(-6.0)
    assert [torque(1.0, 0.0, sign) - 3.0 for sign in (-0.1, 0.0, 0.1)] == pytest.approx([-5.0, 0.0, 5.0])


@pytest.mark.parametrize("scale", [0.8, 1.2])
def test_an_error_of_all_parameters_is_that_of_the_torque(scale):
    model, _ = random_pair(3, 0.0)
    names = ("masses_kg", "rotor_inertia_kg_m2", "viscosity_N_m_s", "coulomb_N_m")
    wrong = replace(model, **{name: tuple(scale * x for x in getattr(model, name)) for name in names})
    for q, w, a in states(3):
        true, believed = (np.array(joint_torques(arm, q, w, a, w)) for arm in (model, wrong))
        assert believed == pytest.approx(scale * true, rel=1e-12, abs=1e-12)
