"""Machine code and Python from the same source: the same bits, the same errors, and no need of Numba."""

import math
import sys
from dataclasses import replace
from pathlib import Path
from random import Random

import numpy as np
import pytest

from plant import compiled
from plant.compiled import machine_code
from plant.parameters import DEFAULT_ARM
from plant.rigid_body import RigidBody
from plant.robot import Robot

MS = 1_000_000
RIPPLING = replace(DEFAULT_ARM, ripple=(0.01, 0.02, 0.01), ripple_order=(6.0, 6.0, 6.0))
FRICTIONLESS = replace(DEFAULT_ARM, coulomb_Nm=(0.0, 0.0, 0.0))


@pytest.fixture
def numba():
    return pytest.importorskip("numba", reason="NOT TESTED: machine code of the plant; pip install -e '.[fast]'")


@pytest.fixture
def forgotten():
    """Nothing compiled before or after is remembered in this process."""
    compiled._compiled.cache_clear()
    yield
    compiled._compiled.cache_clear()


def same_bits(got, expected):
    return repr(got) == repr(expected)  # repr tells 0.0 from -0.0, and a nan is like a nan


def test_sin_and_cos_are_those_of_python(numba):
    draw = np.random.default_rng(1)
    spread = [draw.uniform(-reach, reach, 250_000) for reach in (1e-3, 4.0, 100.0)]
    x = np.concatenate([*spread, 10.0 ** draw.uniform(-300, 300, 250_000)])

    @numba.njit(error_model="numpy")
    def both(x, s, c):
        for k in range(len(x)):
            s[k], c[k] = math.sin(x[k]), math.cos(x[k])

    s, c = np.empty_like(x), np.empty_like(x)
    both(x, s, c)
    assert np.array_equal(s, [math.sin(v) for v in x.tolist()])
    assert np.array_equal(c, [math.cos(v) for v in x.tolist()])


def glides_of(arm, watched):
    """glide in Python, and as machine code."""
    python, machine = (RigidBody(arm, 0.7, compiled=on).glide(watched) for on in (False, True))
    assert machine.__module__ == "plant.compiled"
    return python, machine


def random_glide(draw, joints):
    q, w, e = (tuple(draw.uniform(-reach, reach) for _ in range(joints)) for reach in (math.pi, 5.0, 20.0))
    legs = []
    for _ in range(draw.randint(1, 5)):
        legs += [draw.uniform(1e-6, 1e-3), *(draw.uniform(-8.0, 8.0) for _ in range(joints))]
    # mostly the direction they move in: it ends before the first leg that would turn one around
    modes = tuple(int(math.copysign(1.0, v)) * draw.choice((1, 1, 1, 1, -1)) for v in w)
    return legs, q, w, e, modes


@pytest.mark.usefixtures("numba")
@pytest.mark.parametrize(("arm", "watched"), [(DEFAULT_ARM, (1, 2, 3)), (RIPPLING, (1, 2, 3)), (FRICTIONLESS, ())])
def test_random_glides_have_the_same_bits(arm, watched):
    python, machine = glides_of(arm, watched)
    draw = Random(5)
    legs_done = set()
    for _ in range(2000):
        arguments = random_glide(draw, 3)
        expected = python(*arguments)
        assert same_bits(machine(*arguments), expected)
        legs_done.add(expected[0])
    assert legs_done == ({0, 1, 2, 3, 4, 5} if watched else {1, 2, 3, 4, 5})


def pushed_around(arm, on, seed=3, steps=150):
    """A robot under random currents, often enough for every joint to stick and to turn; what it shows, each 2 ms."""
    draw = Random(seed)
    pose = (0.4, 0.9, -0.5)
    robot = Robot(arm, pose, compiled=on)
    if on:
        robot.prepare()
    g = RigidBody(arm).terms(pose, (0.0, 0.0, 0.0))[2]
    robot.release_brakes(0)
    robot.set_payload(0.8, 100 * MS)
    robot.set_external_torque(2, 1, 111 * MS)
    for k in range(steps):
        for joint in (1, 2, 3):
            K = arm.torque_constant_Nm_A[joint - 1]
            asked_A = (g[joint - 1] + draw.uniform(-2.5, 2.5) * DEFAULT_ARM.coulomb_Nm[joint - 1]) / K
            robot.set_current(joint, int(asked_A * 2048), k * 2 * MS + joint * 123_456)
        robot.advance_to((k + 1) * 2 * MS)
        yield robot.q, robot.w, robot.current_A, robot.balance(), robot.counts()


@pytest.mark.usefixtures("numba")
@pytest.mark.parametrize("lag_s", [0.0, 2e-3])
@pytest.mark.parametrize("arm", [DEFAULT_ARM, RIPPLING, FRICTIONLESS], ids=["default", "ripple", "frictionless"])
def test_a_run_with_stick_slip_has_the_same_bits(arm, lag_s):
    arm = replace(arm, amplifier_lag_s=lag_s)
    python, machine = (list(pushed_around(arm, on)) for on in (False, True))
    assert same_bits(machine, python)
    stood = {0.0 in shown[1] for shown in python[1:]}
    assert stood == ({True, False} if any(arm.coulomb_Nm) else {False})


def thrown(arm, on, torque_Nm):
    """What becomes of an arm that a torque beyond all measure acts on."""
    robot = Robot(arm, (0.4, 0.9, -0.5), compiled=on)
    robot.release_brakes(0)
    robot.advance_to(20 * MS)
    robot.set_external_torque(2, torque_Nm, robot.now_ns)
    try:
        robot.advance_to(30 * MS)
    except (ValueError, ArithmeticError) as error:
        return type(error), str(error)
    return robot.q, robot.w


@pytest.mark.usefixtures("numba")
@pytest.mark.parametrize("arm", [DEFAULT_ARM, FRICTIONLESS], ids=["default", "frictionless"])
def test_numbers_that_are_not_finite_end_in_the_same_way(arm):
    for torque_Nm in (1e100, 1e160, 1e305, 1.7e308):
        python = thrown(arm, False, torque_Nm)
        assert same_bits(thrown(arm, True, torque_Nm), python)
    assert python[0] is ValueError  # sin of infinity, which machine code does not raise


@pytest.mark.usefixtures("numba", "forgotten")
def test_generated_source_is_kept_once_and_its_machine_code_beside_it(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    text = "def twice(x, constants):\n    return constants[0] * x[0]\n"
    twice = machine_code("twice", text, [2.0])
    assert twice is not None
    assert twice([4.5]) == 9.0
    (source,) = (tmp_path / "hil").glob("*.py")
    assert source.read_text() == text
    assert list((tmp_path / "hil").rglob("*.nbc"))
    written = source.stat().st_mtime_ns
    compiled._compiled.cache_clear()
    again = machine_code("twice", text, [3.0])
    assert again is not None
    assert again([4.5]) == 13.5
    assert source.stat().st_mtime_ns == written


@pytest.mark.usefixtures("forgotten")
def test_without_numba_the_source_is_python(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    assert machine_code("any", "def any():\n    return 1\n", []) is None
    body = RigidBody(DEFAULT_ARM, compiled=True)
    assert body.glide((1, 2, 3)).__module__ != "plant.compiled"


@pytest.mark.usefixtures("numba", "forgotten")
def test_without_a_folder_to_keep_it_the_source_is_python(tmp_path: Path, monkeypatch):
    (tmp_path / "hil").write_text("in the way")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert machine_code("any", "def any():\n    return 1\n", []) is None
