"""A rig in float64 whose frames round nothing: what the database's scales cost is the difference to one that they do.

The frames go as ever, so the run keeps its times; but each joint hears the reference that its DSP meant, and the
amplifiers the current that the joint meant. Encoders count as they do: that is the sensor, not the database.
"""

from collections.abc import Sequence
from typing import Any

from dbc.codec import Codec
from firmware_py.dsp.cpu import DSP
from hil.exact_constants import reference_of
from hil.node import Node
from hil.quantise.float_twin import FloatSeats, FloatStep
from hil.quantise.tap import Heard, Step
from hil.scenario import Scenario
from hil.wire.kernel import Kernel
from plant.node import Plant
from plant.robot import Robot

ROUNDED_BY = 0.5
"""A count; what is further away was limited, or is of another cycle: the frame is believed then."""


class UnroundedSeats(FloatSeats):
    """Lets nodes take part, each joint with its law in float64, and hands on what frames cannot say."""

    def __init__(self, scenario: Scenario, codec: Codec) -> None:
        super().__init__(scenario, codec)
        self._accelerations: list[tuple[int, Sequence[float]]] = []
        self._count_A = codec.scale("Current_1", "Reference")

    def seat(self, kernel: Kernel, node: Node) -> None:
        """Let a node take part."""
        if isinstance(node, DSP):
            node.control = Heard(node.control, self._accelerations)
        if isinstance(node, Plant):
            setattr(node.robot, "set_current", self._unrounded(node.robot))  # noqa: B010 (of this robot alone)
        super().seat(kernel, node)

    def step_of(self, joint: int) -> Step:
        """Return what plays joint 1 to n."""
        scale = self._codec.scale(reference_of(joint)[0], f"Joint{joint}")
        return _Hearing(self.steps[joint], self._accelerations, joint - 1, scale)

    def _unrounded(self, robot: Robot) -> Any:
        rounded = robot.set_current

        def set_current(joint: int, counts: int, at_ns: int) -> None:
            meant = self.steps[joint].meant if joint in self.steps else counts
            if abs(meant - counts) <= ROUNDED_BY:
                robot.set_current_A(joint, meant * self._count_A, at_ns)
            else:
                rounded(joint, counts, at_ns)

        return set_current


class _Hearing:
    """A joint's step that hears the reference of the cycle before as it was meant, in counts."""

    def __init__(self, step: FloatStep, meant: list[tuple[int, Sequence[float]]], index: int, scale: float) -> None:
        self._step, self._meant, self._index, self._scale = step, meant, index, scale
        self._steps = 0

    def __call__(
        self, words: object, count: int, count_prev: int, w_prev: int, d: float, a_ref: int, *table: int
    ) -> tuple[int, float, int, int]:
        """Return what the step does."""
        heard: float = a_ref
        if 0 < self._steps <= len(self._meant):
            meant = self._meant[self._steps - 1][1][self._index] / self._scale
            heard = meant if abs(meant - a_ref) <= ROUNDED_BY else a_ref
        self._steps += 1
        return self._step(words, count, count_prev, w_prev, d, heard, *table)
