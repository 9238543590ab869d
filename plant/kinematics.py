"""Where the hand is: direct kinematics of the planar arm, for whatever touches the tip.

Units: m, rad, m/s, rad/s; (x, y, phi), phi the direction of the last link. Ref: eqs. (10) and (11).
Angles are relative, the base is the origin, x horizontal, y up. Not here: inverse kinematics (the DSP's).
"""

from math import cos, sin

from plant.parameters import ArmParameters, Vector

Planar = tuple[float, float, float]


def tip(parameters: ArmParameters, q: Vector) -> Planar:
    """Return (x, y, phi) at q."""
    x = y = phi = 0.0
    for length, angle in zip(parameters.length_m, q, strict=True):
        phi += angle
        x += length * cos(phi)
        y += length * sin(phi)
    return x, y, phi


def tip_velocity(parameters: ArmParameters, q: Vector, w: Vector) -> Planar:
    """Return (x', y', phi') at q, w."""
    vx = vy = phi = speed = 0.0
    for length, angle, rate in zip(parameters.length_m, q, w, strict=True):
        phi += angle
        speed += rate
        vx -= length * sin(phi) * speed
        vy += length * cos(phi) * speed
    return vx, vy, speed


def tip_jacobian(parameters: ArmParameters, q: Vector) -> tuple[Vector, Vector]:
    """Return the rows of Jac at q for x and y: the tip's velocity (m/s) by each joint's speed (rad/s)."""
    points = joint_points(parameters.length_m, q)
    x, y = points[-1]
    return tuple([joint_y - y for _, joint_y in points[:-1]]), tuple([x - joint_x for joint_x, _ in points[:-1]])


def joint_points(length_m: Vector, q: Vector) -> list[tuple[float, float]]:
    """Return (x, y) of every joint and of the tip at q, for links of length_m; joint 1 is the origin."""
    x = y = phi = 0.0
    points = [(x, y)]
    for length, angle in zip(length_m, q, strict=True):
        phi += angle
        x += length * cos(phi)
        y += length * sin(phi)
        points.append((x, y))
    return points
