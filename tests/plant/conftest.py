"""Arms to test with, and the oracle MuJoCo built from their parameters."""

from collections.abc import Callable
from dataclasses import replace
from random import Random

import mujoco
import pytest

from plant.parameters import DEFAULT_ARM, ArmParameters
from tests.plant.arms import arm_by_chance


def _random_arm(joints: int, seed: int) -> ArmParameters:
    return arm_by_chance(Random(seed), joints)


def _mjcf(arm: ArmParameters, payload_kg: float, step_s: float) -> str:
    # only the inertia about z counts in the plane; a point mass needs some inertia of its own to be accepted
    point = f'<inertial pos="0 0 0" mass="{payload_kg!r}" diaginertia="1e-15 1e-15 1e-15"/>'
    bodies = f'<body pos="{arm.length_m[-1]!r} 0 0">{point}</body>' if payload_kg else ""
    for j in reversed(range(arm.joints)):
        length, mass = arm.length_m[j], arm.mass_kg[j]
        moment = mass * length**2 / 12
        rotor, viscosity = arm.rotor_inertia_kgm2[j], arm.viscosity_Nms[j]
        start = arm.length_m[j - 1] if j else 0.0
        bodies = f"""<body pos="{start!r} 0 0">
            <joint type="hinge" axis="0 0 1" armature="{rotor!r}" damping="{viscosity!r}"/>
            <inertial pos="{length / 2!r} 0 0" mass="{mass!r}" diaginertia="{moment!r} {moment!r} {moment!r}"/>
            {bodies}</body>"""
    return f"""<mujoco><option gravity="0 {-arm.gravity_m_s2!r} 0" integrator="RK4" timestep="{step_s!r}"/>
        <worldbody>{bodies}</worldbody></mujoco>"""


def _mujoco_arm(
    arm: ArmParameters, payload_kg: float = 0.0, step_s: float = 1e-3
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(_mjcf(arm, payload_kg, step_s))
    return model, mujoco.MjData(model)


@pytest.fixture
def random_arm() -> Callable[[int, int], ArmParameters]:
    """(joints, seed) -> an arm with everything but ripple and lag."""
    return _random_arm


@pytest.fixture
def mujoco_arm() -> Callable[..., tuple[mujoco.MjModel, mujoco.MjData]]:
    """(arm, payload_kg, step_s) -> MuJoCo's model and data of it."""
    return _mujoco_arm


@pytest.fixture
def frictionless() -> ArmParameters:
    """The default arm without Coulomb friction, viscosity and brakes."""
    zero = (0.0, 0.0, 0.0)
    return replace(DEFAULT_ARM, coulomb_Nm=zero, viscosity_Nms=zero, brake_torque_Nm=zero)


@pytest.fixture
def one_joint() -> Callable[..., ArmParameters]:
    """A single joint on a horizontal axis plane (no gravity): J = 0.5 + 1/3 kg m^2, Kt = 2 N m/A, no viscosity."""

    def build(**changes: object) -> ArmParameters:
        column = (0.0,)
        arm = ArmParameters(
            (1.0,), (1.0,), (0.5,), column, (1.5,), (2.0,), column, gravity_m_s2=0.0, counts_per_turn=1 << 20
        )
        return replace(arm, **changes)  # type: ignore[arg-type]

    return build
