"""The terms of eq. (4) add up to what eq. (3) measures."""

from dataclasses import replace

import numpy as np
import pytest

from plant.disturbance import disturbance_terms
from plant.nominal import nominal_inertia
from plant.parameters import DEFAULT_ARM
from plant.robot import Robot

MS = 1_000_000
ARM = replace(DEFAULT_ARM, ripple=(0.01, 0.02, 0.03), ripple_order=(6.0, 5.0, 4.0), amplifier_lag_s=5e-4)


@pytest.fixture(scope="module")
def record():
    """400 ms with reversals, joints that stand, a payload, torque from outside, and brakes at the end."""
    robot = Robot(ARM, (0.4, 0.9, -0.5))
    robot.release_brakes(0)
    robot.set_payload(2.0, 150 * MS)
    robot.set_external_torque(1, -5.0, 250 * MS)
    robot.engage_brakes(330 * MS)
    rows = {name: [] for name in ("q", "w", "acceleration", "current_A", "friction_Nm", "payload_kg", "external_Nm")}
    for k in range(400):
        for joint, mean_A in ((1, 1.8), (2, 0.9), (3, 0.3)):
            robot.set_current(joint, int(2048 * mean_A * (1 + 1.5 * np.sin(0.06 * k + joint))), k * MS + 500_000)
        robot.advance_to((k + 1) * MS)
        row = (robot.q, robot.w, robot.acceleration(), robot.current_A, robot.friction(), robot.payload_kg)
        for values, value in zip(rows.values(), (*row, robot.external_Nm), strict=True):
            values.append(value)
    return {name: np.array(values) for name, values in rows.items()}


def test_terms_add_up_to_nominal_torque_minus_nominal_inertia(record):
    Jn, Ktn = nominal_inertia(ARM), (9.0, 6.5, 2.0)
    terms = disturbance_terms(ARM, Jn=Jn, Ktn=Ktn, **record)
    measured = np.array(Ktn) * record["current_A"] - np.array(Jn) * record["acceleration"]
    assert (record["w"] == 0.0).any(axis=0).all()
    assert np.abs(terms.total() - measured).max() <= 1e-12 * np.abs(measured).max()


def test_each_term_is_what_its_name_says(record):
    terms = disturbance_terms(ARM, Jn=(0.0,) * 3, Ktn=ARM.torque_constant_Nm_A, **record)
    assert np.array_equal(terms.friction, record["friction_Nm"])
    assert np.array_equal(terms.reaction, -record["external_Nm"])
    assert np.array_equal(terms.viscous, record["w"] * ARM.viscosity_Nms)
    assert np.allclose(
        terms.ripple[:, 2], -0.06 * np.cos(4.0 * record["q"][:, 2]) * record["current_A"][:, 2], atol=1e-15
    )
    without_payload = disturbance_terms(ARM, Jn=(0.0,) * 3, Ktn=(1.0,) * 3, **(record | {"payload_kg": 0.0}))
    assert np.array_equal(without_payload.gravity[:149], terms.gravity[:149])
    assert (np.abs(without_payload.gravity - terms.gravity)[149:].max(axis=1) > 1.0).all()


def test_torque_from_outside_may_be_left_out(record):
    record = {name: values for name, values in record.items() if name != "external_Nm"}
    assert not disturbance_terms(ARM, Jn=(1.0,) * 3, Ktn=(1.0,) * 3, **record).reaction.any()


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("w", np.zeros((400, 2)), r"w: shape \(400, 2\), but q has 400 rows and the arm 3 joints"),
        ("current_A", np.zeros((10, 3)), r"current_A: shape \(10, 3\)"),
        ("payload_kg", np.zeros(7), r"payload_kg: shape \(7,\) for 400 recorded rows"),
        ("payload_kg", -1.0, r"payload mass_kg: -1\.0"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(record, name, value, message):
    with pytest.raises(ValueError, match=message):
        disturbance_terms(ARM, Jn=(1.0,) * 3, Ktn=(1.0,) * 3, **(record | {name: value}))
