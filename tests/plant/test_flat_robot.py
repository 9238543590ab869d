"""The flat forms against the classes, uncompiled: the same bits. (As machine code: tests/hil/engine.)"""

from dataclasses import replace
from itertools import product
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant.drive import Amplifiers
from plant.flat_dynamics import accelerate, balance, flat_arm, runge_kutta_step
from plant.flat_motion import advance, settle
from plant.flat_robot import GOES_ON, NO_END, NOT_FINITE, advance_to, flat_robot, position_counts, release_brakes
from plant.parameters import MAX_JOINTS, ArmParameters
from plant.rigid_body import RigidBody
from plant.robot import Robot
from plant.stick_slip import StickSlip
from tests.plant.arms import arm_by_chance

MS = 1_000_000


def drawn_arm(draw: Random, joints: int, lag_s: float = 0.0) -> ArmParameters:
    """An arm by chance, some of its joints without friction, brake or ripple."""
    arm = arm_by_chance(draw, joints)
    return replace(
        arm,
        coulomb_Nm=tuple(draw.choice((0.0, c)) for c in arm.coulomb_Nm),
        brake_torque_Nm=tuple(draw.choice((0.0, c)) for c in arm.brake_torque_Nm),
        ripple=tuple(draw.choice((0.0, draw.uniform(0.0, 0.1))) for _ in range(joints)),
        ripple_order=tuple(draw.uniform(1.0, 60.0) for _ in range(joints)),
        amplifier_lag_s=lag_s,
    )


def state(draw: Random, joints: int, reach: float) -> tuple[float, ...]:
    return tuple(draw.uniform(-reach, reach) for _ in range(joints))


def first(array: np.ndarray, joints: int) -> tuple[float, ...]:
    return tuple(array[:joints].tolist())


@settings(max_examples=30, deadline=None)
@given(joints=st.integers(1, 6), seed=st.integers(0, 2**32))
def test_steps_and_balances_of_any_free_joints_have_the_bits_of_the_text(joints: int, seed: int) -> None:
    draw = Random(seed)
    parameters = drawn_arm(draw, joints)
    q, w, current, e = (state(draw, joints, reach) for reach in (3.0, 5.0, 8.0, 20.0))
    body, arm = RigidBody(parameters), flat_arm(parameters, q)
    modes = draw.choice(list(product((-1, 0, 1), repeat=joints)))
    free = tuple(j for j, s in enumerate(modes, start=1) if s)
    watched = tuple(j for j in free if parameters.coulomb_Nm[j - 1] > 0.0)
    for name, values in {"w": w, "current": current, "constant": e, "modes": modes}.items():
        arm[name][:joints] = values
    arm.limit[:joints] = parameters.coulomb_Nm
    calm = runge_kutta_step(arm, 7e-4)
    reached = body.step(free, watched)(7e-4, q, w, current, current, current, e, modes)
    assert (first(arm.q_then, joints), first(arm.w_then, joints), calm) == reached
    result = np.zeros(MAX_JOINTS)
    balance(arm, arm.q, arm.w, arm.current, result)
    assert (first(result, joints), first(arm.held, joints)) == body.balance(free)(q, w, current, e)
    accelerate(arm, arm.q, arm.w, arm.current, result)
    assert first(result, joints) == body.balance(free)(q, w, current, e)[0]


