"""A user's own controller in place of a joint CPU: the same node, another law.

    hil run --set joint2.cpu=examples.pd_joint:SpeedDamping

This one knows no observer: the reference's acceleration, and a damping of the speed error against the integrated
reference. Everything around the law (set-up, state machine, faults, status frames) is the joint CPU's.
"""

from firmware_py.joint_cpu import CURRENT, CURRENT_LIMIT, KJ, SHIFT, JointCPU, W

DAMPING = 4
"""Current counts per count and sample of speed error."""


class SpeedDamping(JointCPU):
    """i = KJ a_ref + DAMPING (w_ref - w), all in raw counts."""

    def preset(self, count):
        super().preset(count)
        self.w_ref = 0.0

    def control(self, count, a_ref):
        """Return (current reference, disturbance estimate) in current counts."""
        w = self.words.wrap(W, count - self.count_prev)
        self.count_prev = count
        self.w_ref += a_ref / 128 * 1e-6 * 819_200 / 6.283185307179586
        feed = self.table[KJ] * a_ref >> self.table[SHIFT]
        i = self.words.limit(CURRENT, feed + round(DAMPING * (self.w_ref - w)), self.table[CURRENT_LIMIT])
        return i, 0
