"""The arm in motion with exact Coulomb friction: joints slide one way, the other way, or stand; the changes are located.

A joint that slides feels friction of constant size against its direction, so the motion between two changes is smooth and
Runge-Kutta keeps its order. A joint that stands is taken out of the mass matrix and holds what it must, up to its limit.
Changes are a speed that reaches zero and a holding torque that reaches the limit; the step is cut there, to 1e-15 s.
Units: SI, tuples of n floats. Ref: eq. (1), c; plant.md, "Coulomb friction with sticking".
Not seen: a holding torque that exceeds its limit and returns within one substep (by at most h^2 / 8 times its curvature),
and a speed that does so within 1/256 of one. Take a smaller substep if that matters.
"""

from itertools import product
from math import copysign, inf

from plant.bracket import first_negative
from plant.drive import Amplifiers, torque_constant
from plant.parameters import Vector
from plant.rigid_body import RigidBody, Step

Modes = tuple[int, ...]
State = tuple[Vector, Vector, bool]

# A joint that stands is released above limit (1 + slack); its release is located at limit (1 + 2 slack), so that rounding
# (1e-15 of the largest torque) cannot hold it again at the same instant, or turn around a joint that sets off.
BREAKAWAY_SLACK = 1e-12
# More changes than this in one substep are no physics (a joint changes 3 times in a ms at the very most).
MOST_PARTS = 1000
SHORTEST_PART = 1 / 256


