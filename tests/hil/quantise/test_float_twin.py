"""The law in float64 against the physics that it stands for, in SI units; and its constants against the table."""

from math import pi

import numpy as np
import pytest

from dbc.compiler import load_arm
from hil import scenario_file
from hil.constants import parameter_table
from hil.exact_constants import exact_constants
from hil.quantise.float_twin import FloatLaw, FloatStep, open_loop
from hil.quantise.tap import COLUMNS
from hil.word_format import WordFormat

CODEC = load_arm()
PAPER = scenario_file.load("paper-joint")
T_S, G = 1e-3, 700.0
JN, KTN = (1.344, 0.537, 0.0832), (10.0, 6.0, 2.0)
AMPERE, RAD_S2, RAD = 1 / 2048, 1 / 128, 2 * pi / 819_200


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_the_estimate_of_a_steady_torque_grows_as_the_filter_does(joint):
    """An ideal motor Jn w' = Ktn i - tau, sampled: t_hat = tau (1 - (1 - g T)^k), (8) with one sample's delay.

    Its counter is not rounded, so only float64's own rounding is left: 1e-9 of the torque, as sums of some 1e5 counts
    have 1e-16 of that each.
    """
    jn, ktn, tau, a_ref = JN[joint - 1], KTN[joint - 1], 3.0, 100
    law = FloatLaw.of(PAPER, joint, CODEC)
    speed = d = count = w_prev = 0.0
    for k in range(40):
        signals = law.signals(count, count - speed * T_S / RAD, w_prev, d, a_ref)
        (w_prev,), (estimate,), (i,) = signals["w"], signals["estimate"], signals["i"]
        d = signals["d"][-1]
        assert estimate * AMPERE * ktn == pytest.approx(tau * (1 - (1 - G * T_S) ** k), abs=1e-9 * tau)
        assert i * AMPERE * ktn == pytest.approx(jn * a_ref * RAD_S2 + estimate * AMPERE * ktn, abs=1e-9)
        speed += (ktn * i * AMPERE - tau) / jn * T_S
        count += speed * T_S / RAD


def test_the_limited_current_is_what_the_observer_hears():
    law = FloatLaw(ka=0.5, kb=2.0, kj=1.0, limit=100.0)
    signals = law.signals(10, 0, 4, 30.0, 500)
    assert signals["KB*dw"] == (12.0,)
    assert signals["estimate"] == (18.0,)
    assert signals["i"] == (100.0,)
    assert signals["i-d"] == (82.0,)
    assert signals["d"] == (18.0, 59.0)


def test_the_counter_wraps_and_nothing_else_does():
    law = FloatLaw(ka=0.5, kb=1e6, kj=1e6, limit=1e12)
    assert law.signals(3, 65535, 0, 0.0, 0)["w"] == (4,)
    assert law.signals(0, 30_000, 30_000, 0.0, 30_000)["KB*dw"] == (-6e10,)


@pytest.mark.parametrize("joint", [1, 2, 3])
def test_the_table_is_the_exact_constants_rounded(joint):
    """Half a count of each format, and no more: what rounding may add."""
    ka, kb, kj = exact_constants(PAPER, joint, CODEC)
    assert (ka, kj) == pytest.approx((G * T_S, JN[joint - 1] / KTN[joint - 1] * RAD_S2 / AMPERE), rel=1e-12)
    assert kb == pytest.approx(G * JN[joint - 1] / KTN[joint - 1] / AMPERE * RAD / T_S, rel=1e-12)
    in_table = parameter_table(PAPER, joint, CODEC)
    shift = in_table[3]
    for exact, whole in zip((ka * 2**15, kb, kj * 2**shift), in_table, strict=False):
        assert abs(exact - whole) <= 0.5
    assert FloatLaw.of_table(WordFormat.of(PAPER, CODEC), *in_table) == FloatLaw(
        in_table[0] / 32768, in_table[1], in_table[2] / 2**shift, 16384
    )


def test_without_an_observer_its_constants_are_zero():
    off = scenario_file.load("paper-joint", ["joint.observer=false"])
    law = FloatLaw.of(off, 2, CODEC)
    assert (law.ka, law.kb) == (0.0, 0.0)
    assert law.kj == FloatLaw.of(PAPER, 2, CODEC).kj


def test_open_loop_carries_its_own_d():
    """Two steps by hand: KB dw = 3 and 0, KJ a_ref = 8 in both."""
    rows = np.zeros((2, len(COLUMNS)), dtype=np.int64)
    column = COLUMNS.index
    rows[:, column("count")], rows[:, column("count_prev")], rows[:, column("w_prev")] = (1, 2), (0, 1), (0, 1)
    rows[:, column("a_ref")], rows[:, column("d")] = 4, 12345  # the firmware's d is not heard
    found = open_loop(FloatLaw(ka=0.25, kb=3.0, kj=2.0, limit=1e3), rows)
    assert found["KB*dw"].tolist() == [3.0, 0.0]
    assert found["d"].tolist() == [-3.0, -1.0, -1.0, 1.0]
    assert found["i"].tolist() == [5.0, 7.0]


def test_the_output_alone_is_rounded_and_counted():
    step = FloatStep(FloatLaw(ka=0.25, kb=3.0, kj=1.3, limit=1e3))
    assert step(None, 0, 0, 0, 0.5, 1, 1, 2, 3, 4, 5) == (0, 0.5 + 0.25 * 1.3, 2, 0)
    assert step.roundings == [pytest.approx(0.2)]
    assert step(None, 0, 0, 0, 1e6, 0)[3] == 32767  # what the frame can hold of it
