"""Bad parameters are refused with the thing, the value, the limit and the cure."""

from dataclasses import FrozenInstanceError, replace
from math import inf, nan

import pytest

from plant.parameters import DEFAULT_ARM, ArmParameters, check_payload
from plant.rigid_body import RigidBody

ONE = (1.0,)


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("length_m", (), "length_m: 0 joints, but the arm has 1 to 6"),
        ("length_m", (0.1,) * 7, "length_m: 7 joints, but the arm has 1 to 6"),
        ("length_m", (0.3, 0.0, 0.1), "length_m of joint 2: 0.0, but it must be more than 0 and finite"),
        ("length_m", (0.3, 0.2, inf), "length_m of joint 3: inf"),
        ("mass_kg", (3.0, 1.5), "mass_kg: 2 values for 3 joints: give one a joint"),
        ("mass_kg", (3.0, -1.5, 1.0), "mass_kg of joint 2: -1.5, but it must be more than 0"),
        ("mass_kg", (nan, 1.5, 1.0), "mass_kg of joint 1: nan"),
        ("rotor_inertia_kgm2", (-1.0, 0.0, 0.0), "rotor_inertia_kgm2 of joint 1: -1.0, but it must be at least 0"),
        ("viscosity_Nms", (0.0, -0.1, 0.0), "viscosity_Nms of joint 2: -0.1, but it must be at least 0"),
        ("coulomb_Nm", (0.0, 0.0, -0.1), "coulomb_Nm of joint 3: -0.1, but it must be at least 0"),
        ("torque_constant_Nm_A", (0.0, 1.0, 1.0), "torque_constant_Nm_A of joint 1: 0.0, but it must be more than 0"),
        ("brake_torque_Nm", (-1.0, 1.0, 1.0), "brake_torque_Nm of joint 1: -1.0"),
        ("ripple", (0.0, 1.0, 0.0), "ripple of joint 2: 1.0, but it must be at least 0 and less than 1"),
        ("ripple", (0.0, 0.1), "ripple: 2 values for 3 joints"),
        ("ripple_order", (-1.0, 0.0, 0.0), "ripple_order of joint 1: -1.0"),
        ("counts_per_turn", 0, "counts_per_turn: 0, but it must be more than 0"),
        ("counts_per_turn", 1000.5, "counts_per_turn: 1000.5 is not a whole number: round it"),
        ("counter_bits", 0, "counter_bits: 0, but it must be at least 1 and less than 65"),
        ("counter_bits", 65, "counter_bits: 65"),
        ("current_limit_A", 0.0, "current_limit_A: 0.0, but it must be more than 0"),
        ("current_counts_per_A", nan, "current_counts_per_A: nan"),
        ("amplifier_lag_s", -1e-3, "amplifier_lag_s: -0.001, but it must be at least 0"),
        ("brake_delay_ns", -1, "brake_delay_ns: -1, but it must be at least 0"),
        ("brake_delay_ns", 0.5, "brake_delay_ns: 0.5 is not a whole number"),
        ("gravity_m_s2", inf, "gravity_m_s2: inf, but it must be at least 0 and finite"),
    ],
)
def test_bad_parameter_is_refused_by_name(field, value, message):
    with pytest.raises(ValueError) as error:  # noqa: PT011 (the message is compared below)
        replace(DEFAULT_ARM, **{field: value})
    assert str(error.value).startswith(message)


@pytest.mark.parametrize("mass_kg", [-0.1, nan, inf])
def test_bad_payload_is_refused(mass_kg):
    with pytest.raises(ValueError, match="payload mass_kg: "):
        check_payload(mass_kg)
    with pytest.raises(ValueError, match="payload mass_kg: "):
        RigidBody(DEFAULT_ARM, mass_kg)


def test_lists_become_tuples_and_ripple_defaults_to_none():
    arm = ArmParameters([0.3], [1.0], [0.0], [0.0], [0.0], [1.0], [0.0])
    assert arm.length_m == (0.3,)
    assert (arm.ripple, arm.ripple_order, arm.joints) == ((0.0,), (0.0,), 1)
    hash(arm)


def test_parameters_are_frozen():
    with pytest.raises(FrozenInstanceError):
        DEFAULT_ARM.gravity_m_s2 = 0.0
