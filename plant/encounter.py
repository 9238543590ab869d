"""The arm and the world, moved together: short steps near a surface, the usual ones elsewhere, forces on both sides.

A substep moves the arm against surfaces that keep their velocity; then what it touches feels the force of the
substep's end, which is how pymunk stays stable (semi-implicit Euler): what arm and body exchange differs by half a
substep's change of force while they touch, and by nothing once they have parted.
Units: SI. Ref: `contact`, `world`.
"""

from math import ceil, hypot
from typing import TYPE_CHECKING

from plant.contact import NOT_TOUCHING, Surface, Touch
from plant.kinematics import tip, tip_velocity
from plant.motion import Motion
from plant.parameters import Vector
from plant.rigid_body import RigidBody
from plant.stick_slip import StickSlip
from plant.touching import Touching

if TYPE_CHECKING:
    from plant.world import World

CLEARANCE_M = 1e-3
"""Beside the way that the tip makes at twice its speed: 1 mm within 1 ms takes 2000 m/s^2."""


class Encounter:
    """An arm in a world; a surface is looked for every horizon_s at least."""

    def __init__(self, world: "World", motion: StickSlip, body: RigidBody, horizon_s: float) -> None:
        self.world = world
        self._motion = motion
        self._body = body
        self._horizon_s = horizon_s
        self._since_s = 0.0
        self._near: dict[str, Surface] = {}
        self._touching: Touching | None = None
        self.meet()

    def advance(self, span_s: float) -> None:
        """Move arm and world by span_s, at most the horizon."""
        if self._since_s + span_s > self._horizon_s:
            self.meet()
        self._since_s += span_s
        if self._touching is None:
            self._motion.advance(span_s)
            self.world.advance(span_s)
            return
        parts = ceil(span_s / self._touching.longest_s(self._motion.q, self._motion.w))
        for _ in range(parts):
            self._motion.advance(span_s / parts)
            if self.world.bodies:
                self._push()
                self.world.advance(span_s / parts)
                self.meet()

    def prepare(self) -> None:
        """Do now what would otherwise be done at the first use, for one surface at a time."""
        self._motion.prepare(surfaces=1)

    def change(self, body: RigidBody) -> None:
        """Let the arm be another body, with what it holds."""
        self._body = body
        self._touch_what_is_near()

    def meet(self) -> None:
        """Find what the tip may touch within the horizon."""
        self._motion.arrive()
        self._since_s = 0.0
        x, y, _ = tip(self._body.parameters, self._motion.q)
        speed_x, speed_y, _ = tip_velocity(self._body.parameters, self._motion.q, self._motion.w)
        within_m = CLEARANCE_M + 2.0 * hypot(speed_x, speed_y) * self._horizon_s
        near = self.world.near(x, y, within_m, self._horizon_s)
        if near != self._near:
            self._near = near
            self._touch_what_is_near()

    def grasp(self, payload: int) -> bool:
        """Take a payload (from 0) if the hand is there; return whether it holds it."""
        self._motion.arrive()
        x, y, _ = tip(self._body.parameters, self._motion.q)
        return self.world.grasp(payload, x, y)

    def drop(self, payload: int) -> bool:
        """Let go of a payload; return whether it was held."""
        self._motion.arrive()
        q, w = self._motion.q, self._motion.w
        x, y, _ = tip(self._body.parameters, q)
        speed_x, speed_y, _ = tip_velocity(self._body.parameters, q, w)
        return self.world.drop(payload, x, y, speed_x, speed_y)

    def torque(self) -> Vector:
        """Return the joint torques of the contact [N m], -r, at this instant."""
        if self._touching is None:
            return (0.0,) * self._body.parameters.joints
        return self._touching.torque(self._motion.q, self._motion.w)

    def touches(self) -> dict[str, Touch]:
        """Return how the tip meets every surface of the world at this instant."""
        found = dict.fromkeys(self.world.surfaces, NOT_TOUCHING)
        if self._touching is not None:
            found |= zip(self._near, self._touching.touches(self._motion.q, self._motion.w), strict=True)
        return found

    def places(self) -> dict[str, tuple[float, float, float]]:
        """Return where every body is: (x, y, angle)."""
        x, y, _ = tip(self._body.parameters, self._motion.q)
        return {name: self.world.place(name, x, y) for name in self.world.bodies}

    def _touch_what_is_near(self) -> None:
        self._touching = Touching(self._body, tuple(self._near.values())) if self._near else None
        self._motion.change(body=self._touching or self._body)

    def _push(self) -> None:
        """Let what the tip touches feel the force that the tip feels."""
        if self._touching is None:
            return
        q, w = self._motion.q, self._motion.w
        x, y, _ = tip(self._body.parameters, q)
        for name, surface, touch in zip(self._near, self._touching.surfaces, self._touching.touches(q, w), strict=True):
            force_x = surface.normal_x * touch.normal_N - surface.normal_y * touch.tangential_N
            force_y = surface.normal_y * touch.normal_N + surface.normal_x * touch.tangential_N
            self.world.push(name, x, y, -force_x, -force_y)


def encounter_of(world: "World | None", motion: Motion, body: RigidBody, horizon_s: float) -> Encounter | None:
    """Return the encounter, None without a world; ValueError if this motion does not feel contact."""
    if world is None:
        return None
    if not isinstance(motion, StickSlip):
        raise ValueError("it feels no contact, but the robot has a world: take the backend closed, or no world")
    return Encounter(world, motion, body, horizon_s)
