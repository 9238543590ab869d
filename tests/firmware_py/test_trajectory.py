"""Commands: at rest at both ends, derivatives that belong together, the circle where the design puts it."""

from math import atan2, hypot, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.dsp.kinematics import OutOfReach, SingularPoint, tip
from firmware_py.dsp.trajectory import Circle, Path, Quintic, Transformed, quintic

LENGTHS = (0.30, 0.25, 0.15)
START = (0.4, 0.9, -0.5)
ZERO = (0.0, 0.0, 0.0)


def circle(radius_m=0.05, time_s=1.0):
    return Circle(tip(LENGTHS, START), radius_m, time_s)


MOTIONS = {
    "quintic": lambda: Quintic(START, (0.5, -0.5, 0.5), 0.8),
    "circle": lambda: circle(0.05, 0.8),
    "transformed circle": lambda: Transformed(circle(0.05, 0.8), LENGTHS, START),
    "transformed quintic": lambda: Transformed(Quintic(tip(LENGTHS, START), (-0.05, -0.05, 0.3), 0.8), LENGTHS, START),
}


def differences_agree(motion, times, h=1e-5):
    """Compare velocity and acceleration with central differences.

    Truncation h^2 / 6 times the next two derivatives (below 1e4 and 1e6 in each unit here), rounding 1e-14 / h.
    """
    for t in times:
        (before, v_before, _), (_, v, a), (after, v_after, _) = (motion.at(t + s * h) for s in (-1, 0, 1))
        assert v == pytest.approx((np.array(after) - before) / (2 * h), abs=1e-6)
        assert a == pytest.approx((np.array(v_after) - v_before) / (2 * h), abs=1e-4)


@pytest.mark.parametrize("name", MOTIONS)
def test_starts_and_ends_at_rest(name):
    motion = MOTIONS[name]()
    start, end = motion.at(0.0), motion.at(0.8)
    for _, v, a in (start, end):
        assert v == pytest.approx(ZERO, abs=1e-12)
        assert a == pytest.approx(ZERO, abs=1e-9)
    assert motion.at(2.0)[0] == pytest.approx(end[0], abs=1e-12)


@pytest.mark.parametrize("name", MOTIONS)
def test_holds_its_start_before_and_its_end_after(name):
    motion = MOTIONS[name]()
    start = motion.at(-1.0)
    assert motion.at(-1e-9) == start == motion.at(0.0)
    end = motion.at(0.8)
    assert motion.at(0.8 + 1e-9)[0] == pytest.approx(end[0], abs=1e-15)
    assert motion.at(1e6) == motion.at(0.9)


@pytest.mark.parametrize("name", MOTIONS)
def test_velocity_and_acceleration_are_the_derivatives(name):
    differences_agree(MOTIONS[name](), np.linspace(0.01, 0.79, 79))


def test_quintic_arrives_and_is_symmetric():
    motion = Quintic((1.0, -2.0), (0.5, 4.0), 2.0)
    assert motion.at(0.0)[0] == (1.0, -2.0)
    assert motion.at(1.0)[0] == pytest.approx((1.25, 0.0))
    assert motion.at(2.0)[0] == pytest.approx((1.5, 2.0))
    assert motion.at(1.0)[1] == pytest.approx((0.5 * 1.875 / 2.0, 4.0 * 1.875 / 2.0))


@given(phase=st.floats(-2.0, 3.0))
def test_quintic_against_its_polynomial(phase):
    p = min(1.0, max(0.0, phase))
    value = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
    expected = value(p), value.deriv()(p), value.deriv(2)(p)
    assert quintic(phase) == pytest.approx(expected, abs=1e-12)
    assert -1e-15 <= quintic(phase)[0] <= 1 + 1e-15


@pytest.mark.parametrize("radius_m", [0.02, 0.05, 0.1])
@pytest.mark.parametrize("time_s", [0.5, 1.0])
def test_circle_goes_once_round_counter_clockwise_from_the_tip(radius_m, time_s):
    motion = circle(radius_m, time_s)
    x0, y0, phi = tip(LENGTHS, START)
    assert motion.at(0.0)[0] == (x0, y0, phi)
    assert motion.at(time_s)[0] == pytest.approx((x0, y0, phi), abs=1e-15)
    turned, before = 0.0, 0.0
    for t in np.linspace(0.0, time_s, 501):
        (x, y, held), (vx, vy, turn_rate), (_, _, turn_acceleration) = motion.at(t)
        dx, dy = x - (x0 - radius_m), y - y0
        assert hypot(dx, dy) == pytest.approx(radius_m, abs=1e-14)
        assert (held, turn_rate, turn_acceleration) == (phi, 0.0, 0.0)
        assert dx * vy - dy * vx >= -1e-15  # counter-clockwise
        angle = atan2(dy, dx)
        turned += (angle - before + pi) % (2 * pi) - pi
        before = angle
    assert turned == pytest.approx(2 * pi, abs=1e-9)


