"""Position control: the acceleration reference of every joint from commands and measured joint angles.

Units: rad, rad/s, rad/s^2 in joint space; m and rad in task space. K1 in 1/s, K2 in 1/s^2. What is stored is single
precision, as on the DSP. Velocities, commanded and measured, are means over the last period.

Ref: the paper's eqs. (16) and (20)-(21).
"""

from array import array
from collections.abc import Sequence
from typing import Protocol

from firmware_py.dsp import kinematics
from firmware_py.dsp.trajectory import Trajectory, Transformed, Vector


class PositionControl(Protocol):
    """One of the position controllers."""

    def step(self, cycle: int, q: Vector) -> Sequence[float]:
        """Return q"_ref (n) for the measured angles q (n) of this cycle."""


class CommandTable:
    """The commands of every cycle from 0 on, computed offline and kept in single precision.

    Holds cycle -1 too (the start), for the mean velocity of cycle 0, and ends where the arm is told to rest. Raises
    what the trajectory raises.
    """

    def __init__(self, trajectory: Trajectory, cycles: int, period_ns: int) -> None:
        self.last = min(cycles, resting_cycle(trajectory, period_ns))
        commands = [trajectory.at(k * period_ns * 1e-9) for k in range(self.last + 1)]
        self.position = [array("f", p) for p, _, _ in [commands[0], *commands]]
        self.acceleration = [array("f", a) for _, _, a in commands]
        self.period_s = period_ns * 1e-9

    def at(self, cycle: int) -> tuple[Sequence[float], list[float], Sequence[float]]:
        """Return (position, mean velocity over the last period, acceleration) of a cycle >= 0."""
        cycle = min(cycle, self.last)
        before, now = self.position[cycle], self.position[cycle + 1]
        velocity = [(x - y) / self.period_s for x, y in zip(now, before, strict=True)]
        return now, velocity, self.acceleration[cycle]


def resting_cycle(trajectory: Trajectory, period_ns: int) -> int:
    """Return the first cycle whose command has been at rest for a whole period."""
    return int(trajectory.time_s * 1e9 // period_ns) + 2


def second_order(
    command: tuple[Sequence[float], Sequence[float], Sequence[float]],
    position: Sequence[float],
    velocity: Sequence[float],
    k1: float,
    k2: float,
) -> list[float]:
    """Return `corrected` of every coordinate."""
    columns = zip(*command, position, velocity, strict=True)
    return [corrected(x_cmd, v_cmd, a, x, v, k1, k2) for x_cmd, v_cmd, a, x, v in columns]


def corrected(x_cmd: float, v_cmd: float, a: float, x: float, v: float, k1: float, k2: float) -> float:
    """Return acceleration command + K1 (velocity error) + K2 (position error), eqs. (16), (20)."""
    return a + k1 * (v_cmd - v) + k2 * (x_cmd - x)


class JointSpace:
    """Joint-space control, eq. (16)."""

    def __init__(self, commands: CommandTable, start: Sequence[float], k1: float, k2: float) -> None:
        self.commands = commands
        self.k1, self.k2 = k1, k2
        self.q_before = array("f", start)

    def step(self, cycle: int, q: Vector) -> Sequence[float]:
        """Return q"_ref."""
        w = [(now - before) / self.commands.period_s for now, before in zip(q, self.q_before, strict=True)]
        self.q_before = array("f", q)
        return second_order(self.commands.at(cycle), q, w, self.k1, self.k2)


class TaskSpace:
    """Task-space control, eqs. (20)-(21); three joints. `step` raises kinematics.SingularPoint."""

    def __init__(
        self, commands: CommandTable, start: Sequence[float], lengths_m: Sequence[float], k1: float, k2: float
    ) -> None:
        self.commands = commands
        self.k1, self.k2 = k1, k2
        self.lengths_m = tuple(lengths_m)
        self.q_before = array("f", start)
        self.x_before = array("f", kinematics.tip(lengths_m, start))

    def step(self, cycle: int, q: Vector) -> Sequence[float]:
        """Return q"_ref."""
        period_s = self.commands.period_s
        x = array("f", kinematics.tip(self.lengths_m, q))
        v = [(now - before) / period_s for now, before in zip(x, self.x_before, strict=True)]
        w = [(now - before) / period_s for now, before in zip(q, self.q_before, strict=True)]
        self.x_before, self.q_before = x, array("f", q)
        x_ref = second_order(self.commands.at(cycle), x, v, self.k1, self.k2)
        bias = kinematics.jacobian_rate_times_speed(self.lengths_m, q, w)
        return kinematics.solve_jacobian(self.lengths_m, q, [a - b for a, b in zip(x_ref, bias, strict=True)])


def position_control(
    space: str,
    trajectory: Trajectory,
    in_task_space: bool,
    start_rad: Sequence[float],
    lengths_m: Sequence[float],
    gains: tuple[float, float],
    cycles: int,
    period_ns: int,
) -> JointSpace | TaskSpace:
    """Return the controller of `space` ("joint" or "task") for a trajectory given in either space."""
    if space == "task":
        return TaskSpace(CommandTable(trajectory, cycles, period_ns), start_rad, lengths_m, *gains)
    if in_task_space:
        trajectory = Transformed(trajectory, lengths_m, start_rad)
    return JointSpace(CommandTable(trajectory, cycles, period_ns), start_rad, *gains)
