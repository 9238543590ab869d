"""The arm in motion with exact Coulomb friction: changes between sliding and standing are located, not smoothed.

A joint that slides feels friction of constant size against its direction, so the motion between two changes is smooth
and Runge-Kutta keeps its order. A joint that stands is taken out of the mass matrix and holds what it must, up to its
limit. Changes are a speed that reaches zero and a holding torque that reaches the limit; the step is cut there.
While all joints slide, the steps are noted and done in one call (`arrive`), which machine code needs to be worth it.
Near a surface (`Touching`) every step is done at once.
Units: SI, tuples of n floats. Ref: eq. (1), c.
Not seen: a holding torque that exceeds its limit and returns within one substep h (its excess is at most h^2 / 8 times
its curvature), and a speed that turns twice within h / 256. Take a smaller substep if that matters.
"""

from itertools import product
from math import inf

from plant.bracket import first_negative
from plant.drive import Amplifiers
from plant.friction import Modes, modes_of, release_margin
from plant.parameters import Vector
from plant.rigid_body import Balance, Glide, RigidBody, Step, Surfaces
from plant.touching import Touching

# No arm changes this often in one substep of a millisecond or less; it is here to end, and to tell, what must not be.
MOST_PARTS = 1000
SHORTEST_PART = 1 / 256

State = tuple[Vector, Vector, Vector, Surfaces]
"""q, w, current, and the surfaces near the tip."""


