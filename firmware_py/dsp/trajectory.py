"""Commands as functions of time: position, velocity and acceleration in joint or task space.

Before t = 0 a command is its start, after its end it stays there. Joint space in rad; task space (x, y, phi) in m and
rad.
"""

from collections.abc import Sequence
from math import cos, pi, sin
from typing import Protocol

from firmware_py.dsp import kinematics

Vector = tuple[float, ...]
Command = tuple[Vector, Vector, Vector]
"""(position, velocity, acceleration)"""


class Trajectory(Protocol):
    """What the DSP follows; at rest from time_s on."""

    @property
    def time_s(self) -> float:
        """When it ends."""

    def at(self, t_s: float) -> Command:
        """Return the command at t_s seconds after cycle 0."""


def quintic(phase: float) -> tuple[float, float, float]:
    """Return the quintic from 0 to 1, at rest at both ends, and its two derivatives by phase."""
    p = min(max(phase, 0.0), 1.0)
    value = p**3 * (10.0 - 15.0 * p + 6.0 * p * p)
    rate = 30.0 * (p * (1.0 - p)) ** 2
    return value, rate, 60.0 * p * (1.0 - p) * (1.0 - 2.0 * p)


class Quintic:
    """From `start` by `by` (any space) in time_s."""

    def __init__(self, start: Sequence[float], by: Sequence[float], time_s: float) -> None:
        self.start = tuple(start)
        self.by = tuple(by)
        self.time_s = time_s

    def at(self, t_s: float) -> Command:
        """Return the command at t_s."""
        value, rate, second = quintic(t_s / self.time_s)
        rate, second = rate / self.time_s, second / self.time_s**2
        position = tuple(x + value * dx for x, dx in zip(self.start, self.by, strict=True))
        return position, tuple(rate * dx for dx in self.by), tuple(second * dx for dx in self.by)


class Path:
    """Straight lines one after the other, each a `Quintic`, at rest between them; legs: (by, time_s) of each."""

    def __init__(self, start: Sequence[float], legs: Sequence[tuple[Sequence[float], float]]) -> None:
        self.legs: list[tuple[float, Quintic]] = []
        self.time_s = 0.0
        for by, leg_s in legs:
            leg = Quintic(start, by, leg_s)
            self.legs.append((self.time_s, leg))
            self.time_s += leg_s
            start = leg.at(leg_s)[0]

    def at(self, t_s: float) -> Command:
        """Return the command at t_s."""
        begins_s, leg = next((entry for entry in reversed(self.legs) if entry[0] <= t_s), self.legs[0])
        return leg.at(t_s - begins_s)


class Circle:
    """Once round in time_s, counter-clockwise from the tip, phi held; the centre lies at (x - radius, y)."""

    def __init__(self, start: Sequence[float], radius_m: float, time_s: float) -> None:
        self.start = tuple(start)
        self.radius_m = radius_m
        self.time_s = time_s

    def at(self, t_s: float) -> Command:
        """Return the command at t_s."""
        value, rate, second = quintic(t_s / self.time_s)
        angle, rate, second = 2 * pi * value, 2 * pi * rate / self.time_s, 2 * pi * second / self.time_s**2
        r, c, s = self.radius_m, cos(angle), sin(angle)
        x, y, phi = self.start
        return (
            (x + r * (c - 1.0), y + r * s, phi),
            (-r * s * rate, r * c * rate, 0.0),
            (-r * (s * second + c * rate**2), r * (c * second - s * rate**2), 0.0),
        )


class Transformed:
    """A task-space trajectory carried to joint space by inverse kinematics, eqs. (13)-(15); three joints.

    Raises kinematics.OutOfReach and kinematics.SingularPoint when a command cannot be followed.
    """

    def __init__(self, path: Trajectory, lengths_m: Sequence[float], start_rad: Sequence[float]) -> None:
        self.path = path
        self.lengths_m = tuple(lengths_m)
        self.near = tuple(start_rad)

    @property
    def time_s(self) -> float:
        """When it ends."""
        return self.path.time_s

    def at(self, t_s: float) -> Command:
        """Return the command at t_s; calls are to come in the order of time, for a path that passes pi."""
        x, v, a = self.path.at(t_s)
        q = kinematics.inverse(self.lengths_m, x, self.near)
        self.near = q
        w = kinematics.solve_jacobian(self.lengths_m, q, v)
        bias = kinematics.jacobian_rate_times_speed(self.lengths_m, q, w)
        return q, w, kinematics.solve_jacobian(self.lengths_m, q, [p - b for p, b in zip(a, bias, strict=True)])
