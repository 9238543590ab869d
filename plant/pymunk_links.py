"""The links as pymunk's rigid bodies, held together by impulses: positions at t_j, speeds half a step later.

Chipmunk moves positions, then speeds, then finds the impulses at the joints that hold the new positions together. With
the whole gap taken back within a step (ERROR_BIAS 0, no MAX_BIAS) that is the leapfrog of SHAKE, of second order; as
shipped it is of first order, and 1000 times worse at 100 us. Before the first step the bodies stand one step back, on the
straight line that leads to the start: that step then is the half kick with which a leapfrog begins.
Units: SI. Ref: Ryckaert, Ciccotti, Berendsen, J. Comput. Phys. 23 (1977) 327; Chipmunk 7, cpSpaceStep.c.
No shapes: nothing here touches anything. A space is not copied: it keeps the impulses of the step before.
"""

from itertools import accumulate
from math import cos, inf, sin
from typing import NamedTuple

from plant.parameters import ArmParameters, Vector

ERROR_BIAS = 0.0
MAX_BIAS = inf
ITERATIONS = 30


class Link(NamedTuple):
    """Mass, centre of mass from the near joint, moment of inertia about it."""

    length_m: float
    mass_kg: float
    centre_m: float
    moment_kgm2: float


def links_of(parameters: ArmParameters, payload_kg: float) -> list[Link]:
    """Return the links: uniform rods, the rotor of joint 1 with link 1, the payload with the last."""
    rods = zip(parameters.length_m, parameters.mass_kg, strict=True)
    links = [Link(length, mass, length / 2, mass * length * length / 12) for length, mass in rods]
    links[0] = links[0]._replace(moment_kgm2=links[0].moment_kgm2 + parameters.rotor_inertia_kgm2[0])
    length, mass, centre, moment = links[-1]
    shared = (mass * centre + payload_kg * length) / (mass + payload_kg)
    moment += mass * (shared - centre) ** 2 + payload_kg * (length - shared) ** 2
    links[-1] = Link(length, mass + payload_kg, shared, moment)
    return links


class Links:
    """An arm that leaves q with w. `rates` are the joints' speeds half a step back (before the first step: w)."""

    def __init__(self, parameters: ArmParameters, payload_kg: float, q: Vector, w: Vector, step_s: float) -> None:
        import pymunk

        self._step_s = step_s
        self._gravity = parameters.gravity_m_s2
        self._share = -1.0
        self._space = pymunk.Space()
        self._space.iterations = ITERATIONS
        self._space.damping = 1.0
        self._bodies: list[pymunk.Body] = []
        self.rates = w
        before, far_end = self._space.static_body, 0.0
        x = y = vx = vy = 0.0
        columns = zip(links_of(parameters, payload_kg), accumulate(q), accumulate(w), strict=True)
        for link, angle, rate in columns:
            along, across = cos(angle), sin(angle)
            body = pymunk.Body(link.mass_kg, link.moment_kgm2)
            body.angle, body.angular_velocity = angle - step_s * rate, rate
            c, reach = link.centre_m, link.length_m
            speed = vx - c * rate * across, vy + c * rate * along
            body.velocity = speed
            body.position = x + c * along - step_s * speed[0], y + c * across - step_s * speed[1]
            joint = pymunk.PivotJoint(before, body, (far_end, 0.0), (-c, 0.0))
            joint.error_bias, joint.max_bias = ERROR_BIAS, MAX_BIAS
            self._space.add(body, joint)
            self._bodies.append(body)
            before, far_end = body, reach - c
            x, y = x + reach * along, y + reach * across
            vx, vy = vx - reach * rate * across, vy + reach * rate * along

    def ahead(self) -> Vector:
        """Return the joint angles where the next step goes to."""
        step_s, angle, q = self._step_s, 0.0, []
        for body in self._bodies:
            before, angle = angle, body.angle + step_s * body.angular_velocity
            q.append(angle - before)
        return tuple(q)

    def step(self, torque_Nm: Vector, share: float) -> None:
        """Go one step on, then kick: by these joint torques over a whole step, and by a share of gravity's."""
        if share != self._share:
            self._share = share
            self._space.gravity = 0.0, -self._gravity * share
        for body, near, far in zip(self._bodies, torque_Nm, (*torque_Nm[1:], 0.0), strict=True):
            body.torque = near - far
        self._space.step(self._step_s)
        rate, rates = 0.0, []
        for body in self._bodies:
            before, rate = rate, body.angular_velocity
            rates.append(rate - before)
        self.rates = tuple(rates)
