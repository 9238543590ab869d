"""The nodes of a scenario, each built by itself: a process builds only its own."""

import importlib
import os
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

from dbc.codec import Codec
from dbc.crc import crc16
from dbc.status import Status
from firmware_py.dsp import kinematics, trajectory
from firmware_py.dsp.computed_torque import ComputedTorque
from firmware_py.dsp.control import (
    CommandTable,
    JointSpace,
    PositionControl,
    TaskSpace,
    position_control,
    resting_cycle,
)
from firmware_py.dsp.cpu import DSP, DSPSettings
from firmware_py.dsp.inverse_dynamics import ArmModel
from firmware_py.free_running import FreeRunning
from firmware_py.joint_cpu import JointCPU
from hil import constants
from hil.errors import HilError, ScenarioError, failed
from hil.exact_constants import rad_per_count, reference_of
from hil.node import Node
from hil.scenario import CircleMove, LineMove, QuinticMove, Scenario
from hil.scenario_joint import I8086, PYTHON
from hil.scenario_parts import to_ns
from hil.word_format import words_of
from plant.contact import Compliance
from plant.dead_time import DeadTime
from plant.external import ExternalTorque
from plant.node import Plant
from plant.parameters import ArmParameters
from plant.robot import Robot

if TYPE_CHECKING:
    from plant.world import World

DSP_NUMBER = 7
"""Number of the DSP in the names of its State and Heartbeat frames; the plant's is 0, a joint's its own."""

RIPPLES_A_TURN = 60

NUMBA_PAYS_FROM_S = 40.0
"""Simulated time from which machine code saves more than Numba's start costs (0.5 s and 130 MB)."""

CALLS = ("on_start", "on_frame", "on_timer", "store", "report")
"""What a node answers to (hil/node.py)."""


def build_node(scenario: Scenario, name: str, codec: Codec | None = None, compiled: bool = False) -> Node:
    """Return one node; raise ScenarioError naming what it cannot be built from. compiled: see `build_plant`."""
    codec = codec or read_codec()
    constants.check_budget(scenario)
    if name == "plant":
        return build_plant(scenario, codec, compiled)
    if name == "dsp":
        return build_dsp(scenario, codec)
    check_node_name(scenario, name)
    return build_joint(scenario, int(name.removeprefix("joint")), codec)


def check_node_name(scenario: Scenario, name: str) -> None:
    """Refuse a node that the scenario does not have."""
    if name not in scenario.node_names:
        raise ScenarioError(f"no node {name!r}: this scenario has {', '.join(scenario.node_names)}")


def build_nodes(scenario: Scenario, compiled: bool = False) -> list[Node]:
    """Return all nodes in node order. compiled: see `build_plant`."""
    codec = read_codec()
    return [build_node(scenario, name, codec, compiled) for name in scenario.node_names]


def read_codec() -> Codec:
    """Return the codec of arm.dbc; only here cantools is imported, which the nodes of a run need not wait for."""
    from dbc.compiler import load_arm

    return load_arm()


def _status(scenario: Scenario, codec: Codec, number: int) -> Status:
    """Give each node its turn: the plant 0, joint n its n, the DSP the last."""
    turns = scenario.joints + 2
    turn = turns - 1 if number == DSP_NUMBER else number
    return Status(codec, number, turn, turns, scenario.period_ns, constants.tail_ns(scenario))


# -- plant --


def arm_parameters(scenario: Scenario, codec: Codec) -> ArmParameters:
    """Return the robot's parameters; raise ScenarioError with the plant's own reason."""
    arm, drive, brake = scenario.arm, scenario.drive, scenario.brake
    try:
        return ArmParameters(
            length_m=arm.lengths_m,
            mass_kg=arm.masses_kg,
            rotor_inertia_kgm2=arm.rotor_inertia_kg_m2,
            viscosity_Nms=arm.viscosity_N_m_s,
            coulomb_Nm=arm.coulomb_N_m,
            torque_constant_Nm_A=drive.torque_constant_N_m_A,
            brake_torque_Nm=brake.torque_N_m,
            ripple=drive.ripple,
            ripple_order=tuple(float(order) for order in drive.ripple_order or (RIPPLES_A_TURN,) * len(drive.ripple)),
            counts_per_turn=scenario.encoder.counts_per_turn,
            current_limit_A=drive.limit_A,
            current_counts_per_A=round(1.0 / codec.scale("Current_1", "Reference")),
            amplifier_lag_s=drive.lag_s,
            brake_delay_ns=to_ns(brake.delay_s),
            gravity_m_s2=arm.gravity_m_s2,
        )
    except ValueError as error:
        raise ScenarioError(f"plant: {error}") from None


