"""Nominal inertia against the scenario's numbers, closed forms and random poses."""

import numpy as np
import pytest

from plant.nominal import nominal_inertia
from plant.parameters import DEFAULT_ARM
from plant.rigid_body import RigidBody


def felt(arm, poses):
    terms, zero = RigidBody(arm).terms, (0.0,) * arm.joints
    return np.min([1.0 / np.diag(np.linalg.inv(terms(tuple(q), zero)[0])) for q in poses], axis=0)


def test_default_arm_has_the_designs_nominal_inertia():
    assert nominal_inertia(DEFAULT_ARM) == pytest.approx((1.344, 0.537, 0.0832), abs=5e-4)


def test_one_joint_has_its_own_inertia(one_joint):
    assert nominal_inertia(one_joint()) == pytest.approx((0.5 + 1 / 3,), rel=1e-15)


def test_two_joints_agree_with_a_fine_sweep(random_arm):
    arm = random_arm(2, 3)
    sweep = felt(arm, [(0.0, angle) for angle in np.linspace(-np.pi, np.pi, 10_001)])
    assert nominal_inertia(arm) == pytest.approx(sweep, rel=1e-7)
    assert (np.array(nominal_inertia(arm)) <= sweep * (1 + 1e-14)).all()


@pytest.mark.parametrize("joints", [3, 4])
def test_no_pose_has_less(joints, random_arm):
    arm = random_arm(joints, 60 + joints)
    poses = np.random.default_rng(1).uniform(-np.pi, np.pi, (1000, joints))
    least = felt(arm, poses)
    found = np.array(nominal_inertia(arm))
    assert (found <= least * (1 + 1e-12)).all()
    assert (found > 0.8 * least).all()
