"""What every control step of a run was given, and what the DSP would have asked for without rounding.

The run stays as it is: a seat puts a step in the place of each joint's that writes its arguments down and hands them
on. What happens inside is found afterwards, by replaying them (`hil.quantise.signals`).
"""

from array import array
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from firmware_py.dsp.control import PositionControl
from firmware_py.dsp.cpu import DSP
from firmware_py.dsp.kinematics import Vector
from firmware_py.joint_cpu import JointCPU
from hil.errors import ScenarioError
from hil.node import Node
from hil.rig import directly
from hil.wire.kernel import Kernel

Step = Callable[..., tuple[Any, ...]]
"""firmware_py.joint_cpu.make_step's: (words, count, count_prev, w_prev, d, a_ref, *table) to (w, d, i, estimate)."""

COLUMNS = ("at_ns", "count", "count_prev", "w_prev", "d", "a_ref", "ka", "kb", "kj", "shift", "current_limit")


class Tap:
    """Looks on. samples: a row of COLUMNS for every step, by joint; accelerations: (cycle, rad/s^2 of all joints)."""

    def __init__(self) -> None:
        self._samples: dict[int, array[int]] = {}
        self.accelerations: list[tuple[int, Sequence[float]]] = []

    def seat(self, kernel: Kernel, node: Node) -> None:
        """Let a node take part, and look on; raise ScenarioError for a joint whose law is not the firmware's."""
        if isinstance(node, DSP):
            node.control = Heard(node.control, self.accelerations)
        elif node.name.startswith("joint"):
            joint = with_own_step(node)
            joint.step = self._written_down(kernel, joint)
        directly(kernel, node)

    def samples(self, joint: int) -> npt.NDArray[np.int64]:
        """Return what the steps of joint 1 to n were given, a row of COLUMNS each."""
        return np.array(self._samples[joint], dtype=np.int64).reshape(-1, len(COLUMNS))

    def _written_down(self, kernel: Kernel, joint: JointCPU) -> Step:
        step: Step = joint.step
        kept = self._samples[joint.number] = array("q")

        def written_down(words: Any, *arguments: int) -> tuple[Any, ...]:
            kept.extend((kernel.now_ns, *arguments))
            return step(words, *arguments)

        return written_down


class Heard:
    """A position controller whose answers are kept as they leave it."""

    def __init__(self, control: PositionControl, heard: list[tuple[int, Sequence[float]]]) -> None:
        self._control, self._heard = control, heard

    def step(self, cycle: int, q: Vector) -> Sequence[float]:
        """Ask it, and keep what it says."""
        accelerations = self._control.step(cycle, q)
        self._heard.append((cycle, tuple(accelerations)))
        return accelerations


def with_own_step(node: Node) -> JointCPU:
    """Return a joint that computes by the firmware's step; raise ScenarioError for a law of somebody else's."""
    if isinstance(node, JointCPU) and type(node).control is JointCPU.control:
        return node
    kind = type(node)
    raise ScenarioError(
        f"{node.name}.cpu = '{kind.__module__}:{kind.__qualname__}': its control law is its own, and only the signals "
        f"of firmware_py.joint_cpu.make_step are known by name: take {node.name}.cpu = 'python', or a subclass of "
        "JointCPU that leaves `control` as it is"
    )