def build_plant(scenario: Scenario, codec: Codec, compiled: bool = False) -> Plant:
    """Return the plant; compiled: ready, for a run and not for a check, and as machine code where that pays."""
    start_ns = -scenario.clock.setup_cycles * scenario.period_ns
    max_step_ns = min(scenario.period_ns, 1_000_000)
    arm = arm_parameters(scenario, codec)
    backend = scenario.plant.backend
    world = build_world(scenario) if scenario.has_world else None
    machine = compiled and scenario.duration_s >= NUMBA_PAYS_FROM_S
    try:
        robot = Robot(arm, scenario.start_rad, start_ns, max_step_ns, compiled=machine, backend=backend, world=world)
    except ValueError as error:
        raise ScenarioError(f"plant.backend = {backend!r}: {error}") from None
    if compiled:
        robot.prepare()
    delays = constants.action_delays_ns(scenario)
    status, period_ns = _status(scenario, codec, 0), scenario.period_ns
    grasps = [(to_ns(grasp.at_s), to_ns(grasp.until_s)) for grasp in scenario.grasp]
    loads, torques = payloads(scenario), external_torques(scenario)
    return Plant(robot, codec, status, period_ns, delays, loads, torques, grasps, dead_time(scenario))


def dead_time(scenario: Scenario) -> DeadTime | None:
    """Return the dead time of the amplifiers; None where they have none."""
    drive, none = scenario.drive, (0.0,) * scenario.joints
    dead, jitter = (list(map(to_ns, each or none)) for each in (drive.dead_time_s, drive.dead_time_jitter_s))
    return DeadTime(dead, jitter, drive.seed) if any(dead + jitter) else None


def build_world(scenario: Scenario) -> "World":
    """Return what the arm may touch and grasp; only here pymunk is imported."""
    from plant.world import Box, Payload, Wall, World

    walls = [
        Wall(
            wall.point_m,
            wall.normal,
            Compliance(wall.stiffness_N_m, wall.damping_N_s_m, wall.friction, wall.sliding_speed_m_s),
        )
        for wall in scenario.wall
    ]
    box = None
    if (part := scenario.box) is not None:
        compliance = Compliance(part.stiffness_N_m, part.damping_N_s_m, part.tip_friction, part.sliding_speed_m_s)
        box = Box(part.position_m, part.size_m, part.mass_kg, part.friction, compliance)
    lying = [Payload(each.position_m, each.size_m, each.mass_kg, each.friction) for each in scenario.grasp]
    return World(walls, box, lying, scenario.arm.gravity_m_s2)


def external_torques(scenario: Scenario) -> list[ExternalTorque]:
    """Return the torques from outside."""
    return [
        ExternalTorque(each.joint, each.amplitude_N_m, each.frequency_rad_s, to_ns(each.at_s), to_ns(each.until_s))
        for each in scenario.torque
    ]


def payloads(scenario: Scenario) -> list[tuple[float, int]]:
    """Return the mass on the hand from each instant on at which it changes; loads at the same time add up."""
    instants = sorted({to_ns(instant) for load in scenario.load for instant in (load.at_s, load.until_s)})
    on_hand = [
        (sum(load.mass_kg for load in scenario.load if to_ns(load.at_s) <= at_ns < to_ns(load.until_s)), at_ns)
        for at_ns in instants
    ]
    return [(float(mass_kg), at_ns) for mass_kg, at_ns in on_hand]


# -- DSP --


def build_trajectory(scenario: Scenario) -> trajectory.Trajectory:
    """Return the commanded motion, in the space it is described in."""
    move = scenario.trajectory
    if isinstance(move, QuinticMove):
        return trajectory.Quintic(scenario.start_rad, move.by_rad, move.time_s)
    start = kinematics.tip(scenario.arm.lengths_m, scenario.start_rad)
    if isinstance(move, CircleMove):
        return trajectory.Circle(start, move.radius_m, move.time_s)
    legs = (move,) if isinstance(move, LineMove) else move.legs
    return trajectory.Path(start, [((*leg.by_m, 0.0), leg.time_s) for leg in legs])


def joint_trajectory(scenario: Scenario) -> trajectory.Trajectory:
    """Return the commanded motion in joint space; raise ScenarioError where it cannot be followed."""
    motion = build_trajectory(scenario)
    if scenario.in_task_space:
        motion = trajectory.Transformed(motion, scenario.arm.lengths_m, scenario.start_rad)
    return motion


def check_path(scenario: Scenario) -> None:
    """Refuse a task-space path that leaves the arm's reach or meets a singular point."""
    motion = joint_trajectory(scenario)
    try:
        for cycle in range(min(scenario.cycles, resting_cycle(motion, scenario.period_ns)) + 1):
            motion.at(cycle * scenario.clock.period_s)
    except (kinematics.OutOfReach, kinematics.SingularPoint) as error:
        raise ScenarioError(f"trajectory at {cycle * scenario.clock.period_s:.3f} s: {error}") from None


