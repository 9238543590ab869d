"""Two joints that stick and release against a naive model: textbook formulas, a fine step, no event located."""

from math import cos, sin
from random import Random

import numpy as np
import pytest

from plant.parameters import ArmParameters
from plant.rigid_body import RigidBody
from plant.robot import Robot

MS = 1_000_000


class Textbook:
    """Two joints by the textbook's formulas in relative angles, with the modes s given."""

    def __init__(self, arm):
        (l1, l2), (m1, m2) = arm.length_m, arm.mass_kg
        self.rotors, self.D, self.c = arm.rotor_inertia_kgm2, arm.viscosity_Nms, arm.coulomb_Nm
        self.alpha = m1 * l1**2 / 3 + m2 * l1**2 + m2 * l2**2 / 3
        self.beta, self.delta = m2 * l1 * l2 / 2, m2 * l2**2 / 3
        self.g1, self.g2 = arm.gravity_m_s2 * (m1 / 2 + m2) * l1, arm.gravity_m_s2 * m2 * l2 / 2

    def parts(self, q1, q2, w1, w2, torque):
        g2 = self.g2 * cos(q1 + q2)
        right1 = torque[0] - self.D[0] * w1 + self.beta * sin(q2) * (2 * w1 + w2) * w2 - self.g1 * cos(q1) - g2
        right2 = torque[1] - self.D[1] * w2 - self.beta * sin(q2) * w1 * w1 - g2
        M12 = self.delta + self.beta * cos(q2)
        M11 = self.alpha + 2 * self.beta * cos(q2) + self.rotors[0]
        return M11, M12, self.delta + self.rotors[1], right1, right2

    def solve(self, state, torque, s):
        M11, M12, M22, r1, r2 = self.parts(*state, torque)
        r1, r2 = r1 - s[0] * self.c[0], r2 - s[1] * self.c[1]
        if s[0] and s[1]:
            det = M11 * M22 - M12 * M12
            return (M22 * r1 - M12 * r2) / det, (M11 * r2 - M12 * r1) / det
        return (r1 / M11 if s[0] else 0.0), (r2 / M22 if s[1] else 0.0)

    def judge(self, state, torque):
        """Let go whatever cannot be held, twice, since one joint's release may be another's."""
        s = [(v > 0) - (v < 0) for v in state[2:]]
        for _ in range(2):
            _, M12, _, r1, r2 = self.parts(*state, torque)
            a1, a2 = self.solve(state, torque, s)
            for j, held in enumerate((r1 - M12 * a2, r2 - M12 * a1)):
                if s[j] == 0 and abs(held) > self.c[j]:
                    s[j] = 1 if held > 0 else -1
        return s


def naive(arm, start, torque_of, duration_s, dt):
    """Midpoint steps; modes judged once a step, speeds set to zero where they changed sign."""
    model = Textbook(arm)
    state = (*start, 0.0, 0.0)
    for k in range(round(duration_s / dt)):
        torque = torque_of(k * dt)
        s = model.judge(state, torque)
        slope = (*state[2:], *model.solve(state, torque, s))
        middle = tuple([y + dt / 2 * d for y, d in zip(state, slope, strict=True)])
        slope = (*middle[2:], *model.solve(middle, torque, s))
        after = [y + dt * d for y, d in zip(state, slope, strict=True)]
        state = (*after[:2], *(v if v * sign > 0 else 0.0 for v, sign in zip(after[2:], s, strict=True)))
    return state


TWO = ArmParameters(
    (0.3, 0.25), (3.0, 1.5), (1.2, 0.5), (2.0, 1.0), (4.0, 2.0), (10.0, 6.0), (60.0, 30.0), brake_delay_ns=0
)


@pytest.mark.parametrize("seed", [0, 1, 3, 4])
def test_two_joints_stick_and_release_like_the_naive_model(seed):
    """0.6 s of torques around gravity's that switch every 20 ms: both joints in all nine pairs of modes."""
    draw = Random(seed)
    start = (0.4, 0.9)
    g = RigidBody(TWO).terms(start, (0.0, 0.0))[2]
    torques = [
        tuple(x + draw.uniform(-2.0, 2.0) * c for x, c in zip(g, TWO.coulomb_Nm, strict=True)) for _ in range(30)
    ]
    robot = Robot(TWO, start)
    robot.release_brakes(0)
    modes = set()
    for k, pair in enumerate(torques):
        for joint, torque_Nm in enumerate(pair, start=1):
            robot.set_external_torque(joint, torque_Nm, k * 20 * MS)
        for part in range(1, 21):
            robot.advance_to((k * 20 + part) * MS)
            modes.add(tuple(int(np.sign(v)) for v in robot.w))
    assert len(modes) == 9
    # the naive model is of first order: 6 times closer with a step of 2 us (4.6e-7 rad, 8.4e-7 rad/s at most)
    dt = 1e-5
    expected = naive(TWO, start, lambda t: torques[int(t / 0.02 + 1e-6)], 0.6, dt)
    assert np.abs(np.array(robot.q) - expected[:2]).max() <= 0.5 * dt
    assert np.abs(np.array(robot.w) - expected[2:]).max() <= 5.0 * dt
