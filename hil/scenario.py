"""Scenarios: one TOML file each, validated into frozen objects.

Every key carries its unit; what a file leaves out has the default of the paper's robot below. Times are seconds in the
file and whole nanoseconds inside.
"""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import Field

from hil.errors import ScenarioError
from hil.scenario_joint import I8086, Joint, OneJoint
from hil.scenario_parts import (
    Angle,
    Duration,
    MoveTime,
    NonNegative,
    Part,
    Period,
    Positive,
    Share,
    ShortTime,
    Time,
    Way,
    to_ns,
)
from hil.scenario_world import Box, Grasp, Wall
from hil.wire.fault import Fault


class Bus(Part):
    """The wire."""

    fidelity: Literal["bits", "functional"] = "bits"
    bitrate: Annotated[int, Field(ge=10_000, le=1_000_000)] = 1_000_000
    action_delay_s: tuple[Time, ...] | None = None
    """When a current acts after its cycle's start under `functional`; default: the worst-case end of its frame."""


class Wire(Part):
    """What goes wrong on the wire, and the seed of what is random in it."""

    seed: Annotated[int, Field(ge=0)] = 0
    faults: tuple[Fault, ...] = ()


class Clock(Part):
    """Who advances time, and the control period."""

    kind: Literal["virtual", "sync", "wall"] = "virtual"
    period_s: Period = 0.001
    setup_cycles: Annotated[int, Field(ge=10, le=100_000)] = 200
    pace: Annotated[float, Field(ge=1e-6, le=1.0)] = 1.0
    """Of `wall`: emulated seconds a second; below 1 time is dilated."""
    stamps: Literal["system", "hardware"] = "system"
    """Of `wall`: whose time stamps tell when a frame came, the kernel's or the CAN controller's."""


class PlantModel(Part):
    """What computes the arm's motion."""

    backend: Literal["closed", "pymunk"] = "closed"
    """The closed form, or pymunk for direct-drive arms without friction: a cross-check."""


class Arm(Part):
    """The rigid bodies and what rubs on them; one entry a joint, base first."""

    lengths_m: tuple[Positive, ...] = (0.30, 0.25, 0.15)
    masses_kg: tuple[Positive, ...] = (3.0, 1.5, 0.5)
    rotor_inertia_kg_m2: tuple[NonNegative, ...] = (1.2, 0.5, 0.08)
    viscosity_N_m_s: tuple[NonNegative, ...] = (2.0, 1.0, 0.2)
    coulomb_N_m: tuple[NonNegative, ...] = (4.0, 2.0, 0.4)
    gravity_m_s2: NonNegative = 9.80665


class Drive(Part):
    """Amplifiers and motors, referred to the joint."""

    torque_constant_N_m_A: tuple[Positive, ...] = (10.0, 6.0, 2.0)
    limit_A: Positive = 8.0
    lag_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    dead_time_s: tuple[ShortTime, ...] = ()
    """From a current's arrival, or its action delay, to its application; default: none."""
    dead_time_jitter_s: tuple[ShortTime, ...] = ()
    """On top of it, drawn for every current between 0 and this; at most half a period; default: none."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Of the jitter."""
    ripple: tuple[Share, ...] = ()
    """Share of the torque constant that varies with the joint's angle; default: none."""
    ripple_order: tuple[Annotated[int, Field(ge=1)], ...] = ()
    """Ripples in one turn of the joint; default: 60."""


class Encoder(Part):
    """Position counters, at the joint."""

    counts_per_turn: Annotated[int, Field(ge=16, le=2**31)] = 819_200


class Brake(Part):
    """Holding brakes: engaged until run, and by Stop or fault."""

    torque_N_m: tuple[Positive, ...] = (60.0, 30.0, 8.0)
    delay_s: Time = 0.03


class Dsp(Part):
    """The position controller."""

    space: Literal["joint", "task"] = "joint"
    law: Literal["acceleration", "computed-torque"] = "acceleration"
    """What AccelRef carries: q"_ref, or the torque of [model] over joint.inertia_kg_m2."""
    k1_1_s: Annotated[float, Field(ge=0, le=1e6)] = 90.0
    k2_1_s2: Annotated[float, Field(ge=0, le=1e6)] = 2000.0
    compute_s: Time = 200e-6


class Model(Part):
    """What the DSP believes of the arm, for dsp.law = 'computed-torque'."""

    scale: Positive = 1.0
    """Believed over true, of all masses, rotor inertias, viscosities and Coulomb frictions."""
    payload_kg: NonNegative = 0.0
    """Believed on the hand, from start to end."""


class QuinticMove(Part):
    """A move in joint space with the quintic's phase."""

    kind: Literal["quintic"]
    by_rad: tuple[Angle, ...]
    time_s: MoveTime


class CircleMove(Part):
    """Once round a circle in task space, from the start's tip, counter-clockwise."""

    kind: Literal["circle"]
    radius_m: Positive
    time_s: MoveTime


class LineMove(Part):
    """A straight line in task space with the quintic's phase, from the start's tip; the hand keeps its direction."""

    kind: Literal["line"]
    by_m: tuple[Way, Way]
    time_s: MoveTime


class Leg(Part):
    """One straight line of a path; no way at all is a rest."""

    by_m: tuple[Way, Way]
    time_s: MoveTime


class PathMove(Part):
    """Straight lines one after the other, at rest between them."""

    kind: Literal["path"]
    legs: Annotated[tuple[Leg, ...], Field(min_length=1, max_length=1000)]

    @property
    def time_s(self) -> float:
        """How long all of them take."""
        return sum(leg.time_s for leg in self.legs)


