"""Newton-Euler of the general arm against MuJoCo and the plant's closed form, and what it costs by line."""

from random import Random

import mujoco
import numpy as np
import pytest

from hil.paper.newton_euler import Ledger, Link, newton_euler
from plant.parameters import ArmParameters
from plant.rigid_body import RigidBody

TOLERANCE = 1e-10  # of the largest torque, where that is above 1 N m
STATES = 50


def random_link(draw):
    """A body of five point masses, so that its inertia tensor is a possible one."""
    points = np.array([[draw.uniform(-0.2, 0.2) for _ in range(3)] for _ in range(5)])
    masses = np.array([draw.uniform(0.1, 1.0) for _ in range(5)])
    centre = masses @ points / masses.sum()
    around = points - centre
    inertia = sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, around, strict=True))
    return Link(
        a=draw.uniform(-0.5, 0.5),
        d=draw.uniform(-0.5, 0.5),
        alpha=draw.uniform(-np.pi, np.pi),
        mass=float(masses.sum()),
        centre=tuple(centre.tolist()),
        inertia=tuple(map(tuple, inertia.tolist())),
    )


def rod(length, mass):
    """A uniform rod along x, its frame at its end."""
    across = mass * length**2 / 12
    inertia = ((0.0, 0.0, 0.0), (0.0, across, 0.0), (0.0, 0.0, across))
    return Link(length, 0.0, 0.0, mass, (-length / 2, 0.0, 0.0), inertia)


def text(values):
    return " ".join(repr(float(value)) for value in values)


def mujoco_arm(links, gravity):
    """The same arm, each body's frame that of its joint: a, d, alpha lead from there to the next."""
    bodies = ""
    frames = [(np.zeros(3), 0.0), *((np.array([link.a, 0.0, link.d]), link.alpha) for link in links)]
    for link, (start, turn), (end, alpha) in reversed(list(zip(links, frames, frames[1:], strict=False))):
        c, s = np.cos(alpha), np.sin(alpha)
        X = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        I = X @ np.array(link.inertia) @ X.T  # noqa: E741 (its symbol)
        full = (I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2])
        bodies = f"""<body pos="{text(start)}" quat="{text((np.cos(turn / 2), np.sin(turn / 2), 0, 0))}">
            <joint type="hinge" axis="0 0 1"/>
            <inertial pos="{text(end + X @ link.centre)}" mass="{link.mass!r}" fullinertia="{text(full)}"/>
            {bodies}</body>"""
    xml = f'<mujoco><option gravity="{text(gravity)}"/><worldbody>{bodies}</worldbody></mujoco>'
    model = mujoco.MjModel.from_xml_string(xml)
    return model, mujoco.MjData(model)


def motions(draw, joints):
    for _ in range(STATES):
        yield [tuple(draw.uniform(-reach, reach) for reach in (np.pi, 5.0, 20.0)) for _ in range(joints)]


def off(got, expected):
    return np.abs(np.array(got) - expected).max() / max(1.0, np.abs(expected).max())


@pytest.mark.parametrize("joints", [1, 2, 3, 4, 5, 6])
def test_torques_of_a_spatial_arm_are_mujocos(joints):
    draw = Random(joints)
    links = [random_link(draw) for _ in range(joints)]
    gravity = np.array([draw.uniform(-10.0, 10.0) for _ in range(3)])
    model, data = mujoco_arm(links, gravity)
    worst = 0.0
    for motion in motions(draw, joints):
        data.qpos[:], data.qvel[:], data.qacc[:] = np.array(motion).T
        mujoco.mj_inverse(model, data)
        torques = newton_euler(Ledger(), links, motion, tuple((-gravity).tolist()))
        worst = max(worst, off(torques, data.qfrc_inverse))
    assert worst <= TOLERANCE


@pytest.mark.parametrize("joints", [1, 2, 3, 4, 5, 6])
def test_torques_of_a_planar_arm_are_the_plants(joints):
    draw = Random(10 + joints)
    lengths, masses = ([draw.uniform(*span) for _ in range(joints)] for span in ((0.1, 0.5), (0.3, 4.0)))
    zero = (0.0,) * joints
    body = RigidBody(ArmParameters(tuple(lengths), tuple(masses), zero, zero, zero, (1.0,) * joints, zero))
    links = [rod(a, m) for a, m in zip(lengths, masses, strict=True)]
    upwards = (0.0, body.parameters.gravity_m_s2, 0.0)
    worst = 0.0
    for motion in motions(draw, joints):
        q, w, a = zip(*motion, strict=True)
        expected = np.array(body.inverse_dynamics(q, w, a))
        worst = max(worst, off(newton_euler(Ledger(), links, motion, upwards), expected))
    assert worst <= TOLERANCE


def test_the_ledger_charges_what_was_counted_since_the_last_line():
    ledger = Ledger()
    u, v = (1.0, 2.0, 3.0), (4.0, 5.0, 6.0)
    assert ledger.line("cross", ledger.cross(u, v)) == (-3.0, 6.0, -3.0)
    assert ledger.line("dot", ledger.dot(u, v)) == 32.0
    assert ledger.line("dot", ledger.dot(u, v)) == 32.0
    assert ledger.line("turned", ledger.turned(u, v, 2.0)) == (11.0, -6.0, 3.0)
    assert ledger.lines == {"cross": (6, 3), "dot": (6, 4), "turned": (2, 2)}
    assert ledger.total == (14, 9)
