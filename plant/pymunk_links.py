"""The links as pymunk's rigid bodies, held together by impulses: positions at t_j, speeds half a step later.

Chipmunk moves positions, then speeds, then finds the impulses at the joints that hold the new positions together. With
the whole gap taken back within a step (ERROR_BIAS 0, no MAX_BIAS) that is the leapfrog of SHAKE, of second order; as
shipped it is of first order, and 1000 times worse at 100 us. Before the first step the bodies stand one step back, on
the straight line that leads to the start: that step then is the half kick with which a leapfrog begins.
Units: SI. Ref: Ryckaert, Ciccotti, Berendsen, J. Comput. Phys. 23 (1977) 327; Chipmunk 7, cpSpaceStep.c.
No shapes: nothing here touches anything. A space is not copied: it keeps the impulses of the step before.
Impulses are found by iteration, which a long arm with a heavy payload may outrun: `check` sees it before it shows.
"""

from itertools import accumulate
from math import cos, hypot, inf, sin
from typing import TYPE_CHECKING, NamedTuple

from plant.parameters import ArmParameters, Vector

if TYPE_CHECKING:
    from pymunk import Body

ERROR_BIAS = 0.0
MAX_BIAS = inf
ITERATIONS = 100
"""30 do for most arms of 3 joints, and do not for 6 with a payload; where they do, more of them change nothing."""
MOST_OPEN, LEAST_OPEN_M = 3.0, 1e-10
"""Joints stand open by what a step's arc leaves its tangent: 1.3 times that at most in wild swings, 100 times and more
if impulses are not found."""


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
        from pymunk import Space

        self._step_s = step_s
        self._gravity = parameters.gravity_m_s2
        self._share = -1.0
        self._space = Space()
        self._space.iterations = ITERATIONS
        self._space.damping = 1.0
        self._bodies: list[Body] = []
        self.rates = w
        self._links = links_of(parameters, payload_kg)
        x = y = vx = vy = 0.0
        for link, angle, rate in zip(self._links, accumulate(q), accumulate(w), strict=True):
            along, across = cos(angle), sin(angle)
            near, reach = link.centre_m, link.length_m
            speed = vx - near * rate * across, vy + near * rate * along
            body = self._add(link)
            body.velocity, body.angular_velocity = speed, rate
            body.position = x + near * along - step_s * speed[0], y + near * across - step_s * speed[1]
            body.angle = angle - step_s * rate
            x, y = x + reach * along, y + reach * across
            vx, vy = vx - reach * rate * across, vy + reach * rate * along

    def _add(self, link: Link) -> "Body":
        """Return a new body, its near end on the far end of the one before."""
        from pymunk import Body, PivotJoint

        body = Body(link.mass_kg, link.moment_kgm2)
        before, far_end_m = self._space.static_body, 0.0
        if self._bodies:
            place = len(self._bodies) - 1
            before, far_end_m = self._bodies[place], self._links[place].length_m - self._links[place].centre_m
        joint = PivotJoint(before, body, (far_end_m, 0.0), (-link.centre_m, 0.0))
        joint.error_bias, joint.max_bias = ERROR_BIAS, MAX_BIAS
        self._space.add(body, joint)
        self._bodies.append(body)
        return body

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

    def check(self) -> None:
        """Raise ArithmeticError if the joints stand open by more than a step's arc explains."""
        open_m = arc_m = x = y = 0.0
        for body, link in zip(self._bodies, self._links, strict=True):
            along, across = cos(body.angle), sin(body.angle)
            (centre_x, centre_y), near, far = body.position, link.centre_m, link.length_m - link.centre_m
            open_m += hypot(centre_x - near * along - x, centre_y - near * across - y)
            arc_m += 0.5 * link.length_m * (self._step_s * body.angular_velocity) ** 2
            x, y = centre_x + far * along, centre_y + far * across
        if not open_m <= MOST_OPEN * arc_m + LEAST_OPEN_M:
            raise ArithmeticError(
                f"pymunk: the joints stand open by {open_m:.1e} m in sum, where a step's arc explains {arc_m:.1e} m: "
                f"{ITERATIONS} iterations do not find the impulses of this arm; take less payload, "
                "or the backend closed"
            )