def build_dsp(scenario: Scenario, codec: Codec) -> DSP:
    """Return the DSP."""
    control: PositionControl = build_control(scenario)
    settings = DSPSettings(
        joints=scenario.joints,
        period_ns=scenario.period_ns,
        cycles=scenario.cycles,
        setup_cycles=scenario.clock.setup_cycles,
        compute_ns=to_ns(scenario.dsp.compute_s),
        tables=tuple(constants.parameter_table(scenario, n, codec) for n in range(1, scenario.joints + 1)),
        zero_rad=scenario.start_rad,
        rad_per_count=rad_per_count(scenario),
        counts_per_rad_s2=1.0 / codec.scale("AccelRef", "Joint1"),
    )
    if scenario.dsp.law == "computed-torque":
        control = computed_torque(scenario, control)
    return DSP(settings, control, codec, _status(scenario, codec, DSP_NUMBER))


def build_control(scenario: Scenario) -> JointSpace | TaskSpace:
    """Return the position controller, its commands computed; raise ScenarioError where they cannot be followed."""
    check_path(scenario)
    if scenario.dsp.space == "task" and not scenario.in_task_space:
        raise ScenarioError(
            "dsp.space = 'task' needs a path in task space, but trajectory.kind = 'quintic' moves the joints: "
            "take trajectory.kind = 'circle', 'line' or 'path', or dsp.space = 'joint'"
        )
    gains = scenario.dsp.k1_1_s, scenario.dsp.k2_1_s2
    return position_control(
        scenario.dsp.space,
        build_trajectory(scenario),
        scenario.in_task_space,
        scenario.start_rad,
        scenario.arm.lengths_m,
        gains,
        scenario.cycles,
        scenario.period_ns,
    )


def computed_torque(scenario: Scenario, control: PositionControl) -> ComputedTorque:
    """Return the law that turns a position controller's references into torques."""
    commands = CommandTable(joint_trajectory(scenario), scenario.cycles, scenario.period_ns)
    return ComputedTorque(control, commands, scenario.start_rad, arm_model(scenario), scenario.joint.inertia_kg_m2)


def arm_model(scenario: Scenario) -> ArmModel:
    """Return what the DSP believes of the arm."""
    arm, scale = scenario.arm, scenario.model.scale
    return ArmModel(
        lengths_m=arm.lengths_m,
        masses_kg=tuple(scale * mass for mass in arm.masses_kg),
        rotor_inertia_kg_m2=tuple(scale * rotor for rotor in arm.rotor_inertia_kg_m2),
        viscosity_N_m_s=tuple(scale * viscosity for viscosity in arm.viscosity_N_m_s),
        coulomb_N_m=tuple(scale * coulomb for coulomb in arm.coulomb_N_m),
        gravity_m_s2=arm.gravity_m_s2,
        payload_kg=scenario.model.payload_kg,
    )


# -- joints --


def build_joint(scenario: Scenario, number: int, codec: Codec) -> Node:
    """Return joint 1 to n: the firmware, on the CPU that the scenario names, or the user's own controller."""
    words, status, reference = words_of(scenario, codec), _status(scenario, codec, number), reference_of(number)
    times_ns = scenario.period_ns, scenario.compute_ns(number)
    arguments = number, words, codec, crc16, status, reference, *times_ns
    cpu = scenario.cpu(number)
    if (error_ppb := scenario.crystal_ppb(number)) is not None:
        return FreeRunning(*arguments, error_ppb, to_ns(scenario.of_joint(number, "crystal_phase_s")))
    if cpu == PYTHON:
        return JointCPU(*arguments)
    if cpu == I8086:
        from hil.i8086.joint import Joint8086, make_board  # and what executes it

        return Joint8086(make_board(), scenario.of_joint(number, "clock_hz"), *arguments)
    own = _own_cpu(cpu, number)
    try:
        return own(*arguments)
    except HilError:
        raise
    except Exception as error:
        raise failed(f"joint{number}", error) from error


def _own_cpu(cpu: str, number: int) -> Callable[..., Node]:
    """Find the user's class; it is called as firmware_py.joint_cpu.JointCPU is."""
    module_name, _, class_name = cpu.partition(":")
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    try:
        found = getattr(importlib.import_module(module_name), class_name)
    except (Exception, SystemExit) as error:
        raise ScenarioError(
            f"joint{number}.cpu = {cpu!r}: {type(error).__name__}: {error}; "
            f"write {PYTHON}, {I8086}, or package.module:Class of a class that can be imported"
        ) from None
    lacking = [name for name in CALLS if not callable(getattr(found, name, None))]
    if not isinstance(found, type) or lacking:
        raise ScenarioError(
            f"joint{number}.cpu = {cpu!r}: a node is a class with {', '.join(CALLS)}; it lacks {', '.join(lacking)}; "
            "a subclass of firmware_py.joint_cpu.JointCPU has them all"
        )
    return found
