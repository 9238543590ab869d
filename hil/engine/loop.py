"""A whole run under the rule `functional` in one call: plant, joints and DSP by turns, as plain functions over arrays.

In cycle k the robot moves to kT, every joint answers its counter with the reference of cycle k - 1, and the DSP answers
all counters with that of cycle k. In the set-up the joints' currents are 0, and the brakes hold.
Numba takes it as it is, the step of the joints and its words being the firmware's own source.
"""

from typing import Any, NamedTuple

import numpy as np

from firmware_py.joint_cpu import PARAMETERS_NAMES, SIGNALS, make_step
from firmware_py.words import Words
from hil.engine.flat_dsp import FlatDsp, answer
from plant.flat_dynamics import Floats, Ints
from plant.flat_robot import GOES_ON, FlatRobot, advance_to, position_counts, release_brakes

NO_REFERENCE = 3
"""Why a run ends, beside `flat_robot`'s reasons: a singular point, or a reference beyond all measure."""

WORDS = np.dtype(
    [("saturations", np.int64, (len(SIGNALS),))]
    + [(name, np.int64) for name, value in vars(Words()).items() if isinstance(value, int)]
)
"""What the operations of the words read and write."""

TABLE = tuple(name.lower() for name in PARAMETERS_NAMES)
"""A joint's parameter table, in its order."""
JOINT = np.dtype([(name, np.int64) for name in (*TABLE, "count_prev", "w_prev", "d", "a_ref")])

joint_step = make_step(Words)


class Loop(NamedTuple):
    """Who takes part in a run from cycle `first` to cycle `cycles`, and what it leaves, a row a cycle from 0 on."""

    robot: FlatRobot
    dsp: FlatDsp
    words: Any
    joints: Any
    period_ns: int
    first: int
    cycles: int
    coulomb_Nm: Floats
    counters: Ints
    q: Floats
    a_ref: Ints
    current: Ints
    estimate: Ints


def carry_through(loop: Loop) -> int:
    """Run it; return why it ended early, 0 if it did not."""
    robot = loop.robot
    for cycle in range(loop.first, loop.cycles):
        failed = advance_to(robot, cycle * loop.period_ns, cycle - loop.first)
        if failed != GOES_ON:
            return failed
        if cycle < 0:
            continue
        if cycle == 0:
            _begin(loop)
        _answer_counters(loop, cycle)
        if not answer(loop.dsp, loop.counters, cycle):
            return NO_REFERENCE
        for j in range(len(loop.joints)):
            loop.a_ref[cycle, j] = loop.joints[j].a_ref = loop.dsp.a_ref[j]
    return advance_to(robot, loop.cycles * loop.period_ns, loop.cycles - loop.first)


def _begin(loop: Loop) -> None:
    """Release the brakes, and let the joints enter run: at rest, no disturbance known."""
    release_brakes(loop.robot, loop.coulomb_Nm)
    for j in range(len(loop.joints)):
        loop.joints[j].count_prev = position_counts(loop.robot, j)


def _answer_counters(loop: Loop, cycle: int) -> None:
    """Let every joint answer its counter of this cycle."""
    for j in range(len(loop.joints)):
        joint = loop.joints[j]
        count = position_counts(loop.robot, j)
        joint.w_prev, joint.d, current, estimate = joint_step(
            loop.words[j],
            count,
            joint.count_prev,
            joint.w_prev,
            joint.d,
            joint.a_ref,
            joint.ka,
            joint.kb,
            joint.kj,
            joint.shift,
            joint.current_limit,
        )
        joint.count_prev = loop.counters[j] = count
        loop.q[cycle, j] = loop.robot.arm.q[j]
        loop.robot.counts[j, cycle - loop.first] = loop.current[cycle, j] = current
        loop.estimate[cycle, j] = estimate
