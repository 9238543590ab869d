"""Kinematics of the planar serial arm: tip (x, y, phi) from joint angles q, and back. Units: m, rad.

q_i is relative to link i-1, theta_i = q_1 + .. + q_i from the horizontal; phi is theta_n. Task space is the square
case, three joints. `tip`, `jacobian_rate_times_speed` and `regular_solution` are source that Numba takes, too.

Ref: the paper's eqs. (10)-(15); the inverse of the two-link arm by the law of cosines (any robotics textbook).
Not implemented: inverse kinematics of other than three joints (redundant, or fewer than the task needs).
"""

from collections.abc import Sequence
from math import acos, atan2, cos, hypot, pi, sin

Vector = tuple[float, ...]
Matrix = tuple[Vector, ...]

SINGULAR_SIN = 0.05
"""|sin q2| below which the arm counts as stretched or folded: there the joints turn 20 times as fast as usual."""


class OutOfReach(ValueError):
    """A tip position that no pose reaches."""


class SingularPoint(ValueError):
    """A pose at or near which the Jacobian has no inverse."""


def tip(lengths_m: Sequence[float], q: Sequence[float]) -> Vector:
    """Return (x, y, phi), eq. (10)."""
    if len(lengths_m) != len(q):
        raise ValueError("tip: give one angle for each length")
    x = y = theta = 0.0
    for n in range(len(lengths_m)):
        theta += q[n]
        x += lengths_m[n] * cos(theta)
        y += lengths_m[n] * sin(theta)
    return x, y, theta


def jacobian(lengths_m: Sequence[float], q: Sequence[float]) -> Matrix:
    """Return the 3 x 3 Jacobian of `tip`, eq. (11)."""
    l1, l2, l3 = lengths_m
    t1, t2, t3 = q[0], q[0] + q[1], q[0] + q[1] + q[2]
    s3, c3 = l3 * sin(t3), l3 * cos(t3)
    s2, c2 = s3 + l2 * sin(t2), c3 + l2 * cos(t2)
    s1, c1 = s2 + l1 * sin(t1), c2 + l1 * cos(t1)
    return (-s1, -s2, -s3), (c1, c2, c3), (1.0, 1.0, 1.0)


def jacobian_rate_times_speed(lengths_m: Sequence[float], q: Sequence[float], w: Sequence[float]) -> Vector:
    """Return Jac'(q, w) w, the acceleration of the tip that the speeds alone make, eq. (12)."""
    x = y = theta = rate = 0.0
    for n in range(len(lengths_m)):
        theta += q[n]
        rate += w[n]
        x -= lengths_m[n] * cos(theta) * rate * rate
        y -= lengths_m[n] * sin(theta) * rate * rate
    return x, y, 0.0


def solve_jacobian(lengths_m: Sequence[float], q: Sequence[float], v: Sequence[float]) -> Vector:
    """Return Jac(q)^-1 v for three joints, eqs. (14), (15), (21); raise SingularPoint."""
    if is_singular(q):
        raise SingularPoint(
            f"q2 = {q[1]:.4f} rad: |sin q2| is below {SINGULAR_SIN}, where the Jacobian has no usable inverse; "
            "keep the path away from the stretched and the folded arm"
        )
    return regular_solution(lengths_m, q, v)


def is_singular(q: Sequence[float]) -> bool:
    """Return whether a pose of three joints is at or near a singular one."""
    return abs(sin(q[1])) < SINGULAR_SIN


def regular_solution(lengths_m: Sequence[float], q: Sequence[float], v: Sequence[float]) -> Vector:
    """Return Jac(q)^-1 v for a pose that is not singular.

    Link 3 is taken off first: the wrist moves with v - phi' x l3, and its 2 x 2 Jacobian has determinant l1 l2 sin q2.
    """
    l1, l2, l3 = lengths_m
    t1, t2, t3 = q[0], q[0] + q[1], q[0] + q[1] + q[2]
    vx, vy = v[0] + l3 * sin(t3) * v[2], v[1] - l3 * cos(t3) * v[2]
    rate1 = (vx * cos(t2) + vy * sin(t2)) / (l1 * sin(q[1]))
    rate2 = -(vx * cos(t1) + vy * sin(t1)) / (l2 * sin(q[1]))
    return rate1, rate2 - rate1, v[2] - rate2


def inverse(lengths_m: Sequence[float], x: Sequence[float], near: Sequence[float]) -> Vector:
    """Return the pose of tip x = (x, y, phi) with the elbow, and the turns, of the pose `near`, eq. (13).

    Raises OutOfReach.
    """
    l1, l2, l3 = lengths_m
    wrist_x, wrist_y = x[0] - l3 * cos(x[2]), x[1] - l3 * sin(x[2])
    distance = hypot(wrist_x, wrist_y)
    cos_elbow = (distance**2 - l1**2 - l2**2) / (2 * l1 * l2)
    if abs(cos_elbow) > 1.0:
        raise OutOfReach(
            f"tip ({x[0]:.4f} m, {x[1]:.4f} m, {x[2]:.4f} rad) puts the wrist {distance:.4f} m from the base; "
            f"links 1 and 2 reach {abs(l1 - l2):.4f} to {l1 + l2:.4f} m: move the path inside"
        )
    elbow = acos(cos_elbow) if sin(near[1]) >= 0.0 else -acos(cos_elbow)
    shoulder = atan2(wrist_y, wrist_x) - atan2(l2 * sin(elbow), l1 + l2 * cos(elbow))
    q1, q2 = _same_turn(shoulder, near[0]), _same_turn(elbow, near[1])
    return q1, q2, x[2] - q1 - q2


def _same_turn(angle: float, near: float) -> float:
    return angle - 2 * pi * round((angle - near) / (2 * pi))
