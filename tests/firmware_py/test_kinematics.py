"""Kinematics against the plant's, against numerical derivatives, and forth and back."""

from math import atan2, cos, inf, nextafter, pi, sin

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from firmware_py.dsp.kinematics import (
    SINGULAR_SIN,
    OutOfReach,
    SingularPoint,
    inverse,
    jacobian,
    jacobian_rate_times_speed,
    solve_jacobian,
    tip,
)
from plant import kinematics as truth
from plant.parameters import DEFAULT_ARM

LENGTHS = DEFAULT_ARM.length_m
angle = st.floats(-3 * pi, 3 * pi)
speed = st.floats(-5.0, 5.0)
pose = st.tuples(angle, angle, angle)
rates = st.tuples(speed, speed, speed)
lengths = st.tuples(*[st.floats(0.05, 1.0)] * 3)


def usable(q, least=SINGULAR_SIN):
    assume(abs(sin(q[1])) >= least + 1e-9)


@given(q=pose)
def test_tip_is_the_plants(q):
    assert tip(LENGTHS, q) == pytest.approx(truth.tip(DEFAULT_ARM, q), abs=1e-14)


@given(q=st.lists(angle, min_size=1, max_size=6))
def test_tip_of_any_number_of_joints(q):
    x, y, phi = tip([0.1] * len(q), q)
    theta = np.cumsum(q)
    assert (x, y, phi) == pytest.approx((0.1 * np.cos(theta).sum(), 0.1 * np.sin(theta).sum(), theta[-1]), abs=1e-12)


def test_one_length_for_each_angle():
    with pytest.raises(ValueError, match="one angle for each length"):
        tip(LENGTHS, (0.1, 0.2))


@given(q=pose, w=rates)
def test_jacobian_gives_the_plants_velocity(q, w):
    assert np.array(jacobian(LENGTHS, q)) @ w == pytest.approx(truth.tip_velocity(DEFAULT_ARM, q, w), abs=1e-12)


@given(lengths=lengths, q=pose)
def test_jacobian_is_the_derivative_of_tip(lengths, q):
    """Central difference, h = 1e-5: truncation 3 m h^2 / 6 and rounding 1e-15 / h, both below 1e-9."""
    h = 1e-5
    for column in range(3):
        step = h * np.eye(3)[column]
        slope = (np.array(tip(lengths, q + step)) - tip(lengths, q - step)) / (2 * h)
        assert np.array(jacobian(lengths, q))[:, column] == pytest.approx(slope, abs=1e-9)


@given(lengths=lengths, q=pose, w=rates)
def test_jacobian_rate_is_the_derivative_along_the_motion(lengths, q, w):
    """Central difference of Jac w, h = 1e-5 s: truncation 3 m (15 rad/s)^4 h^2 / 6, rounding 1e-14 / h."""
    h = 1e-5
    ahead, behind = (np.array(jacobian(lengths, np.array(q) + s * h * np.array(w))) @ w for s in (1, -1))
    assert jacobian_rate_times_speed(lengths, q, w) == pytest.approx((ahead - behind) / (2 * h), abs=1e-5)


@given(lengths=lengths, q=pose, v=rates)
def test_solve_jacobian_is_numpys(lengths, q, v):
    usable(q)
    matrix = np.array(jacobian(lengths, q))
    expected = np.linalg.solve(matrix, v)
    tolerance = 1e-14 * np.linalg.cond(matrix) * max(1.0, np.abs(expected).max())
    assert solve_jacobian(lengths, q, v) == pytest.approx(expected, abs=tolerance)


@given(q=pose, w=rates)
def test_solve_jacobian_undoes_the_plant(q, w):
    usable(q)
    assert solve_jacobian(LENGTHS, q, truth.tip_velocity(DEFAULT_ARM, q, w)) == pytest.approx(w, abs=1e-10)


EDGE = float(np.arcsin(SINGULAR_SIN))


@pytest.mark.parametrize("turn", [0.0, pi, -pi, 2 * pi])
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(("share", "refused"), [(0.0, True), (0.5, True), (0.999, True), (1.001, False), (3.0, False)])
def test_singular_points_are_refused(turn, side, share, refused):
    q = (0.3, turn + side * share * EDGE, -0.2)
    if not refused:
        assert len(solve_jacobian(LENGTHS, q, (0.1, 0.0, 0.0))) == 3
        return
    with pytest.raises(SingularPoint) as error:
        solve_jacobian(LENGTHS, q, (0.1, 0.0, 0.0))
    assert f"q2 = {q[1]:.4f} rad" in str(error.value)
    assert str(SINGULAR_SIN) in str(error.value)
    assert "keep the path away" in str(error.value)


