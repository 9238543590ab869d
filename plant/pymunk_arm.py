"""A direct-drive arm moved by pymunk instead of the closed form: the same calls as `stick_slip.StickSlip`.

Time is cut into steps of constant length from the release of the brakes on. The kick at t_j stands for what acts from
t_j - step/2 to t_j + step/2, so a torque that changes in between acts by its mean: the speed that it leaves is exact,
the position beside it by at most step^2 / 8 times the change of acceleration. Viscosity takes the speed at t_j from the
two half steps before it.
The closed form does three things here: it holds the arm while brakes are engaged (before a run; after it, they slow it
down), it says the acceleration, and with it what is read between two kicks: angles at t_j are pymunk's own. A payload
that changes begins new steps at that instant.
Refused: what `check` says. Not modelled: what the closed form does not model.
"""

from plant.drive import Amplifiers, torque_constant
from plant.parameters import ArmParameters, Vector
from plant.pymunk_links import Links
from plant.rigid_body import RigidBody
from plant.stick_slip import StickSlip

STEP_NS = 100_000
MOST_DAMPING = 0.1
"""Of a step, by viscosity: beyond it the extrapolated speed is no longer good enough, and at 1 no longer stable."""
ROUNDING_S = 1e-13

CURE = "take the backend closed"


def check(parameters: ArmParameters, step_s: float) -> None:
    """Refuse an arm that pymunk cannot carry; ValueError says what, how much, how much at most, and the cure."""
    for joint, inertia in enumerate(parameters.rotor_inertia_kgm2[1:], start=2):
        if inertia > 0.0:
            raise ValueError(
                f"rotor inertia of joint {joint}: {inertia:g} kg m^2, but pymunk takes 0 there: a geared rotor turns "
                "with the joint's angle, and a body has only its absolute one; set it to 0 (direct drive; joint 1 may "
                f"have one), or {CURE}"
            )
    for joint, coulomb_Nm in enumerate(parameters.coulomb_Nm, start=1):
        if coulomb_Nm > 0.0:
            raise ValueError(
                f"Coulomb friction of joint {joint}: {coulomb_Nm:g} N m, but pymunk takes 0: its joints do not stick "
                f"exactly; set it to 0, or {CURE}"
            )
    if parameters.amplifier_lag_s > 0.0:
        raise ValueError(
            f"amplifier lag: {parameters.amplifier_lag_s:g} s, but pymunk takes 0: a kick knows one torque a step; "
            f"set it to 0, or {CURE}"
        )
    _check_damping(parameters, step_s)


def _check_damping(parameters: ArmParameters, step_s: float) -> None:
    """Bound the arm's fastest decay by that of its links, were they not held together."""
    rods = zip(parameters.mass_kg, parameters.length_m, strict=True)
    yields = [0.0, *(12.0 / (mass * length * length) for mass, length in rods)]
    for joint, viscosity in enumerate(parameters.viscosity_Nms, start=1):
        most = MOST_DAMPING / (parameters.joints * step_s * (yields[joint - 1] + yields[joint]))
        if viscosity > most:
            raise ValueError(
                f"viscosity of joint {joint}: {viscosity:g} N m s, but pymunk takes at most {most:.3g} with these "
                f"links at {step_s * 1e6:g} us a step; set less, or {CURE}"
            )


