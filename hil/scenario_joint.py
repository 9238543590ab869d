"""The joints' part of a scenario: what their CPUs are set up with, how fast they compute, and when they sample."""

from typing import Annotated

from pydantic import Field

from hil.scenario_parts import Part, Positive, Time
from hil.scenario_word import Word

Hertz = Annotated[float, Field(ge=1e3, le=1e12)]
Clocks = Annotated[int, Field(ge=1, le=10**9)]
Ppm = Annotated[float, Field(ge=-10_000, le=10_000)]

INTERRUPT_CLOCKS = 1000
"""Of the whole control interrupt on an 8086, rounded: as machine code (docs/cpu.md) it takes 1011 to 1059 on the mean
of paper-joint, by joint, and up to 1128 while nothing saturates. Nothing of CAN, no prefetch queue, no wait states.

Ref: Intel 8086 instruction timing tables (Intel 8086 Family User's Manual 1979).
"""
CLOCK_HZ = 8e6
"""Of the 8086-2."""
PYTHON, I8086 = "python", "i8086"
"""What plays a joint: firmware_py.joint_cpu as it is, or with its step as machine code, whose clocks are counted."""


class Joint(Part):
    """What every joint CPU is set up with; one entry a joint where there are several."""

    observer: bool = True
    word: Word = Word()
    g_rad_s: Positive = 700.0
    inertia_kg_m2: tuple[Positive, ...] = (1.344, 0.537, 0.0832)
    """Nominal inertia Jn: the least 1 / (M^-1)_ii over the workspace, without payload."""
    torque_constant_N_m_A: tuple[Positive, ...] = (10.0, 6.0, 2.0)
    """Nominal torque constant Ktn."""
    limit_A: Positive = 8.0
    compute_s: Time | None = None
    """From the sample to the Current being queued; default: clocks / clock_hz."""
    clock_hz: Hertz = CLOCK_HZ
    clocks: Clocks = INTERRUPT_CLOCKS
    cpu: str = PYTHON
    crystal_ppm: Ppm | None = None
    """Error of a timer of the joint's own that it samples by; default: none, it samples on each Encoder frame."""
    crystal_phase_s: Time = 0.0
    """That timer's first tick is so much, and a period, behind the Encoder frame of cycle 0."""


class OneJoint(Part):
    """What one joint has of its own in place of [joint]'s."""

    compute_s: Time | None = None
    clock_hz: Hertz | None = None
    clocks: Clocks | None = None
    cpu: str | None = None
    """`python`, `i8086`, or `package.module:Class` of a user's own controller."""
    crystal_ppm: Ppm | None = None
    crystal_phase_s: Time | None = None