@pytest.mark.parametrize("lag_s", [0.0, 1e-3])
@pytest.mark.parametrize("joints", [1, 2, 3, 4])
def test_an_arm_that_sticks_and_slips_has_the_bits_of_the_class(joints: int, lag_s: float) -> None:
    draw = Random(joints)
    parameters = replace(drawn_arm(draw, joints, lag_s), coulomb_Nm=tuple([0.0, 1.0, 2.0, 0.5, 0.3, 0.2][-joints:]))
    start = state(draw, joints, 1.5)
    amplifiers = Amplifiers(parameters)
    motion, arm = StickSlip(RigidBody(parameters), amplifiers, start), flat_arm(parameters, start)
    arm.limit[:joints] = parameters.coulomb_Nm
    gravity = RigidBody(parameters).terms(start, (0.0,) * joints)[2]
    stood, moved = set(), set()
    for _ in range(60):
        for j in range(joints):
            asked_Nm = gravity[j] + draw.uniform(-2.5, 2.5) * max(parameters.coulomb_Nm[j], 0.1)
            amplifiers.command(j, int(asked_Nm / parameters.torque_constant_Nm_A[j] * 2048))
        arm.reference[:joints] = amplifiers.reference_A
        if lag_s == 0.0:
            arm.current[:joints] = amplifiers.reference_A
        span_s = draw.uniform(1e-6, 1e-3)
        motion.advance(span_s)
        motion.arrive()
        assert advance(arm, span_s)
        shown = tuple(first(each, joints) for each in (arm.q, arm.w, arm.current))
        assert shown == (motion.q, motion.w, amplifiers.current_A)
        settle(arm)
        rubs = [j for j in range(joints) if parameters.coulomb_Nm[j]]  # of the others no sign is used
        motion.balance()
        assert [arm.modes[j] for j in rubs] == [motion._modes[j] for j in rubs]
        stood |= {j for j in range(joints) if motion.w[j] == 0.0 and parameters.coulomb_Nm[j]}
        moved |= {j for j in range(joints) if motion.w[j] != 0.0}
    assert stood
    assert moved == set(range(joints))


@pytest.mark.parametrize("seed", range(4))
def test_a_robot_through_all_its_events_has_the_bits_of_the_class(seed: int) -> None:
    draw = Random(seed)
    joints, cycles = draw.choice(((1, 30), (3, 20), (4, 15)))
    parameters = replace(drawn_arm(draw, joints, draw.choice((0.0, 5e-4))), current_limit_A=2.0)
    start = state(draw, joints, 1.5)
    end_ns = cycles * MS
    loads = sorted((draw.randrange(end_ns), draw.uniform(0.0, 2.0)) for _ in range(3))
    pushes = sorted((draw.randrange(end_ns), draw.randint(1, joints), draw.uniform(-9.0, 9.0)) for _ in range(9))
    # later than its cycle by up to three, as dead time makes it; never before the last one's
    late = [[k * MS + draw.randrange(3 * MS) for k in range(cycles)] for _ in range(joints)]
    applied_ns = np.maximum.accumulate(np.array(late, dtype=np.int64), axis=1)
    counts = np.array([[draw.randint(-6000, 6000) for _ in range(cycles)] for _ in range(joints)], dtype=np.int64)

    robot = Robot(parameters, start, -2 * MS, MS)
    flat = flat_robot(parameters, start, -2 * MS, MS, applied_ns, [(mass, at) for at, mass in loads], pushes)
    for at_ns, mass_kg in loads:
        robot.set_payload(mass_kg, at_ns)
    for at_ns, joint, torque_Nm in pushes:
        robot.set_external_torque(joint, torque_Nm, at_ns)
    robot.release_brakes(0)
    coulomb_Nm = np.zeros(MAX_JOINTS)
    coulomb_Nm[:joints] = parameters.coulomb_Nm
    for cycle in range(cycles):
        robot.advance_to(cycle * MS)
        assert advance_to(flat, cycle * MS, cycle) == GOES_ON
        if cycle == 0:
            release_brakes(flat, coulomb_Nm)
        shown = tuple(first(each, joints) for each in (flat.arm.q, flat.arm.w, flat.arm.current, flat.arm.external))
        assert shown == (robot.q, robot.w, robot.current_A, robot.external_Nm)
        assert tuple(position_counts(flat, j) for j in range(joints)) == robot.counts()
        for j in range(joints):
            robot.set_current(j + 1, int(counts[j, cycle]), int(applied_ns[j, cycle]))
            flat.counts[j, cycle] = counts[j, cycle]
    assert first(flat.state.saturations, joints) == robot.saturations
    assert sum(robot.saturations) > 0


def test_what_is_not_finite_ends_a_motion() -> None:
    parameters = drawn_arm(Random(1), 2)
    flat = flat_robot(parameters, (0.1, 0.2), 0, MS, np.zeros((2, 0), np.int64), [], [(0, 1, 1e300)])
    with np.errstate(all="ignore"):
        assert advance_to(flat, 5 * MS, 0) == NOT_FINITE


def test_changes_without_end_end_a_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("plant.flat_motion.MOST_PARTS", 0)
    flat = flat_robot(drawn_arm(Random(1), 2), (0.1, 0.2), 0, MS, np.zeros((2, 0), np.int64), [], [(0, 1, 500.0)])
    assert advance_to(flat, 5 * MS, 0) == NO_END
