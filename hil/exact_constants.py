"""The constants of a joint's law as the physics has them, before any format rounds them.

Ref: the paper's eqs. (5), (6), (8), with KA = g T, KB = g Jn / Ktn in current counts per count and sample,
KJ = Jn / Ktn in current counts per acceleration count; counts are those of the bus.
"""

from math import pi

from dbc.codec import Codec
from firmware_py.dsp.cpu import ACCEL_REFS, JOINTS_A_FRAME
from hil.scenario import Scenario


def rad_per_count(scenario: Scenario) -> float:
    """Return what one count of a position counter means."""
    return 2 * pi / scenario.encoder.counts_per_turn


def reference_of(joint: int) -> tuple[str, int]:
    """Return where the reference of joint 1 to n stands: (name of the AccelRef frame, index in it)."""
    frame, index = divmod(joint - 1, JOINTS_A_FRAME)
    return ACCEL_REFS[frame], index


def exact_constants(scenario: Scenario, joint: int, codec: Codec) -> tuple[float, float, float]:
    """Return KA, KB and KJ of joint 1 to n as the physics has them, before they are rounded to their formats."""
    settings, period_s = scenario.joint, scenario.clock.period_s
    g, inertia = settings.g_rad_s, settings.inertia_kg_m2[joint - 1]
    current_per_torque = 1.0 / settings.torque_constant_N_m_A[joint - 1] / codec.scale(f"Current_{joint}", "Reference")
    kb = g * inertia * current_per_torque * rad_per_count(scenario) / period_s
    return g * period_s, kb, inertia * current_per_torque * codec.scale(reference_of(joint)[0], f"Joint{joint}")
