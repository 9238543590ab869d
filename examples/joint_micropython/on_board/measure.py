"""How long a board takes for the control step and for an answer to Encoder: `micropython measure.py`, `import measure`.

As in by_frames.py garbage is collected behind each answer, which is told beside it.
"""

import gc
import time

from joint import make_joint

from firmware_py.joint_cpu import RUN

TABLE = [22938, 984, 23462, 14, 16384]
"""KA, KB, KJ, shift, current limit of joint 2 in paper-joint."""
COUNT, AT_ONCE = 1000, 10
"""Measurements of each; steps in one, since a tick is a microsecond."""


def microseconds(work, *words):
    """Return how long a call takes."""
    began = time.ticks_us()
    work(*words)
    return time.ticks_diff(time.ticks_us(), began)


def take_steps(joint):
    """Compute, nothing else."""
    step, words = joint.step, joint.words
    for _ in range(AT_ONCE):
        step(words, 10977, 11063, -87, -8945352, 347, *TABLE)


def answer(joint, cycle):
    """Return how long the answer to an Encoder takes, a fresh AccelRef with it."""
    reference = joint.accel_ref.pack(cycle % 90, cycle % 80, cycle % 70, (cycle - 1) & 0xFF)
    encoder = joint.encoder.pack(cycle * 7 & 0xFFFF, cycle & 0xFF)
    joint.store(joint.accel_ref.identifier, reference, 0)
    return microseconds(joint.on_frame, joint.encoder.identifier, encoder, cycle * joint.period_ns)


def say(name, found, each=1):
    """Print median and largest."""
    middle, largest = sorted(found)[len(found) // 2] / each, max(found) / each
    print(f"{name:10}  median {middle:.1f} us, largest {largest:.1f} us")


joint = make_joint()
steps, answers, collections = [], [], []
joint.state, joint.table = RUN, TABLE
for cycle in range(1, COUNT + 1):
    steps.append(microseconds(take_steps, joint))
    answers.append(answer(joint, cycle))
    collections.append(microseconds(gc.collect))
say("step", steps, AT_ONCE)
say("answer", answers)
say("gc.collect", collections)
