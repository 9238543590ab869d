"""Figures of one signal against closed forms and the slowest way to count."""

from math import log10

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.quantise.measure import Reference, bits_used, histogram, measure, sqnr_db
from hil.quantise.signals import SATURATED, UNDERFLOWED, Signal, Trace

WORDS = st.lists(st.integers(-(2**31), 2**31 - 1) | st.integers(-9, 9), min_size=1, max_size=20)


@given(values=WORDS)
def test_bits_used_are_those_of_the_shortest_word_that_holds_all(values):
    fits = next(b for b in range(1, 33) if all(-(2 ** (b - 1)) <= value < 2 ** (b - 1) for value in values))
    assert bits_used(np.array(values), signed=True) == fits


@given(values=st.lists(st.integers(0, 2**16 - 1), min_size=1))
def test_a_counter_needs_no_sign(values):
    fits = next(b for b in range(17) if all(value < 2**b for value in values))
    assert bits_used(np.array(values), signed=False) == fits


@given(values=WORDS)
def test_the_histogram_counts_by_powers_of_two(values):
    expected = [0] * 33
    for value in values:
        expected[abs(value).bit_length()] += 1
    assert histogram(np.array(values), 32) == expected


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_sqnr_of_a_rounded_sine_is_the_textbooks(bits):
    """6.02 b + 1.76 dB for a full-scale sine of b bits (power 4^b / 8 over 1/12): 0.1 dB, since its error is not quite
    white; cycles and samples share no factor, so that every phase comes once.
    """
    sine = 2 ** (bits - 1) * np.sin(2 * np.pi * 997 * np.arange(65536) / 65536)
    assert sqnr_db(sine, np.rint(sine)) == pytest.approx(10 * log10(4**bits / 8 * 12), abs=0.1)


def test_no_error_and_no_signal_have_no_ratio():
    some, none = np.array([1.0, -2.0]), np.zeros(2)
    assert sqnr_db(some, some) is None
    assert sqnr_db(none, some) is None
    assert sqnr_db(none, none) is None


def row_of(raw, became, at_s, exact, fraction=0, bits=16):
    signal = Signal("x", "count", bits=bits, fraction=fraction)
    reference = Reference(np.array(exact, dtype=float), np.array(raw) / 2**fraction)
    return measure(signal, 2, Trace.of(raw, became), np.array(at_s, dtype=float), reference)


def test_a_row_says_how_often_and_when_first():
    row = row_of(
        [5, -3, 32767, 0, 32767], [0, 0, SATURATED, UNDERFLOWED, SATURATED], [0, 1, 2, 3, 4], [5, -3, 4e4, 0, 0]
    )
    assert (row["name"], row["joint"], row["q_format"]) == ("x", 2, "Q15.0")
    assert (row["min"], row["max"], row["bits_used"], row["headroom_bits"]) == (-3, 32767, 16, 0)
    assert (row["saturations"], row["first_saturation_s"]) == (2, 2)
    assert (row["underflows"], row["first_underflow_s"]) == (1, 3)
    assert (row["wraps"], row["first_wrap_s"]) == (0, None)
    assert row["largest_error"] == 32767
    assert row["sqnr_same_constants_db"] is None


def test_fraction_bits_stand_behind_the_point():
    """Two values in each sample, as d has: the third is of the second sample."""
    row = row_of(
        [-65536, 98304, 32768, 0], [0, 0, SATURATED, 0], [0, 0.5], [-1.0, 1.5, 0.25, 0.0], fraction=16, bits=32
    )
    assert (row["min"], row["max"], row["largest_error"], row["first_saturation_s"]) == (-1.0, 1.5, 0.25, 0.5)
    assert (row["q_format"], row["bits_used"], row["headroom_bits"]) == ("Q15.16", 18, 14)
