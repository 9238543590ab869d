"""Direct kinematics against complex numbers and differences."""

from cmath import exp
from random import Random

import numpy as np
import pytest

from plant.array_form import tip_velocities, tips
from plant.kinematics import tip, tip_velocity
from plant.parameters import DEFAULT_ARM


def poses(joints):
    draw = Random(2)
    return [tuple(draw.uniform(-np.pi, np.pi) for _ in range(joints)) for _ in range(50)]


def test_known_poses():
    assert tip(DEFAULT_ARM, (0.0, 0.0, 0.0)) == pytest.approx((0.7, 0.0, 0.0), abs=1e-15)
    assert tip(DEFAULT_ARM, (np.pi / 2, -np.pi / 2, 0.0)) == pytest.approx((0.4, 0.3, 0.0), abs=1e-15)


@pytest.mark.parametrize("joints", [1, 3, 6])
def test_tip_is_a_sum_of_turned_links(joints, random_arm):
    arm = random_arm(joints, 1)
    for q in poses(joints):
        expected = sum(length * exp(1j * angle) for length, angle in zip(arm.length_m, np.cumsum(q), strict=True))
        assert tip(arm, q) == pytest.approx((expected.real, expected.imag, sum(q)), abs=1e-13)


def test_velocity_is_the_derivative_of_the_tip():
    w, h = np.array((1.0, -2.0, 3.0)), 1e-6
    for q in poses(3):
        ahead, behind = (np.array(tip(DEFAULT_ARM, tuple(q + sign * h * w))) for sign in (1, -1))
        assert tip_velocity(DEFAULT_ARM, q, tuple(w)) == pytest.approx((ahead - behind) / (2 * h), abs=1e-8)


def test_arrays_agree_with_scalars():
    q, w = np.array(poses(3)), np.array(poses(3))[::-1]
    assert np.allclose(tips(DEFAULT_ARM, q), [tip(DEFAULT_ARM, tuple(row)) for row in q], atol=1e-14)
    expected = [tip_velocity(DEFAULT_ARM, tuple(a), tuple(b)) for a, b in zip(q, w, strict=True)]
    assert np.allclose(tip_velocities(DEFAULT_ARM, q, w), expected, atol=1e-14)