class StickSlip:
    """State q [rad], w [rad/s] of an arm under constant current references, external torque and friction limits."""

    def __init__(self, body: RigidBody, amplifiers: Amplifiers, q: Vector) -> None:
        self.q: Vector = q
        self.w: Vector = (0.0,) * len(q)
        self._body = body
        self._touching: Touching | None = None
        self._amplifiers = amplifiers
        self._external: Vector = self.w
        self._limit: Vector = body.parameters.coulomb_Nm
        self._modes: Modes = ()
        self._settled = False
        self._gliding = False
        self._resting = False
        self._legs: list[float] = []
        self._leg = 1 + len(q)
        self._judged: State
        self._found: dict[Modes, tuple[Balance, Vector]] = {}
        self._balanced_at: State | None = None
        self._balanced: tuple[Vector, Vector]
        self._glide: Glide
        self._step: Step
        self._balance_now: Balance
        self._constant: Vector
        self._sliding: Vector

    def change(
        self,
        body: RigidBody | Touching | None = None,
        external_Nm: Vector | None = None,
        friction_limit_Nm: Vector | None = None,
    ) -> None:
        """Replace what acts on the arm from now on; speeds stay as they are."""
        self.arrive()
        if body is not None:
            self._touching = body if isinstance(body, Touching) else None
            self._body = body.body if isinstance(body, Touching) else body
        self._external = self._external if external_Nm is None else external_Nm
        self._limit = self._limit if friction_limit_Nm is None else friction_limit_Nm
        self._settled = self._gliding = self._resting = False
        self._balanced_at = None
        self._found.clear()

    def advance(self, span_s: float) -> None:
        """Integrate over span_s, or note it for `arrive`; ArithmeticError if changes do not end."""
        if self._gliding:
            self._legs += span_s, *self._amplifiers.current_A
        elif not (self._resting and self._amplifiers.current_A == self._judged[2]):
            self._advance(span_s)

    def arrive(self) -> None:
        """Integrate what `advance` has noted: q, w and `balance` are those of now."""
        if not self._legs:
            return
        legs, self._legs = self._legs, []
        current_now = self._amplifiers.current_A
        while legs:
            if self._gliding:
                legs = self._glide_on(legs)
            if legs:
                span_s, *current = legs[: self._leg]
                self._amplifiers.current_A = tuple(current)
                self._advance(span_s)
                legs = legs[self._leg :]
        self._amplifiers.current_A = current_now

    def _glide_on(self, legs: list[float]) -> list[float]:
        """Integrate over the legs as far as all joints keep sliding; return the others."""
        done, self.q, self.w, acceleration = self._glide(legs, self.q, self.w, self._constant, self._modes)
        left = legs[done * self._leg :]
        if not left:
            self._balanced_at = self.q, self.w, tuple(legs[1 - self._leg :]), ()
            self._balanced = acceleration, self._sliding
        return left

    def _advance(self, span_s: float) -> None:
        self._integrate(span_s)
        instant = self._amplifiers.instant and self._settled
        self._gliding = instant and 0.0 not in self.w and self._touching is None
        self._resting = instant and not any(self._modes) and not self._pushed

    def _integrate(self, span_s: float) -> None:
        """Integrate over span_s, one Runge-Kutta step if nothing changes."""
        if self._settled and 0.0 not in self.w:
            q, w, calm = self._trial(span_s)
            if calm:
                self.q, self.w = q, w
                self._elapse(span_s)
                return
        self._settle()
        if not any(self._modes) and self._amplifiers.steady and not self._pushed:
            return  # all stand, and what they must hold does not change
        left_s = span_s
        for _ in range(MOST_PARTS):
            self._settle()
            left_s -= self._advance_part(left_s, span_s * SHORTEST_PART)
            if left_s <= 0.0:
                return
        raise ArithmeticError(
            f"friction: more than {MOST_PARTS} changes within {span_s:g} s at q = {self.q} rad, w = {self.w} rad/s, "
            f"modes {self._modes}: take a smaller substep, and report this state"
        )

    def prepare(self, surfaces: int = 0) -> None:
        """Compile `glide`, and the step of every set of free joints: otherwise 1 to 8 ms at the first use of each.

        surfaces: also for that many surfaces near the tip.
        """
        coulomb = self._body.parameters.coulomb_Nm
        for modes in product((0, 1), repeat=len(coulomb)):
            free = _free(modes)
            self._body.balance(free)
            watched = tuple([j for j in free if coulomb[j - 1] > 0.0])
            self._body.step(free, watched)
            if surfaces:
                self._body.touching_balance(free, surfaces)
                self._body.touching_step(free, watched, surfaces)
        if self._amplifiers.instant:
            self._body.glide(watched)([0.0] * self._leg, self.q, self.w, self.w, (1,) * len(self.w))

    def balance(self) -> tuple[Vector, Vector]:
        """Return (q" [rad/s^2], 0.0 for joints that stand; c [N m], against sliding or what holds) at this instant."""
        self._settle()
        state = self._state
        if state != self._balanced_at:
            acceleration, held = self._balance_now(*state[:3], self._constant)
            columns = zip(self._modes, self._sliding, held, strict=True)
            self._balanced = acceleration, tuple([x if s == 0 else c for s, c, x in columns])
            self._balanced_at = state
        return self._balanced

    @property
    def _pushed(self) -> bool:
        """Whether a surface near the tip moves."""
        return self._touching is not None and self._touching.moves

    @property
    def _state(self) -> State:
        surfaces = () if self._touching is None else self._touching.surfaces
        return self.q, self.w, self._amplifiers.current_A, surfaces

    def _settle(self) -> None:
        """Find the modes at this instant; joints at rest are judged again when a current has jumped, or they moved."""
        if self._settled and 0.0 not in self.w:
            return
        state = self._state
        if self._settled and state == self._judged:
            return
        self._judged = state
        modes = modes_of(self.w, self._limit, self._balance)
        if self._settled and modes == self._modes:
            return
        self._modes, self._settled, self._resting = modes, True, False  # by `balance`, too
        free = _free(modes)
        watched = tuple([j for j in free if self._limit[j - 1] > 0.0])
        self._step = (self._touching or self._body).step(free, watched)
        if self._amplifiers.instant and free == self._body.all_joints:
            self._glide = self._body.glide(watched)
        self._balance_now, self._constant = self._under(modes)
        self._sliding = tuple([s * c for s, c in zip(modes, self._limit, strict=True)])

    def _advance_part(self, longest_s: float, shortest_s: float) -> float:
        """Advance to the next change, at most longest_s; return how far."""
        part_s = longest_s
        q, w, calm = trial = self._trial(part_s)
        while (margin := self._margin(part_s, trial)) > 0.0 and not calm and part_s > shortest_s:
            part_s *= 0.5  # it nearly stops: it may have stopped and set off again
            q, w, calm = trial = self._trial(part_s)
        if margin <= 0.0:
            part_s = first_negative(lambda span_s: self._margin(span_s, self._trial(span_s)), part_s)
            q, w, _ = self._trial(part_s)
        self._elapse(part_s)
        self.q = q
        columns = zip(self._modes, w, self._limit, strict=True)
        self.w = tuple([v if c == 0.0 or s * v > 0.0 else 0.0 for s, v, c in columns])
        return part_s

    def _elapse(self, span_s: float) -> None:
        self._amplifiers.elapse(span_s)
        if self._touching is not None:
            self._touching.elapse(span_s)

    def _trial(self, span_s: float) -> tuple[Vector, Vector, bool]:
        start, middle, end = self._amplifiers.during(span_s)
        return self._step(span_s, self.q, self.w, start, middle, end, self._constant, self._modes)

    def _margin(self, span_s: float, trial: tuple[Vector, Vector, bool]) -> float:
        """Return what is left where the trial of span_s ends, before a joint must change: speed, or torque to hold."""
        q, w, _ = trial
        margin = inf
        for s, v, c in zip(self._modes, w, self._limit, strict=True):
            if s != 0 and c > 0.0:
                margin = min(margin, s * v)
        if 0 not in self._modes:
            return margin
        current = self._amplifiers.during(span_s)[2]
        balance = self._balance_now
        if self._touching is not None:
            balance = self._touching.after(span_s).balance(_free(self._modes))
        _, held = balance(q, w, current, self._constant)
        return min(margin, release_margin(self._modes, self._limit, held))

    def _balance(self, modes: Modes) -> tuple[Vector, Vector]:
        balance, constant = self._under(modes)
        return balance(self.q, self.w, self._amplifiers.current_A, constant)

    def _under(self, modes: Modes) -> tuple[Balance, Vector]:
        """Return the balance, and the torque that is constant, while the modes are: from outside, and from sliding."""
        if modes not in self._found:
            columns = zip(self._external, modes, self._limit, strict=True)
            constant = tuple([float(x - s * c) for x, s, c in columns])
            self._found[modes] = (self._touching or self._body).balance(_free(modes)), constant
        return self._found[modes]


def _free(modes: Modes) -> tuple[int, ...]:
    return tuple([joint for joint, s in enumerate(modes, start=1) if s != 0])