class Torque(Part):
    """A torque from outside on one joint: amplitude_N_m sin(frequency_rad_s (t - at_s)), or constant at frequency 0."""

    joint: Annotated[int, Field(ge=1, le=6)]
    amplitude_N_m: Annotated[float, Field(ge=-1e4, le=1e4)]
    frequency_rad_s: Annotated[float, Field(ge=0, le=10_000)] = 0.0
    at_s: Time = 0.0
    until_s: Time


class Load(Part):
    """A point mass on the hand for some time."""

    mass_kg: Positive
    at_s: Time
    until_s: Time


class Scenario(Part):
    """One experiment, whole."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=64)]
    title: str = ""
    duration_s: Duration
    start_rad: tuple[Angle, ...] = (0.4, 0.9, -0.5)
    bus: Bus = Bus()
    clock: Clock = Clock()
    plant: PlantModel = PlantModel()
    arm: Arm = Arm()
    drive: Drive = Drive()
    encoder: Encoder = Encoder()
    brake: Brake = Brake()
    joint: Joint = Joint()
    joint1: OneJoint = OneJoint()
    joint2: OneJoint = OneJoint()
    joint3: OneJoint = OneJoint()
    joint4: OneJoint = OneJoint()
    joint5: OneJoint = OneJoint()
    joint6: OneJoint = OneJoint()
    dsp: Dsp = Dsp()
    model: Model = Model()
    trajectory: Annotated[QuinticMove | CircleMove | LineMove | PathMove, Field(discriminator="kind")]
    load: tuple[Load, ...] = ()
    torque: tuple[Torque, ...] = ()
    wall: tuple[Wall, ...] = ()
    box: Box | None = None
    grasp: tuple[Grasp, ...] = ()
    wire: Wire = Wire()

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.start_rad)

    @property
    def has_world(self) -> bool:
        """Whether there is anything to touch or to grasp."""
        return bool(self.wall or self.box or self.grasp)

    @property
    def in_task_space(self) -> bool:
        """Whether the motion is described in task space."""
        return self.trajectory.kind != "quintic"

    @property
    def node_names(self) -> list[str]:
        """The nodes in node order, which breaks ties: plant, DSP, joints."""
        return ["plant", "dsp", *(f"joint{n}" for n in range(1, self.joints + 1))]

    @property
    def period_ns(self) -> int:
        """The control period T."""
        return to_ns(self.clock.period_s)

    @property
    def duration_ns(self) -> int:
        """Length of the run."""
        return to_ns(self.duration_s)

    @property
    def cycles(self) -> int:
        """K: cycles of the run."""
        return self.duration_ns // self.period_ns

    @property
    def bit_ns(self) -> int:
        """One bit on the wire."""
        return 1_000_000_000 // self.bus.bitrate

    def own(self, joint: int) -> OneJoint:
        """Return what joint 1 to n has of its own."""
        own: OneJoint = getattr(self, f"joint{joint}")
        return own

    def of_joint(self, joint: int, key: str) -> Any:
        """Return what joint 1 to n has of its own, or else what [joint] says."""
        own = getattr(self.own(joint), key)
        return getattr(self.joint, key) if own is None else own

    def compute_ns(self, joint: int) -> int:
        """Return the computing time of joint 1 to n, if need be the longest: as given, or by its processor.

        Its own keys go first. Machine code has longer ones than this where something saturates.
        """
        if self.cpu(joint) == I8086:
            from hil.i8086.straight_line import most_clocks

            return to_ns(most_clocks(self, joint) / self.of_joint(joint, "clock_hz"))
        own = self.own(joint)
        given_s = own.compute_s
        if given_s is None and own.clock_hz is None and own.clocks is None:
            given_s = self.joint.compute_s
        if given_s is not None:
            return to_ns(given_s)
        return to_ns(self.of_joint(joint, "clocks") / self.of_joint(joint, "clock_hz"))

    def least_compute_ns(self, joint: int) -> int:
        """Return the shortest computing time of joint 1 to n."""
        if self.cpu(joint) != I8086:
            return self.compute_ns(joint)
        from hil.i8086.straight_line import least_clocks

        return to_ns(least_clocks(self, joint) / self.of_joint(joint, "clock_hz"))

    def cpu(self, joint: int) -> str:
        """Return what plays joint 1 to n."""
        return self.own(joint).cpu or self.joint.cpu

    def crystal_ppb(self, joint: int) -> int | None:
        """Return the error of the timer of joint 1 to n in parts of 1e9; None if it samples on the Encoder frame."""
        ppm = self.of_joint(joint, "crystal_ppm")
        return None if ppm is None else round(ppm * 1000)

    def per_joint(self) -> dict[str, Sequence[object]]:
        """Return every entry that has one value a joint, by its path."""
        paths: dict[str, Sequence[object]] = {"start_rad": self.start_rad}
        for part in ("arm", "drive", "brake", "joint"):
            values = getattr(self, part)
            paths |= {f"{part}.{key}": v for key, v in values if isinstance(v, tuple) and (v or part != "drive")}
        if isinstance(self.trajectory, QuinticMove):
            paths["trajectory.by_rad"] = self.trajectory.by_rad
        if self.bus.action_delay_s is not None:
            paths["bus.action_delay_s"] = self.bus.action_delay_s
        return paths


def check_interval(what: str, at_s: float, until_s: float, scenario: Scenario) -> None:
    """Refuse what ends before it begins, or behind the run."""
    if not at_s < until_s <= scenario.duration_s:
        raise ScenarioError(
            f"{what} from {at_s} s until {until_s} s: it must begin before it ends, "
            f"and end by duration_s = {scenario.duration_s}"
        )
