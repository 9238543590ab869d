"""Inverse dynamics of the planar serial arm that the DSP believes in: recursive Newton-Euler in the plane.

From the base out, the acceleration of every link; from the hand back, the force and the moment at every joint. Axes x
and y are those of the base, so nothing has to be rotated. Units: SI. Ref: the paper's eq. (1), table 1 (the rival).
Not modelled: links other than uniform rods, torque ripple, static friction.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import copysign, cos, sin


@dataclass(frozen=True)
class ArmModel:
    """An arm in the vertical plane, one entry a joint, base first; payload_kg is a point mass at the tip."""

    lengths_m: tuple[float, ...]
    masses_kg: tuple[float, ...]
    rotor_inertia_kg_m2: tuple[float, ...]
    viscosity_N_m_s: tuple[float, ...]
    coulomb_N_m: tuple[float, ...]
    gravity_m_s2: float
    payload_kg: float = 0.0


@dataclass(frozen=True)
class _Motion:
    """A link in motion: its direction, and the force (N) that its mass and the moment (N m) that its inertia take."""

    cos: float
    sin: float
    force_x: float
    force_y: float
    moment: float


def joint_torques(
    arm: ArmModel, q: Sequence[float], w: Sequence[float], a: Sequence[float], w_cmd: Sequence[float]
) -> list[float]:
    """Return M(q) a + h(q, w) + g(q) + D w + c sign(w_cmd) of each joint, N m; rad, rad/s, rad/s^2."""
    links, tip_x, tip_y = _outward(arm, q, w, a)
    torques = _inward(arm, links, arm.payload_kg * tip_x, arm.payload_kg * tip_y)
    own = zip(arm.rotor_inertia_kg_m2, arm.viscosity_N_m_s, arm.coulomb_N_m, a, w, w_cmd, strict=True)
    for joint, (rotor, viscosity, coulomb, second, rate, commanded) in enumerate(own):
        torques[joint] += rotor * second + viscosity * rate + (copysign(coulomb, commanded) if commanded else 0.0)
    return torques


def _outward(
    arm: ArmModel, q: Sequence[float], w: Sequence[float], a: Sequence[float]
) -> tuple[list[_Motion], float, float]:
    """Return every link's motion and the tip's acceleration; gravity is a base that accelerates upwards."""
    links = []
    angle = speed = acceleration = x = 0.0
    y = arm.gravity_m_s2
    for length, mass, dq, dw, da in zip(arm.lengths_m, arm.masses_kg, q, w, a, strict=True):
        angle, speed, acceleration = angle + dq, speed + dw, acceleration + da
        c, s = cos(angle), sin(angle)
        along_x = -length * (acceleration * s + speed * speed * c)
        along_y = length * (acceleration * c - speed * speed * s)
        moment = mass * length * length / 12.0 * acceleration
        links.append(_Motion(c, s, mass * (x + along_x / 2.0), mass * (y + along_y / 2.0), moment))
        x, y = x + along_x, y + along_y
    return links, x, y


def _inward(arm: ArmModel, links: Sequence[_Motion], force_x: float, force_y: float) -> list[float]:
    """Return the moment about every joint, from the force that the hand takes."""
    moments = []
    moment = 0.0
    for length, link in zip(reversed(arm.lengths_m), reversed(links), strict=True):
        lever_x, lever_y = length * link.cos, length * link.sin
        moment += link.moment + lever_x * force_y - lever_y * force_x
        moment += (lever_x * link.force_y - lever_y * link.force_x) / 2.0
        force_x, force_y = force_x + link.force_x, force_y + link.force_y
        moments.append(moment)
    return moments[::-1]