@given(lengths=lengths, q=pose, away=st.tuples(*[st.floats(-0.02, 0.02)] * 3))
@example(lengths=LENGTHS, q=(3.2, 0.9, 4.0), away=(0.01, 0.01, 0.0))
@example(lengths=LENGTHS, q=(-3.2, -0.9, -4.0), away=(0.01, 0.01, 0.0))
@example(lengths=LENGTHS, q=(0.4, 2 * pi + 0.9, -0.5), away=(0.0, 0.0, 0.0))
def test_inverse_undoes_tip_on_both_elbow_sides_and_beyond_pi(lengths, q, away):
    """acos loses 1e-16 m^2 / (2 l1 l2 sin q2) at most: 1e-11 rad with the shortest links; 1e-9 leaves room."""
    usable(q)
    near = tuple(a + b for a, b in zip(q, away, strict=True))
    assert inverse(lengths, tip(lengths, q), near) == pytest.approx(q, abs=1e-9)


@given(q=pose)
def test_the_elbow_is_that_of_the_pose_near(q):
    usable(q)
    mirrored = (q[0], -q[1], q[2])
    found = inverse(LENGTHS, tip(LENGTHS, q), mirrored)
    assert sin(found[1]) == pytest.approx(-sin(q[1]), abs=1e-9)
    assert tip(LENGTHS, found) == pytest.approx(tip(LENGTHS, q), abs=1e-9)


@given(q=pose, turns=st.tuples(st.integers(-2, 2), st.integers(-2, 2)))
def test_inverse_keeps_the_turns_of_the_pose_near(q, turns):
    usable(q)
    near = (q[0] + 2 * pi * turns[0], q[1] + 2 * pi * turns[1], q[2])
    found = inverse(LENGTHS, tip(LENGTHS, q), near)
    assert found[:2] == pytest.approx(near[:2], abs=1e-9)
    assert sum(found) == pytest.approx(sum(q), abs=1e-12)


def test_a_path_that_goes_round_the_base_stays_continuous():
    q = (0.0, 0.9, -0.5)
    near = q
    for k in range(1, 3000):
        q = (k * 0.005, 0.9, -0.5)
        near = inverse(LENGTHS, tip(LENGTHS, q), near)
        assert near == pytest.approx(q, abs=1e-9)


@pytest.mark.parametrize(
    ("distance", "reached"),
    [(0.56, False), (0.5501, False), (0.5499, True), (0.3, True), (0.0501, True), (0.0499, False), (0.0, False)],
)
@pytest.mark.parametrize("direction", [0.0, 1.0, 3.0, -2.0])
def test_out_of_reach(distance, reached, direction):
    phi = 0.7
    x = (distance * cos(direction) + 0.15 * cos(phi), distance * sin(direction) + 0.15 * sin(phi), phi)
    if reached:
        q = inverse(LENGTHS, x, (0.0, 1.0, 0.0))
        assert tip(LENGTHS, q) == pytest.approx(x, abs=1e-12)
        return
    with pytest.raises(OutOfReach) as error:
        inverse(LENGTHS, x, (0.0, 1.0, 0.0))
    text = str(error.value)
    assert f"({x[0]:.4f} m, {x[1]:.4f} m, {phi:.4f} rad)" in text
    assert f"{distance:.4f} m from the base" in text
    assert "0.0500 to 0.5500 m" in text
    assert "move the path inside" in text


def test_stretched_arm_is_within_reach_or_refused_but_never_wrong():
    """At the limit of reach the cosine may round to either side of 1."""
    reach = 0.55
    for direction in np.linspace(-3.0, 3.0, 50):
        inside = nextafter(nextafter(reach, -inf), -inf)
        x = (inside * cos(direction) + 0.15, inside * sin(direction), 0.0)
        try:
            q = inverse(LENGTHS, x, (0.0, 0.1, 0.0))
        except OutOfReach:
            continue
        assert tip(LENGTHS, q) == pytest.approx(x, abs=1e-12)
        assert atan2(sin(q[1]), cos(q[1])) == pytest.approx(0.0, abs=1e-6)
