"""The names of what a run was worth: the columns of a sweep's table that every sweep has."""

from firmware_py.joint_cpu import SIGNALS

OF_A_JOINT = ("max_deviation_rad", "final_deviation_rad", "swing_rad", "current_noise_A")
SATURATED = tuple(f"saturations_{name}" for name in SIGNALS)
TOTAL_BITS = "total_bits"
"""Of one joint's numbers: constants, counters, words, d."""
KB_FRACTION = "kb_fraction"
"""Bits of KB behind the point: what `fit` has found."""
OF_A_RUN = (*SATURATED, "saturations_references", "saturations_amplifiers", TOTAL_BITS, KB_FRACTION)
TIP = "max_tip_deviation_m"
OK, STOPPED, REFUSED = "ok", "stopped", "refused"
