"""The words against apytypes: all pairs of edges of 16 bits, and a million pairs at random.

A limit that is no format's end has nothing there to be judged by: it is in test_words.py.
"""

import numpy as np
import pytest
from apytypes import APyFixedArray, OverflowMode, QuantizationMode

from firmware_py.words import Words

PAIRS = 1_000_000
EDGES = sorted(
    {sign * (1 << k) + off for k in range(16) for sign in (1, -1) for off in (-1, 0, 1)} & {*range(-32768, 32768)}
)
WRAP, SAT = OverflowMode.WRAP, OverflowMode.SAT
FLOOR, NEAREST = QuantizationMode.TO_NEG, QuantizationMode.TIES_POS


@pytest.fixture(scope="module")
def pairs():
    """(x, y) of words."""
    rng = np.random.default_rng(19)
    edges = np.array(np.meshgrid(EDGES, EDGES)).reshape(2, -1)
    return np.concatenate([edges, rng.integers(-32768, 32768, (2, PAIRS))], axis=1)


@pytest.fixture(scope="module")
def products(pairs):
    """Doubles: products of the pairs, and the edges of doubles."""
    return np.concatenate([pairs[0] * pairs[1], [-(1 << 31), (1 << 31) - 1, -(1 << 16), (1 << 16) - 1]])


def fixed(values, bits, fraction=0):
    """The oracle's numbers from raw integers."""
    return APyFixedArray((values & ((1 << bits) - 1)).tolist(), int_bits=bits - fraction, frac_bits=fraction)


def raw(numbers):
    """Its raw integers, with their sign."""
    bits = numbers.bits
    values = np.array(numbers.to_bits(), dtype=np.int64)
    return np.where(values >> (bits - 1), values - (1 << bits), values)


def ours(operation, *operands):
    return np.array([operation(*row) for row in zip(*(each.tolist() for each in operands), strict=True)])


@pytest.mark.parametrize(
    ("name", "theirs"),
    [("multiply", lambda x, y: x * y), ("add", lambda x, y: x + y), ("subtract", lambda x, y: x - y)],
)
def test_products_and_sums(pairs, name, theirs):
    x, y = pairs
    assert np.array_equal(ours(getattr(Words(), name), x, y), raw(theirs(fixed(x, 16), fixed(y, 16))))


@pytest.mark.parametrize(("name", "mode"), [("wrap", WRAP), ("saturate", SAT)])
def test_back_to_a_word(products, name, mode):
    words = Words()
    expected = raw(fixed(products, 32).cast(int_bits=16, frac_bits=0, overflow=mode))
    operation = getattr(words, name)
    assert np.array_equal(ours(lambda x: operation(0, x), products), expected)
    assert words.saturations[0] == (0 if mode == WRAP else np.sum(expected != products))


def test_back_to_a_double(products):
    words = Words()
    doubled = products + products[::-1]
    expected = raw(fixed(doubled, 33).cast(int_bits=32, frac_bits=0, overflow=SAT))
    assert np.array_equal(ours(lambda x: words.saturate_d(0, x), doubled), expected)
    assert words.saturations[0] == np.sum(expected != doubled)


@pytest.mark.parametrize("count", [0, 1, 13, 15])
@pytest.mark.parametrize(("name", "mode"), [("shift_right", FLOOR), ("reference_current", NEAREST)])
def test_shifts_to_the_right(products, name, mode, count):
    some = products[:: 1 if count == 13 else 20]
    operation = getattr(Words(), name)
    expected = raw(fixed(some, 32, count).cast(int_bits=33, frac_bits=0, quantization=mode))
    assert np.array_equal(ours(lambda x: operation(x, count), some), expected)


def test_halves_of_a_double(pairs, products):
    words = Words()
    high = raw(fixed(products, 32, 16).cast(int_bits=16, frac_bits=0, quantization=FLOOR))
    assert np.array_equal(ours(lambda x: words.whole(0, x), products), high)
    assert np.array_equal(ours(words.speed_in_d, pairs[0]), raw(fixed(pairs[0], 16).cast(int_bits=16, frac_bits=16)))


def test_a_shift_to_the_left_loses_nothing(products):
    some = products[::4]
    shifted = raw(fixed(some, 32).cast(int_bits=32, frac_bits=1))
    assert np.array_equal(ours(Words().current_in_d, some), shifted)
