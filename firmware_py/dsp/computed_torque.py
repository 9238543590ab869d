"""Computed torque: the disturbance observer's rival, which needs the whole arm's parameters where the observer has Jn.

A position controller's q"_ref, eq. (16) or (21), becomes the torque of the arm's model,

    tau = M(q) q"_ref + h(q, w) + g(q) + D w + c sign(w_cmd)

and goes to the joints as tau / Jn. With their observers off, Ktn i = Jn (tau / Jn), so the wire needs no frame of its
own. The friction's sign is that of the commanded speed: that of the measured one would chatter about standstill.

Ref: the paper's table 1 and eqs. (1), (8); the law is any robotics textbook's.
"""

from array import array
from collections.abc import Sequence

from firmware_py.dsp.control import CommandTable, PositionControl
from firmware_py.dsp.inverse_dynamics import ArmModel, joint_torques
from firmware_py.dsp.trajectory import Vector


class ComputedTorque:
    """A position controller whose joints get torques.

    control: gives q"_ref; commands: in joint space; start: the pose of cycle -1, rad; inertia_kg_m2: Jn of each joint.
    """

    def __init__(
        self,
        control: PositionControl,
        commands: CommandTable,
        start: Sequence[float],
        arm: ArmModel,
        inertia_kg_m2: Sequence[float],
    ) -> None:
        self.control = control
        self.commands = commands
        self.arm = arm
        self.inertia_kg_m2 = tuple(inertia_kg_m2)
        self.q_before = array("f", start)

    def step(self, cycle: int, q: Vector) -> Sequence[float]:
        """Return tau / Jn, rad/s^2."""
        w = [(now - before) / self.commands.period_s for now, before in zip(q, self.q_before, strict=True)]
        self.q_before = array("f", q)
        a_ref = self.control.step(cycle, q)
        _, w_cmd, _ = self.commands.at(cycle)
        torques = joint_torques(self.arm, q, w, a_ref, w_cmd)
        return [torque / Jn for torque, Jn in zip(torques, self.inertia_kg_m2, strict=True)]