@pytest.mark.parametrize(("radius_m", "time_s"), [(0.05, 1.0), (0.1, 2.0)])
def test_circles_peak_speed(radius_m, time_s):
    speeds = [hypot(*circle(radius_m, time_s).at(t)[1][:2]) for t in np.linspace(0.0, time_s, 1001)]
    assert max(speeds) == pytest.approx(2 * pi * radius_m * 1.875 / time_s, rel=1e-12)
    assert speeds.index(max(speeds)) == 500


def test_peak_speed_of_the_papers_circle_is_59_cm_s():
    assert 2 * pi * 0.05 * 1.875 == pytest.approx(0.59, abs=0.001)


@pytest.mark.parametrize("start", [(0.4, 0.9, -0.5), (0.4, -0.9, 0.5), (3.0, 1.2, 0.8), (-3.1, -1.4, 0.2)])
def test_transformed_follows_its_path_on_its_side_of_the_elbow(start):
    path = Circle(tip(LENGTHS, start), 0.04, 1.0)
    motion = Transformed(path, LENGTHS, start)
    before = np.array(start)
    for t in np.linspace(0.0, 1.0, 1001):
        q, _, _ = motion.at(t)
        assert tip(LENGTHS, q) == pytest.approx(path.at(t)[0], abs=1e-12)
        assert np.abs(np.array(q) - before).max() < 0.02  # no jump to another turn or side
        before = np.array(q)
    assert before == pytest.approx(start, abs=1e-9)


def test_transformed_passes_pi():
    start = (3.0, 0.9, -0.5)
    path = Transformed(Quintic(tip(LENGTHS, start), ZERO, 1.0), LENGTHS, start)
    assert path.at(0.5)[0] == pytest.approx(start, abs=1e-9)

    class Round:
        """The tip on a circle about the base."""

        def at(self, t_s):
            position = tip(LENGTHS, (3.0 + t_s, 0.9, -0.5))
            x, y, _ = position
            return position, (-y, x, 1.0), (-x, -y, 0.0)

    motion = Transformed(Round(), LENGTHS, start)
    for t in np.linspace(0.0, 7.0, 701):
        q, w, a = motion.at(t)
        assert q == pytest.approx((3.0 + t, 0.9, -0.5), abs=1e-9)
        assert w == pytest.approx((1.0, 0.0, 0.0), abs=1e-9)
        assert a == pytest.approx(ZERO, abs=1e-9)


def test_transformed_refuses_what_cannot_be_followed():
    x = tip(LENGTHS, START)
    with pytest.raises(OutOfReach, match="move the path inside"):
        Transformed(Quintic(x, (1.0, 0.0, 0.0), 1.0), LENGTHS, START).at(1.0)
    stretched = (0.3, 0.01, 0.1)
    with pytest.raises(SingularPoint, match=r"q2 = 0\.0100 rad"):
        Transformed(Circle(tip(LENGTHS, stretched), 0.01, 1.0), LENGTHS, stretched).at(0.0)


def test_path_is_its_legs_one_after_the_other_at_rest_between_them():
    """Against the quintic of each leg, written out; a leg that goes nowhere is a rest."""
    path = Path((1.0, 2.0, 0.5), [((0.1, 0.0, 0.0), 0.5), ((0.0, 0.0, 0.0), 0.2), ((0.0, -0.2, 0.0), 1.0)])
    assert path.time_s == pytest.approx(1.7)
    assert path.at(-1.0) == ((1.0, 2.0, 0.5), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert path.at(0.25)[0] == pytest.approx((1.05, 2.0, 0.5))
    assert path.at(0.25)[1] == pytest.approx((0.1 / 0.5 * 15 / 8, 0.0, 0.0))  # the quintic's rate at half its time
    for t_s in (0.5, 0.6, 0.7):
        assert path.at(t_s) == (pytest.approx((1.1, 2.0, 0.5)), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert path.at(1.2)[0] == pytest.approx((1.1, 1.9, 0.5))
    assert path.at(9.0) == (pytest.approx((1.1, 1.8, 0.5)), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
