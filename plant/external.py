"""Torques from outside that follow a function of time: steps, and sines for a frequency response.

Units: N m, rad/s, integer ns. Ref: eq. (1), -r.
A sine is held for HOLD_NS at its mean over that time, so that its area is exact; its first harmonic is then short of
(w HOLD_NS)^2 / 24, 0.04 % at 2000 rad/s.
"""

from collections.abc import Iterable, Sequence
from math import cos
from typing import NamedTuple

HOLD_NS = 50_000


class ExternalTorque(NamedTuple):
    """amplitude_Nm sin(rad_s (t - at_ns)) on a joint (from 1) until until_ns; constant where rad_s is 0."""

    joint: int
    amplitude_Nm: float
    rad_s: float
    at_ns: int
    until_ns: int

    def held(self, t_ns: int) -> float:
        """Return what it is from t_ns on, until its next change."""
        if not self.at_ns <= t_ns < self.until_ns:
            return 0.0
        if self.rad_s == 0.0:
            return self.amplitude_Nm
        start_ns = t_ns - (t_ns - self.at_ns) % HOLD_NS - self.at_ns
        begin, width = self.rad_s * start_ns * 1e-9, self.rad_s * HOLD_NS * 1e-9
        return self.amplitude_Nm * (cos(begin) - cos(begin + width)) / width

    def changes(self, from_ns: int, to_ns: int) -> Iterable[int]:
        """Return the instants in [from_ns, to_ns) at which it changes."""
        ends = [at_ns for at_ns in (self.at_ns, self.until_ns) if from_ns <= at_ns < to_ns]
        if self.rad_s == 0.0:
            return ends
        first = max(self.at_ns, from_ns + (self.at_ns - from_ns) % HOLD_NS)
        return [*range(first, min(to_ns, self.until_ns), HOLD_NS), *ends]


def changes(torques: Sequence[ExternalTorque], from_ns: int, to_ns: int) -> list[tuple[int, int, float]]:
    """Return (instant, joint, torque from then on) of every change in [from_ns, to_ns), in order of time."""
    found = {(at_ns, torque.joint) for torque in torques for at_ns in torque.changes(from_ns, to_ns)}
    return [
        (at_ns, joint, sum(torque.held(at_ns) for torque in torques if torque.joint == joint))
        for at_ns, joint in sorted(found)
    ]
