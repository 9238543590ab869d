"""Computed torque around a position controller: tau / Jn against the plant's closed form."""

import numpy as np
import pytest

from firmware_py.dsp.computed_torque import ComputedTorque
from firmware_py.dsp.control import CommandTable
from firmware_py.dsp.inverse_dynamics import ArmModel
from firmware_py.dsp.trajectory import Quintic
from plant.parameters import DEFAULT_ARM
from plant.rigid_body import RigidBody

START = (0.4, 0.9, -0.5)
JN = (1.344, 0.537, 0.0832)
T_NS, T_S = 1_000_000, 1e-3
CYCLES = 200


class Told:
    """A position controller that says what the test wants."""

    def __init__(self):
        self.asked = []
        self.answer = (0.0, 0.0, 0.0)

    def step(self, cycle, q):
        self.asked.append((cycle, q))
        return self.answer


@pytest.fixture
def law():
    arm = DEFAULT_ARM
    model = ArmModel(
        arm.length_m, arm.mass_kg, arm.rotor_inertia_kgm2, arm.viscosity_Nms, arm.coulomb_Nm, arm.gravity_m_s2
    )
    commands = CommandTable(Quintic(START, (0.5, -0.5, 0.0), 0.15), CYCLES, T_NS)
    return ComputedTorque(Told(), commands, START, model, JN)


def test_asks_the_position_controller_once_a_cycle(law):
    for cycle in range(5):
        law.step(cycle, START)
    assert law.control.asked == [(cycle, START) for cycle in range(5)]


def test_sends_the_torque_of_the_model_over_jn(law):
    """M a + h + g + D w with the mean speed of the last period, and the friction of the commanded direction."""
    rng = np.random.default_rng(3)
    body = RigidBody(DEFAULT_ARM)
    path = (np.array(START) + np.cumsum(rng.normal(0.0, 1e-3, (CYCLES, 3)), axis=0)).astype(np.float32).astype(float)
    before = np.array(START, dtype=np.float32).astype(float)
    for cycle, q in enumerate(path):
        law.control.answer = tuple(rng.uniform(-50.0, 50.0, 3))
        sent = law.step(cycle, tuple(q))
        w = tuple((q - before) / T_S)
        moving = 0 < cycle <= 150
        friction = np.array(DEFAULT_ARM.coulomb_Nm) * (1.0, -1.0, 0.0) * moving
        expected = (np.array(body.inverse_dynamics(tuple(q), w, law.control.answer)) + friction) / JN
        assert sent == pytest.approx(expected, rel=1e-10)
        before = q


def test_holds_the_arm_up_at_rest(law):
    rest = tuple(np.array(START, dtype=np.float32).astype(float))
    gravity = RigidBody(DEFAULT_ARM).terms(rest, (0.0, 0.0, 0.0))[2]
    assert np.array(law.step(0, rest)) * JN == pytest.approx(gravity, rel=1e-12)
