"""The arm with its tip near surfaces: its steps with their forces in every stage, and how long a substep may be.

Units: SI. Ref: `contact`.
"""

from math import sqrt

from plant.contact import Surface, Touch
from plant.kinematics import tip_jacobian
from plant.parameters import Vector
from plant.rigid_body import Balance, Joints, RigidBody, Step

LONGEST_S = 100e-6
_STABLE = 0.5
"""h sqrt(K / m) and h c / m at most, m being what spring and damper move: K h^2 stays below a quarter of it."""


class Touching:
    """A rigid body and the surfaces near its tip, as they are at the beginning of a substep."""

    def __init__(self, body: RigidBody, surfaces: tuple[Surface, ...]) -> None:
        self.body = body
        self.surfaces = surfaces
        self.moves = any(surface.speed_x_m_s != 0.0 or surface.speed_y_m_s != 0.0 for surface in surfaces)
        """Whether one of the surfaces moves."""
        self._touch = body.touch(len(surfaces))

    def step(self, free: Joints, watched: Joints) -> Step:
        """Return `RigidBody.step` with the contact's force in every stage."""
        step = self.body.touching_step(free, watched, len(self.surfaces))
        return lambda h, q, w, start, middle, end, e, modes: step(h, q, w, start, middle, end, e, modes, self.surfaces)

    def balance(self, free: Joints) -> Balance:
        """Return `RigidBody.balance` with the contact's force."""
        balance = self.body.touching_balance(free, len(self.surfaces))
        return lambda q, w, current, e: balance(q, w, current, e, self.surfaces)

    def elapse(self, span_s: float) -> None:
        """Let the surfaces move on."""
        if self.moves:
            self.surfaces = tuple([surface.after(span_s) for surface in self.surfaces])

    def after(self, span_s: float) -> "Touching":
        """Return what this will be span_s later."""
        return Touching(self.body, tuple([surface.after(span_s) for surface in self.surfaces]))

    def torque(self, q: Vector, w: Vector) -> Vector:
        """Return the joint torques of the contact, -r."""
        return self._touch(q, w, self.surfaces)[0]

    def touches(self, q: Vector, w: Vector) -> tuple[Touch, ...]:
        """Return how the tip meets each surface."""
        return tuple([Touch(*each) for each in self._touch(q, w, self.surfaces)[1]])

    def longest_s(self, q: Vector, w: Vector) -> float:
        """Return how long a substep may be: LONGEST_S, or less where a surface is stiff for what it moves."""
        tip_mobility = self._mobility(q)
        longest_s = LONGEST_S
        for surface, touch in zip(self.surfaces, self.touches(q, w), strict=True):
            mobility = tip_mobility + surface.mobility_1_kg
            rub_N_s_m = surface.friction * touch.normal_N / surface.sliding_speed_m_s
            fastest_1_s = max(
                sqrt(surface.stiffness_N_m * mobility), surface.damping_N_s_m * mobility, rub_N_s_m * mobility
            )
            longest_s = min(longest_s, _STABLE / fastest_1_s)
        return longest_s

    def _mobility(self, q: Vector) -> float:
        """Return an upper bound of the acceleration [m/s^2] of the tip by 1 N: the trace of Jac M^-1 Jac^T."""
        at_rest = (0.0,) * len(q)
        alone = self.body.acceleration(q, at_rest, at_rest)
        trace = 0.0
        for row in tip_jacobian(self.body.parameters, q):
            pushed = self.body.acceleration(q, at_rest, row)
            trace += sum([j * (a - b) for j, a, b in zip(row, pushed, alone, strict=True)])
        return trace
