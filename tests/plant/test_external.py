"""Torques from outside as functions of time: areas, changes, and what they do to a joint."""

from math import cos, sin

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from plant.external import HOLD_NS, ExternalTorque, changes

MS = 1_000_000


def held_area(torques, joint, from_ns, to_ns):
    """Return the integral [N m s] of what the arm is given, from the changes alone."""
    area, value, since = 0.0, 0.0, from_ns
    for at_ns, where, torque_Nm in [*changes(torques, from_ns, to_ns), (to_ns, joint, 0.0)]:
        if where == joint:
            area += value * (at_ns - since) * 1e-9
            value, since = torque_Nm, at_ns
    return area


@given(
    st.floats(-50, 50), st.floats(1.0, 2500.0), st.integers(0, 3 * MS), st.integers(1, 5 * MS), st.integers(1, 20 * MS)
)
def test_area_of_a_sine_is_exact_up_to_its_last_hold(amplitude, rad_s, at_ns, lasts_ns, end_ns):
    """Each hold has the area of the sine over it; only a hold that is cut short differs, by less than it can be."""
    torque = ExternalTorque(1, amplitude, rad_s, at_ns, at_ns + lasts_ns)
    begin, end = at_ns, min(at_ns + lasts_ns, end_ns)
    expected = quad(lambda t: amplitude * sin(rad_s * (t - at_ns * 1e-9)), begin * 1e-9, end * 1e-9, limit=500)[0]
    found = held_area([torque], 1, 0, end_ns)
    if end_ns > at_ns:
        cut = abs(amplitude) * rad_s * (HOLD_NS * 1e-9) ** 2
        assert found == pytest.approx(expected, abs=cut + 1e-9)
    else:
        assert found == 0.0


def test_hold_has_the_mean_of_the_sine_over_it():
    torque = ExternalTorque(1, 2.0, 1000.0, 10 * MS, 20 * MS)
    a, b = 1000.0 * 3 * HOLD_NS * 1e-9, 1000.0 * 4 * HOLD_NS * 1e-9
    assert torque.held(10 * MS + 3 * HOLD_NS) == pytest.approx(2.0 * (cos(a) - cos(b)) / (b - a), rel=1e-12)
    assert torque.held(10 * MS + 4 * HOLD_NS - 1) == torque.held(10 * MS + 3 * HOLD_NS)


def test_step_changes_twice_and_periods_join_without_a_gap():
    torque = ExternalTorque(2, -3.0, 0.0, 1_500_000, 4_000_000)
    found = [change for k in range(6) for change in changes([torque], k * MS, (k + 1) * MS)]
    assert found == [(1_500_000, 2, -3.0), (4_000_000, 2, 0.0)]


def test_torques_on_one_joint_add_up_and_others_are_left_alone():
    torques = [ExternalTorque(1, 1.0, 0.0, 0, 10 * MS), ExternalTorque(1, 2.0, 0.0, 5 * MS, 10 * MS)]
    torques.append(ExternalTorque(3, 7.0, 0.0, 5 * MS, 6 * MS))
    found = changes(torques, 0, 20 * MS)
    assert found == [(0, 1, 1.0), (5 * MS, 1, 3.0), (5 * MS, 3, 7.0), (6 * MS, 3, 0.0), (10 * MS, 1, 0.0)]


@given(st.integers(0, 10 * MS), st.integers(0, 10 * MS), st.integers(1, 3 * MS))
def test_changes_of_a_period_are_those_of_its_halves(at_ns, from_ns, half_ns):
    torque = ExternalTorque(1, 1.0, 700.0, at_ns, at_ns + 5 * MS)
    whole = changes([torque], from_ns, from_ns + 2 * half_ns)
    halves = [changes([torque], from_ns + k * half_ns, from_ns + (k + 1) * half_ns) for k in (0, 1)]
    assert whole == halves[0] + halves[1]
