"""Encoder counts: floor, wrap, both directions."""

from math import tau

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plant.encoder import Encoder
from plant.parameters import DEFAULT_ARM
from plant.robot import Robot

CPR = 819_200


@given(count=st.integers(-(10**7), 10**7), inside=st.floats(0.01, 0.99), zero_rad=st.floats(-3.0, 3.0))
def test_count_is_the_floor_modulo_the_counter(count, inside, zero_rad):
    q_rad = zero_rad + (count + inside) * tau / CPR
    assert Encoder(zero_rad, CPR, 16).counts(q_rad) == count % 65536


@given(start=st.integers(-(10**6), 10**6), move=st.integers(-32768, 32767))
def test_differences_unwrap_up_to_half_the_counter(start, move):
    encoder = Encoder(0.0, CPR, 16)
    before, after = (encoder.counts((count + 0.5) * tau / CPR) for count in (start, start + move))
    assert (after - before + 32768) % 65536 - 32768 == move


@pytest.mark.parametrize(
    ("q_rad", "bits", "expected"),
    [(0.0, 16, 0), (1e-12, 16, 0), (-1e-12, 16, 65535), (-1e-12, 20, (1 << 20) - 1), (0.51, 16, 66493 - 65536)],
)
def test_zero_is_where_the_counter_starts_and_16_bits_wrap_after_half_a_radian(q_rad, bits, expected):
    assert Encoder(0.0, CPR, bits).counts(q_rad) == expected


def test_robots_counters_are_zero_in_the_start_pose():
    assert Robot(DEFAULT_ARM, (0.4, 0.9, -0.5)).counts() == (0, 0, 0)