class StickSlip:
    """State q [rad], w [rad/s] of an arm under constant current references, external torque and friction limits."""

    def __init__(self, body: RigidBody, amplifiers: Amplifiers, q: Vector) -> None:
        self.q: Vector = q
        self.w: Vector = (0.0,) * len(q)
        self._body = body
        self._amplifiers = amplifiers
        self._external: Vector = self.w
        self._limit: Vector = body.parameters.coulomb_Nm
        self._modes: Modes = ()
        self._free: Modes = ()
        self._constant: Vector = ()
        self._step: Step
        self._settled = False

    def change(
        self, body: RigidBody | None = None, external_Nm: Vector | None = None, friction_limit_Nm: Vector | None = None
    ) -> None:
        """Replace what acts on the arm from now on; speeds stay as they are."""
        self._body = self._body if body is None else body
        self._external = self._external if external_Nm is None else external_Nm
        self._limit = self._limit if friction_limit_Nm is None else friction_limit_Nm
        self._settled = False

    def advance(self, span_s: float) -> None:
        """Integrate over span_s, one Runge-Kutta step if nothing changes in it; ArithmeticError if it does not end."""
        if self._settled and 0.0 not in self.w:
            start, middle, end = self._amplifiers.during(span_s)
            q, w, calm = self._step(span_s, self.q, self.w, start, middle, end, self._constant, self._modes)
            if calm:
                self.q, self.w = q, w
                self._amplifiers.elapse(span_s)
                return
        self._advance_in_parts(span_s)

    def acceleration(self) -> Vector:
        """Return q" at this instant, 0.0 for joints that stand."""
        self._settle()
        return self._acceleration(self.q, self.w, self._amplifiers.current_A)

    def friction(self) -> Vector:
        """Return c at this instant: against the direction of sliding, or what holds a joint that stands."""
        self._settle()
        held = self._held(self.q, self.w, self._amplifiers.current_A)
        return tuple([x if s == 0 else s * c for s, c, x in zip(self._modes, self._limit, held, strict=True)])

    # one part at a time

    def _advance_in_parts(self, span_s: float) -> None:
        left_s = span_s
        for _ in range(MOST_PARTS):
            self._settle()
            left_s -= self._advance_part(left_s, span_s * SHORTEST_PART)
            if left_s <= 0.0:
                return
        raise ArithmeticError(
            f"friction: more than {MOST_PARTS} changes within {span_s:g} s at q = {self.q}, w = {self.w}, "
            f"modes {self._modes}: take a smaller substep, and report this state"
        )

    def _advance_part(self, longest_s: float, shortest_s: float) -> float:
        """Advance to the next change, at most longest_s; return how far."""
        part_s = longest_s
        q, w, calm = self._trial(part_s)
        while not calm and part_s > shortest_s and self._margin_after(part_s) > 0.0:
            part_s *= 0.5
            q, w, calm = self._trial(part_s)
        if self._margin_after(part_s) <= 0.0:
            part_s = first_negative(self._margin_after, part_s)
            q, w, calm = self._trial(part_s)
        self._amplifiers.elapse(part_s)
        self.q = q
        self.w = tuple(
            [0.0 if s * v <= 0.0 and c > 0.0 else v for s, v, c in zip(self._modes, w, self._limit, strict=True)]
        )
        return part_s

    def _trial(self, span_s: float) -> State:
        start, middle, end = self._amplifiers.during(span_s)
        return self._step(span_s, self.q, self.w, start, middle, end, self._constant, self._modes)

    def _margin_after(self, span_s: float) -> float:
        """Return what is left after span_s before some joint must change its mode: speeds, or torque below the limit."""
        q, w, _ = self._trial(span_s)
        margin = inf
        for s, v, c in zip(self._modes, w, self._limit, strict=True):
            if s != 0 and c > 0.0:
                margin = min(margin, s * v)
        if 0 not in self._modes:
            return margin
        held = self._held(q, w, self._amplifiers.during(span_s)[2])
        raised = [c * (1.0 + 2.0 * BREAKAWAY_SLACK) for c in self._limit]
        return min(margin, *[c - abs(x) for s, c, x in zip(self._modes, raised, held, strict=True) if s == 0])

    # which joints slide

    def _settle(self) -> None:
        """Find the mode of every joint; those without speed and with friction slide only if they cannot be held."""
        if self._settled and 0.0 not in self.w:
            return
        moving = [int(copysign(1.0, v)) for v in self.w]
        resting = [j for j, (v, c) in enumerate(zip(self.w, self._limit, strict=True)) if v == 0.0 and c > 0.0]
        best: tuple[float, Modes] = (inf, ())
        for choice in product((0, 1, -1), repeat=len(resting)):
            for j, s in zip(resting, choice, strict=True):
                moving[j] = s
            self._set_modes(tuple(moving))
            best = min(best, (self._violation(resting), self._modes), key=lambda found: found[0])
            if best[0] <= 0.0:
                break
        self._set_modes(best[1])
        self._settled = True

    def _violation(self, resting: list[int]) -> float:
        """Return by how much the present modes contradict themselves: 0.0 is a solution, and it is the only one."""
        current = self._amplifiers.current_A
        a = self._acceleration(self.q, self.w, current)
        held = self._held(self.q, self.w, current)
        excess = [0.0]
        for j in resting:
            s, c = self._modes[j], self._limit[j] * (1.0 + BREAKAWAY_SLACK)
            excess.append(abs(held[j]) - c if s == 0 else -s * a[j])
        return max(excess)

    def _set_modes(self, modes: Modes) -> None:
        if modes == self._modes and self._settled:
            return
        self._modes = modes
        self._free = tuple([j for j, s in enumerate(modes, start=1) if s != 0])
        watched = tuple([j for j in self._free if self._limit[j - 1] > 0.0])
        self._step = self._body.step(self._free, watched)
        self._constant = tuple([x - s * c for x, s, c in zip(self._external, modes, self._limit, strict=True)])

    def _acceleration(self, q: Vector, w: Vector, current_A: Vector) -> Vector:
        return self._body.acceleration(q, w, self._driving(q, current_A, self._constant), self._free)

    def _held(self, q: Vector, w: Vector, current_A: Vector) -> Vector:
        """Return the friction that the present modes need: sliding joints' own, and what stands between a joint and motion."""
        needed = self._body.inverse_dynamics(q, w, self._acceleration(q, w, current_A))
        driving = self._driving(q, current_A, self._external)
        return tuple([f - x for f, x in zip(driving, needed, strict=True)])

    def _driving(self, q: Vector, current_A: Vector, constant: Vector) -> Vector:
        Kt = torque_constant(self._body.parameters, q)
        return tuple([K * i + e for K, i, e in zip(Kt, current_A, constant, strict=True)])
