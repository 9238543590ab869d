"""The choice of modes at standstill against the convex problem that it solves."""

from math import inf
from random import Random

import numpy as np
import pytest

from plant.friction import modes_of, release_margin


def dense_balance(M, torque, limit):
    """balance() of a linear system M a = torque - s c."""

    def balance(modes):
        free = [j for j, s in enumerate(modes) if s]
        a = np.zeros(len(modes))
        if free:
            right = torque - np.array(modes) * limit
            a[free] = np.linalg.solve(M[np.ix_(free, free)], right[free])
        return tuple(a), tuple(torque - M @ a)

    return balance


def by_descent(M, torque, limit):
    """The minimiser of a' M a / 2 - torque' a + sum limit |a| by coordinate descent."""
    a = np.zeros(len(torque))
    for _ in range(3000):
        for j in range(len(a)):
            rest = torque[j] - M[j] @ a + M[j, j] * a[j]
            a[j] = np.sign(rest) * max(0.0, abs(rest) - limit[j]) / M[j, j]
    return a


@pytest.mark.parametrize("joints", [1, 2, 3, 4])
def test_modes_are_those_of_the_convex_problem(joints):
    rng = np.random.default_rng(joints)
    for _ in range(20):
        root = rng.normal(size=(joints, joints))
        M = root @ root.T + 0.1 * np.eye(joints)
        torque, limit = rng.uniform(-3, 3, joints), rng.uniform(0.1, 2, joints)
        balance = dense_balance(M, torque, limit)
        modes = modes_of((0.0,) * joints, tuple(limit), balance)
        expected = by_descent(M, torque, limit)
        assert np.allclose(balance(modes)[0], expected, atol=1e-8)
        assert modes == tuple(np.sign(np.where(np.abs(expected) > 1e-9, expected, 0.0)).astype(int))


def test_joints_that_turn_keep_their_direction_without_being_asked():
    assert modes_of((0.1, -2.0), (1.0, 1.0), lambda _: pytest.fail("balance asked for")) == (1, -1)


def test_joint_without_friction_never_stands():
    assert modes_of((0.0, -1.0), (0.0, 1.0), lambda _: ((0.0, 0.0), (0.0, 0.0))) == (1, -1)


def test_least_contradiction_wins_if_rounding_leaves_no_solution():
    answers = {0: ((0.0,), (1.1,)), 1: ((-0.01,), (0.0,)), -1: ((0.5,), (0.0,))}
    assert modes_of((0.0,), (1.0,), lambda modes: answers[modes[0]]) == (1,)


def test_release_margin_is_that_of_the_weakest_standing_joint():
    draw = Random(1)
    limit = tuple(draw.uniform(1, 2) for _ in range(3))
    assert release_margin((1, -1, 1), limit, (0.0, 0.0, 0.0)) == inf
    assert release_margin((0, 1, 0), limit, (0.0, 9.0, -0.9)) == pytest.approx(min(limit[0], limit[2] - 0.9))
