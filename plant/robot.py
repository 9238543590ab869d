"""The whole robot: arm, drives, brakes, encoders, payload, world, moved from instant to instant of the bench's time.

Units: integer ns, rad, A, N m, kg; joints are numbered from 1 as on the bus, tuples have one entry a joint.
Ref: eq. (1); ARCHITECTURE.md, "Time". Not modelled: sensors other than encoders, joint limits.
What is set at an instant acts from exactly then on: the integration stops there. What is read shows the instant after.
The same calls with the same times give the same bits; other stops in between change the steps, and so the last digits.
"""

from collections.abc import Callable
from heapq import heappop, heappush
from math import isfinite
from typing import TYPE_CHECKING

from plant.brake import Brake
from plant.drive import Amplifiers
from plant.encoder import Encoder
from plant.encounter import encounter_of
from plant.motion import motion_of
from plant.parameters import ArmParameters, Vector, check_payload
from plant.rigid_body import RigidBody

if TYPE_CHECKING:
    from plant.world import World

MS = 1_000_000


class Robot:
    """An arm at rest in its start pose, brakes engaged, at start_ns; ValueError if the pose or a step does not fit.

    compiled: faster where Numba is installed, to the same bits; it costs half a second once in a process.
    backend: what computes the motion (`motion`). world: what the tip may touch and grasp, at rest.
    """

    def __init__(
        self,
        parameters: ArmParameters,
        start_rad: Vector,
        start_ns: int = 0,
        max_step_ns: int = MS,
        payload_kg: float = 0.0,
        compiled: bool = False,
        backend: str = "closed",
        world: "World | None" = None,
    ) -> None:
        if len(start_rad) != parameters.joints or not all(isfinite(q) for q in start_rad):
            raise ValueError(
                f"start pose {start_rad}: give one finite angle for each of the {parameters.joints} joints"
            )
        if max_step_ns < 1:
            raise ValueError(f"max_step_ns: {max_step_ns}, but a step has at least 1 ns: 1000000 is usual")
        self.parameters = parameters
        self._joints = parameters.joints
        self.now_ns = start_ns
        self.payload_kg = payload_kg
        self._load_kg = payload_kg
        self.missed_grasps = 0
        """Times that the hand closed where no payload was."""
        # at a fourth of the lag the effect of a current's exponential is off by (1/4)^4 / 2880 = 1.4e-6 (Simpson)
        lag_ns = round(parameters.amplifier_lag_s * 1e9)
        self._max_step_ns = min(max_step_ns, max(1, lag_ns // 4)) if lag_ns else max_step_ns
        self._external: Vector = (0.0,) * parameters.joints
        bits = parameters.counter_bits
        self._encoders = tuple(Encoder(q, parameters.counts_per_turn, bits) for q in start_rad)
        self._brakes = tuple(Brake(torque, parameters.brake_delay_ns) for torque in parameters.brake_torque_Nm)
        self._amplifiers = Amplifiers(parameters)
        self._compiled = compiled
        body = RigidBody(parameters, payload_kg, compiled)
        start = tuple(map(float, start_rad))
        self._motion = motion_of(backend, body, self._amplifiers, start, self._max_step_ns)
        self._events: list[tuple[int, int, Callable[..., None], tuple[float, ...]]] = []
        self._sequence = 0
        self.encounter = encounter_of(world, self._motion, body, self._max_step_ns * 1e-9)
        """The arm in its world; None without one."""
        self._advance = self._motion.advance if self.encounter is None else self.encounter.advance
        self._arrive = self._motion.arrive if self.encounter is None else self.encounter.meet
        self._friction_changed()

    def advance_to(self, t_ns: int) -> None:
        """Integrate to t_ns, through every event up to and at t_ns; ValueError if that is the past."""
        if t_ns < self.now_ns:
            raise ValueError(f"advance_to({t_ns} ns): the robot is at {self.now_ns} ns already: time only moves on")
        events = self._events
        while events and events[0][0] <= t_ns:
            at_ns, _, act, arguments = heappop(events)
            self._integrate_to(at_ns)
            act(*arguments)
        self._integrate_to(t_ns)
        self._arrive()

    def prepare(self) -> None:
        """Compile now what is otherwise compiled at the first use (10 ms for 3 joints, 0.5 s for 6): for real time."""
        self._motion.prepare() if self.encounter is None else self.encounter.prepare()

    # what acts on it

    def set_current(self, joint: int, counts: int, at_ns: int) -> None:
        """Set a joint's current reference, limited to the amplifier's largest; TypeError if counts is no int."""
        index = self._index(joint)
        if not isinstance(counts, int):
            raise TypeError(f"current of joint {joint}: {counts!r} is not a whole number of counts: pass an int")
        self._at(at_ns, self._amplifiers.command, index, counts)

    def set_current_A(self, joint: int, current_A: float, at_ns: int) -> None:
        """Set a reference that no bus has rounded to counts."""
        self._at(at_ns, self._amplifiers.command_A, self._index(joint), current_A)

    def set_payload(self, mass_kg: float, at_ns: int) -> None:
        """Hold a point mass at the tip instead of the one before; it is put on moving with the hand, so speeds stay."""
        check_payload(mass_kg)
        self._at(at_ns, self._load, mass_kg)

    def grasp(self, payload: int, at_ns: int) -> None:
        """Close the hand on a payload of the world (from 1): if it is there, the arm holds it as a point mass."""
        self._at(at_ns, self._grasp, self._payload_index(payload))

    def drop(self, payload: int, at_ns: int) -> None:
        """Open the hand: a payload that it holds (from 1) falls from where it is."""
        self._at(at_ns, self._drop, self._payload_index(payload))

    def set_external_torque(self, joint: int, torque_Nm: float, at_ns: int) -> None:
        """Set the torque from outside on a joint, towards larger q if positive: -r of eq. (1)."""
        index = self._index(joint)
        if not isfinite(torque_Nm):
            raise ValueError(
                f"external torque of joint {joint}: {torque_Nm} N m is not finite: correct the disturbance"
            )
        self._at(at_ns, self._push, index, torque_Nm)

    def release_brakes(self, at_ns: int) -> None:
        """Release all brakes, at once."""
        self._at(at_ns, self._release)

    def engage_brakes(self, at_ns: int) -> None:
        """Engage all brakes; they hold after the brakes' delay."""
        self._at(at_ns, self._engage)

    # what it shows

    @property
    def q(self) -> Vector:
        """Joint angles [rad]."""
        return self._motion.q

    @property
    def w(self) -> Vector:
        """Joint speeds [rad/s]."""
        return self._motion.w

    @property
    def current_A(self) -> Vector:
        """Currents [A]."""
        return self._amplifiers.current_A

    @property
    def external_Nm(self) -> Vector:
        """Torques from outside [N m], contact with the world included."""
        if self.encounter is None:
            return self._external
        return tuple([x + r for x, r in zip(self._external, self.encounter.torque(), strict=True)])

    @property
    def saturations(self) -> tuple[int, ...]:
        """Current references beyond the amplifiers' limit so far."""
        return tuple(self._amplifiers.saturations)

    @property
    def brake_states(self) -> tuple[str, ...]:
        """ "engaged", "engaging" or "released" of each brake."""
        return tuple(brake.state(self.now_ns) for brake in self._brakes)

    def counts(self) -> tuple[int, ...]:
        """Return the encoders' counters; zero is the start pose."""
        return tuple([encoder.counts(q) for encoder, q in zip(self._encoders, self._motion.q, strict=True)])

    def balance(self) -> tuple[Vector, Vector]:
        """Return `acceleration` and `friction` together, for half the work."""
        return self._motion.balance()

    def acceleration(self) -> Vector:
        """Return q" [rad/s^2] at this instant, 0.0 for joints that stand."""
        return self._motion.balance()[0]

    def friction(self) -> Vector:
        """Return c [N m] at this instant, brakes included: against sliding, or what holds a joint that stands."""
        return self._motion.balance()[1]

    # inside

    def _integrate_to(self, t_ns: int) -> None:
        span_ns = t_ns - self.now_ns
        if span_ns <= self._max_step_ns:
            if span_ns:
                self._advance(span_ns * 1e-9)
        else:
            parts = -(-span_ns // self._max_step_ns)
            span_s = span_ns * 1e-9 / parts
            for _ in range(parts):
                self._advance(span_s)
        self.now_ns = t_ns

    def _at(self, at_ns: int, act: Callable[..., None], *arguments: float) -> None:
        if at_ns < self.now_ns:
            raise ValueError(f"event at {at_ns} ns: the robot is at {self.now_ns} ns already: set it before it is due")
        if at_ns == self.now_ns:
            act(*arguments)
            return
        self._sequence += 1
        heappush(self._events, (at_ns, self._sequence, act, arguments))

    def _index(self, joint: int) -> int:
        if not 1 <= joint <= self._joints:
            raise ValueError(f"joint {joint}: the arm has joints 1 to {self._joints}")
        return joint - 1

    def _payload_index(self, payload: int) -> int:
        lying = 0 if self.encounter is None else len(self.encounter.world.payloads)
        if not 1 <= payload <= lying:
            raise ValueError(f"payload {payload}: the world has {lying}, numbered from 1: put it there first")
        return payload - 1

    def _load(self, mass_kg: float) -> None:
        self._load_kg = mass_kg
        self._weigh()

    def _grasp(self, index: int) -> None:
        assert self.encounter is not None
        if self.encounter.grasp(index):
            self._weigh()
        else:
            self.missed_grasps += 1

    def _drop(self, index: int) -> None:
        assert self.encounter is not None
        if self.encounter.drop(index):
            self._weigh()

    def _weigh(self) -> None:
        self.payload_kg = self._load_kg + (0.0 if self.encounter is None else self.encounter.world.held_kg)
        body = RigidBody(self.parameters, self.payload_kg, self._compiled)
        self._motion.change(body=body) if self.encounter is None else self.encounter.change(body)

    def _push(self, index: int, torque_Nm: float) -> None:
        self._external = (*self._external[:index], torque_Nm, *self._external[index + 1 :])
        self._motion.change(external_Nm=self._external)

    def _release(self) -> None:
        for brake in self._brakes:
            brake.release()
        self._friction_changed()

    def _engage(self) -> None:
        # the brakes are alike but for their torque, so they hold from one and the same instant
        holds_ns = max([brake.engage(self.now_ns) for brake in self._brakes])
        self._at(holds_ns, self._friction_changed)

    def _friction_changed(self) -> None:
        brakes = [brake.torque_at(self.now_ns) for brake in self._brakes]
        limits = zip(self.parameters.coulomb_Nm, brakes, strict=True)
        self._motion.change(friction_limit_Nm=tuple([c + brake for c, brake in limits]))
