"""The world around the arm: walls, a box to push, payloads to grasp; pymunk moves what is free to move.

The tip meets walls and box through `contact`; bodies meet walls and each other as rigid bodies, by pymunk's Coulomb
friction (its coefficient is that of the body against a wall, the product of both between bodies).
Units: SI; x horizontal, y up, the arm's base is the origin. Ref: r(q, f) of eq. (1); Chipmunk moves positions, then
velocities: a body that falls for t is g t h / 2 above the parabola, h being the substep (0.15 mm after 0.3 s).
Not modelled: contact of the links and of what the hand holds, restitution between bodies, the force of a grip.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, hypot, isfinite

import pymunk

from plant.contact import Compliance, Surface

SUBSTEP_S = 100e-6
ITERATIONS = 10
SLOP_M = 1e-5  # pymunk's own 0.1 is meant for pixels
_HALF_LENGTH_M = 50.0
_HALF_THICKNESS_M = 0.5

Point = tuple[float, float]


@dataclass(frozen=True)
class Wall:
    """A flat surface without end: the solid lies behind point_m, on the side that the normal (any length) leaves."""

    point_m: Point
    normal: Point
    compliance: Compliance

    def __post_init__(self) -> None:
        length = hypot(*self.normal)
        if not (isfinite(length) and length > 0.0):
            raise ValueError(f"normal: {self.normal} has no direction: give the one that leaves the wall")
        object.__setattr__(self, "normal", (self.normal[0] / length, self.normal[1] / length))

    def gap_m(self, x: float, y: float) -> float:
        """Return how far (x, y) lies in front of it."""
        return self.normal[0] * (x - self.point_m[0]) + self.normal[1] * (y - self.point_m[1])

    def surface(self) -> Surface:
        """Return it as the tip meets it."""
        return _surface(self.point_m, self.normal, (0.0, 0.0), self.compliance, 0.0)


@dataclass(frozen=True)
class Box:
    """A rectangle that can be pushed, upright at the beginning; compliance: towards the tip."""

    position_m: Point  # of its centre
    size_m: Point  # width and height
    mass_kg: float
    friction: float  # against walls
    compliance: Compliance


@dataclass(frozen=True)
class Payload:
    """A square that the hand can grasp; held, it is a point mass at the tip."""

    position_m: Point
    size_m: float
    mass_kg: float
    friction: float


class World:
    """Walls, at most one box, and payloads, all at rest."""

    def __init__(
        self,
        walls: Sequence[Wall] = (),
        box: Box | None = None,
        payloads: Sequence[Payload] = (),
        gravity_m_s2: float = 9.80665,
    ) -> None:
        self._space = pymunk.Space()
        self._space.gravity = 0.0, -gravity_m_s2
        self._space.iterations = ITERATIONS
        self._space.collision_slop = SLOP_M
        for wall in walls:
            self._space.add(_segment(self._space, wall))
        self._walls = [(f"wall{k}", wall, wall.surface()) for k, wall in enumerate(walls, start=1)]
        self._box = box
        self._bodies: dict[str, pymunk.Body] = {}
        self._shapes: dict[str, pymunk.Poly] = {}
        if box is not None:
            self._add("box", box.position_m, box.size_m, box.mass_kg, box.friction)
        self.payloads = tuple(payloads)
        for k, each in enumerate(payloads, start=1):
            size_m = each.size_m, each.size_m
            self._add(f"payload{k}", each.position_m, size_m, each.mass_kg, each.friction)
        self._held: set[str] = set()

    @property
    def surfaces(self) -> tuple[str, ...]:
        """The names of what the tip can touch."""
        return tuple(name for name, _, _ in self._walls) + (() if self._box is None else ("box",))

    @property
    def bodies(self) -> tuple[str, ...]:
        """The names of what can move."""
        return tuple(self._bodies)

    @property
    def held_kg(self) -> float:
        """Mass of the payloads in the hand."""
        return sum([each.mass_kg for k, each in enumerate(self.payloads, start=1) if f"payload{k}" in self._held])

    def near(self, x: float, y: float, within_m: float, soon_s: float = 0.0) -> dict[str, Surface]:
        """Return the surfaces that are closer than within_m to a tip at (x, y), or that it is in, as they are now.

        soon_s: also those that come so close within twice that time, at their speed.
        """
        found = {name: surface for name, wall, surface in self._walls if wall.gap_m(x, y) < within_m}
        box = self._box
        if box is not None:
            body = self._bodies["box"]
            centre = body.position
            edge_m_s = abs(body.angular_velocity) * hypot(*box.size_m) / 2
            within_m += 2.0 * soon_s * (hypot(*body.velocity) + edge_m_s)
            if hypot(x - centre.x, y - centre.y) < hypot(*box.size_m) / 2 + within_m:
                surface = self._side(box, x, y, within_m)
                if surface is not None:
                    found["box"] = surface
        return found

    def push(self, name: str, x: float, y: float, force_x_N: float, force_y_N: float) -> None:
        """Let a force act at (x, y) during the next substep on what has that surface; a wall takes it."""
        if name in self._bodies:
            self._bodies[name].apply_force_at_world_point((force_x_N, force_y_N), (x, y))

    def advance(self, span_s: float) -> None:
        """Move the bodies by span_s, in substeps of SUBSTEP_S at most."""
        if len(self._held) == len(self._bodies):
            return
        parts = ceil(span_s / SUBSTEP_S * (1.0 - 1e-12))
        for _ in range(parts):
            self._space.step(span_s / parts)

    def grasp(self, payload: int, x: float, y: float) -> bool:
        """Take a payload (from 0) into a hand at (x, y); False if it lies farther from its centre than its size."""
        name = f"payload{payload + 1}"
        centre = self._bodies[name].position
        if hypot(x - centre.x, y - centre.y) > self.payloads[payload].size_m:
            return False
        self._space.remove(self._shapes[name], self._bodies[name])
        self._held.add(name)
        return True

    def drop(self, payload: int, x: float, y: float, speed_x_m_s: float, speed_y_m_s: float) -> bool:
        """Let go of a payload where the hand is and as fast as it moves; False if it holds none."""
        name = f"payload{payload + 1}"
        if name not in self._held:
            return False
        self._held.remove(name)
        body = self._bodies[name]
        body.position, body.velocity = (x, y), (speed_x_m_s, speed_y_m_s)
        self._space.add(body, self._shapes[name])
        return True

    def place(self, name: str, x: float, y: float) -> tuple[float, float, float]:
        """Return a body's centre and angle (x, y, rad), with the tip at (x, y)."""
        body = self._bodies[name]
        centre = (x, y) if name in self._held else body.position
        return centre[0], centre[1], body.angle

    def _add(self, name: str, position_m: Point, size_m: Point, mass_kg: float, friction: float) -> None:
        body = pymunk.Body(mass_kg, pymunk.moment_for_box(mass_kg, size_m))
        body.position = position_m
        shape = pymunk.Poly.create_box(body, size_m)
        shape.friction = friction
        self._space.add(body, shape)
        self._bodies[name], self._shapes[name] = body, shape

    def _side(self, box: Box, x: float, y: float, within_m: float) -> Surface | None:
        """Return the side or corner of the box that is nearest to the tip."""
        nearest = self._shapes["box"].point_query((x, y))
        if nearest.distance >= within_m:
            return None
        velocity = self._bodies["box"].velocity_at_world_point(nearest.point)
        # at its edge a box feels four times as light as at its centre, at most
        return _surface(nearest.point, nearest.gradient, velocity, box.compliance, 4.0 / box.mass_kg)


def _segment(space: pymunk.Space, wall: Wall) -> pymunk.Segment:
    """Return the wall as bodies meet it: a thick bar, its outer face in the wall's plane."""
    (x, y), (nx, ny) = wall.point_m, wall.normal
    x, y = x - nx * _HALF_THICKNESS_M, y - ny * _HALF_THICKNESS_M
    reach_x, reach_y = -ny * _HALF_LENGTH_M, nx * _HALF_LENGTH_M
    ends = (x - reach_x, y - reach_y), (x + reach_x, y + reach_y)
    segment = pymunk.Segment(space.static_body, *ends, _HALF_THICKNESS_M)
    segment.friction = 1.0
    return segment


def _surface(point: Point, normal: Point, velocity: Point, compliance: Compliance, mobility_1_kg: float) -> Surface:
    return Surface(
        point[0],
        point[1],
        normal[0],
        normal[1],
        velocity[0],
        velocity[1],
        compliance.stiffness_N_m,
        compliance.damping_N_s_m,
        compliance.friction,
        compliance.sliding_speed_m_s,
        mobility_1_kg,
    )