class PymunkArm:
    """State q [rad], w [rad/s] of an arm without friction, under constant current references and external torque."""

    def __init__(self, body: RigidBody, amplifiers: Amplifiers, q: Vector, step_ns: int = STEP_NS) -> None:
        self._step_s = step_ns * 1e-9
        self._parameters = body.parameters
        check(body.parameters, self._step_s)
        self.q: Vector = q
        self.w: Vector = (0.0,) * len(q)
        self._body = body
        self._amplifiers = amplifiers
        self._external: Vector = self.w
        self._closed = StickSlip(body, amplifiers, q)
        self._braked = False
        self._begin()

    def change(
        self, body: RigidBody | None = None, external_Nm: Vector | None = None, friction_limit_Nm: Vector | None = None
    ) -> None:
        """Replace what acts on the arm from now on; speeds stay as they are. Friction is that of the brakes."""
        self._external = self._external if external_Nm is None else external_Nm
        if body is None and friction_limit_Nm is None and not self._braked:
            return  # a kick gathers torques as they change
        self.arrive()
        self._body = self._body if body is None else body
        self._closed.q, self._closed.w = self.q, self.w
        self._closed.change(body, self._external, friction_limit_Nm)
        if friction_limit_Nm is not None:
            self._braked = any(friction_limit_Nm)
        if not self._braked:
            self._begin()

    def _begin(self) -> None:
        """Begin new steps here."""
        self._links = Links(self._parameters, self._body.payload_kg, self.q, self.w, self._step_s)
        self._rates_before = self.w
        self._begun = self._moved = False
        self._start_kick(0.0)

    def _start_kick(self, since_s: float) -> None:
        """Begin to gather what the kick at t_j stands for; since_s: t_j until now."""
        self._since_s = since_s
        self._left_s = 0.5 * self._step_s - since_s
        self._gathered_s = 0.0
        self._charge: list[float] = [0.0] * len(self.q)
        self._push: list[float] = [0.0] * len(self.q)

    def advance(self, span_s: float) -> None:
        """Let span_s pass under the currents of now; q and w follow with `arrive`."""
        if self._braked:
            self._closed.advance(span_s)
            return
        self._moved = True
        while span_s >= self._left_s - ROUNDING_S:
            span_s -= self._left_s
            self._gather(self._left_s)
            self._kick()
        if span_s > ROUNDING_S:
            self._gather(span_s)

    def _gather(self, span_s: float) -> None:
        self._gathered_s += span_s
        self._since_s += span_s
        self._left_s -= span_s
        currents = zip(self._amplifiers.current_A, self._external, strict=True)
        for index, (current, external) in enumerate(currents):
            self._charge[index] += current * span_s
            self._push[index] += external * span_s

    def _kick(self) -> None:
        """Go to t_j, and on to the speeds of half a step later."""
        links, step_s = self._links, self._step_s
        share = self._gathered_s / step_s
        rates = links.rates
        now = [1.5 * w - 0.5 * before for w, before in zip(rates, self._rates_before, strict=True)]
        columns = zip(self._constants(), self._charge, self._push, self._parameters.viscosity_Nms, now, strict=True)
        torque = [(K * charge + push) / step_s - share * D * w for K, charge, push, D, w in columns]
        links.step(tuple(torque), share)
        self._rates_before = rates
        self._begun = True
        self._start_kick(-0.5 * step_s)

    def _constants(self) -> Vector:
        if any(self._parameters.ripple):
            return torque_constant(self._parameters, self._links.ahead())
        return self._parameters.torque_constant_Nm_A

    def arrive(self) -> None:
        """Bring q and w to now: half a step, and no more, by the closed form's acceleration."""
        if self._braked:
            self._closed.arrive()
            self.q, self.w = self._closed.q, self._closed.w
        elif self._moved:
            self._moved = False
            if self._begun:
                self._links.check()
            at_kick, rates = self._links.ahead(), self._links.rates
            a = self._body.acceleration(at_kick, rates, self._mean_torque(at_kick))
            since, gathered = self._since_s, self._gathered_s
            self.w = tuple([w + gathered * x for w, x in zip(rates, a, strict=True)])
            columns = zip(at_kick, self.w, a, strict=True)
            self.q = tuple([q + since * (w - 0.5 * since * x) for q, w, x in columns])

    def _mean_torque(self, q: Vector) -> Vector:
        """Return the mean torque of motors and from outside since the last kick, at q."""
        if self._gathered_s < ROUNDING_S:
            return self._torque(q)
        columns = zip(torque_constant(self._parameters, q), self._charge, self._push, strict=True)
        return tuple([(K * charge + push) / self._gathered_s for K, charge, push in columns])

    def _torque(self, q: Vector) -> Vector:
        columns = zip(torque_constant(self._parameters, q), self._amplifiers.current_A, self._external, strict=True)
        return tuple([K * current + external for K, current, external in columns])

    def balance(self) -> tuple[Vector, Vector]:
        """Return (q" [rad/s^2] by the closed form at pymunk's q and w, friction of engaged brakes [N m])."""
        if self._braked:
            return self._closed.balance()
        return self._body.acceleration(self.q, self.w, self._torque(self.q)), (0.0,) * len(self.q)

    def prepare(self) -> None:
        """Compile the closed form's functions that every run needs."""
        self._closed.balance()
        self._body.acceleration(self.q, self.w, self.w)
