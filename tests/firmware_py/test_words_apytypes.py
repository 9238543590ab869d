"""The words against apytypes: all pairs of edges of 16 bits, and a million pairs at random.

A limit that is no format's end has nothing there to be judged by: it is in test_words.py.
"""

import numpy as np
import pytest
from apytypes import APyFixedArray, OverflowMode, QuantizationMode

from firmware_py.words import ROUNDINGS, Words, rounded
from tests.conftest import untraced

PAIRS = 1_000_000
COVERED = 1000
EDGES = sorted(
    {sign * (1 << k) + off for k in range(16) for sign in (1, -1) for off in (-1, 0, 1)} & {*range(-32768, 32768)}
)
WRAP, SAT = OverflowMode.WRAP, OverflowMode.SAT
FLOOR = QuantizationMode.TO_NEG
ROUNDED = dict(
    zip(
        ROUNDINGS,
        (FLOOR, QuantizationMode.TIES_POS, QuantizationMode.TIES_EVEN, QuantizationMode.TO_ZERO),
        strict=True,
    )
)
OVERFLOWED = {"saturate": SAT, "wrap": WRAP}


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
    """What an operation makes of each row; the last thousand are enough to cover it."""
    rows = list(zip(*(each.tolist() for each in operands), strict=True))
    with untraced():
        most = [operation(*row) for row in rows[:-COVERED]]
    return np.array(most + [operation(*row) for row in rows[-COVERED:]])


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
def test_shifts_to_the_right(products, count):
    some = products[:: 1 if count == 13 else 20]
    expected = raw(fixed(some, 32, count).cast(int_bits=33, frac_bits=0, quantization=FLOOR))
    assert np.array_equal(ours(lambda x: Words().shift_right(x, count), some[:1000]), expected[:1000])
    assert np.array_equal(ours(lambda x: rounded(x, count, 0), some), expected)


@pytest.mark.parametrize("rounding", ROUNDINGS)
def test_every_rounding(products, rounding):
    """Each place where the step rounds: KJ a_ref by any shift, d to its estimate, both terms of d where it is short."""
    mode = ROUNDINGS.index(rounding)
    quantization = ROUNDED[rounding]
    words = Words(d_fraction=8, kb_fraction=11, roundings=(mode, mode, mode))
    for count, some in {0: products[::50], 1: products[::50], 13: products, 15: products[::50]}.items():
        expected = raw(fixed(some, 32, count).cast(int_bits=34, frac_bits=0, quantization=quantization))
        assert np.array_equal(ours(lambda x, count=count: words.reference_current(x, count), some), expected)
    for operation, fraction in ((words.speed_in_d, 11), (words.current_in_d, 15)):
        some = products[::3]
        expected = raw(fixed(some, 32, fraction).cast(int_bits=34 - fraction, frac_bits=8, quantization=quantization))
        assert np.array_equal(ours(operation, some), expected)
    d = products >> 8  # a word and 8 bits
    whole = fixed(d, 24, 8).cast(int_bits=16, frac_bits=0, quantization=quantization, overflow=SAT)
    assert np.array_equal(ours(lambda x: words.whole(0, x), d), raw(whole))


@pytest.mark.parametrize("overflow", OVERFLOWED)
def test_every_overflow(products, overflow):
    """Back to a word, to a word with KB's fraction, to a word with d's; and rounded to what no word holds."""
    words = Words(signals=3, kb_fraction=4, wraps_over=overflow == "wrap", roundings=(0, 1, 1))
    sums = products + products[::-1]
    cases = [(words.saturate, products, 16), (words.saturate_speed, products, 20), (words.saturate_d, sums, 32)]
    for signal, (operation, values, bits) in enumerate(cases):
        expected = raw(fixed(values, 33).cast(int_bits=bits, frac_bits=0, overflow=OVERFLOWED[overflow]))
        assert np.array_equal(ours(lambda x, op=operation, n=signal: op(n, x), values), expected)
        assert words.saturations[signal] == np.sum(expected != values)
    d = np.array([(1 << 31) - 1, (1 << 31) - (1 << 15), (1 << 31) - (1 << 15) - 1, -(1 << 31)])
    whole = fixed(d, 32, 16).cast(
        int_bits=16, frac_bits=0, quantization=ROUNDED["nearest"], overflow=OVERFLOWED[overflow]
    )
    assert np.array_equal(ours(lambda x: words.whole(0, x), d), raw(whole))


@pytest.mark.parametrize("overflow", OVERFLOWED)
def test_between_the_buss_counts_and_the_steps(pairs, overflow):
    """Finer and coarser by 3 bits; a coarse current that the bus cannot show; a fine reference that no word holds."""
    x = pairs[0][:100_000]
    how = {"quantization": ROUNDED["nearest"], "overflow": OVERFLOWED[overflow]}
    for places in (3, -3):
        words = Words(current_shift=places, acceleration_shift=places, wraps_over=overflow == "wrap")
        finer = raw(fixed(x, 16).cast(int_bits=16 - places, frac_bits=places, **how))
        assert np.array_equal(ours(lambda v, words=words: words.acceleration_from_bus(0, v), x), finer)
        shown = raw(fixed(x, 16, places).cast(int_bits=16, frac_bits=0, **how))
        assert np.array_equal(ours(lambda v, words=words: words.current_to_bus(0, v), x), shown)
        assert words.saturations[0] == np.sum((x > 4095) | (x < -4096))


def test_halves_of_a_double(pairs, products):
    words = Words()
    high = raw(fixed(products, 32, 16).cast(int_bits=16, frac_bits=0, quantization=FLOOR))
    assert np.array_equal(ours(lambda x: words.whole(0, x), products), high)
    assert np.array_equal(ours(words.speed_in_d, pairs[0]), raw(fixed(pairs[0], 16).cast(int_bits=16, frac_bits=16)))


def test_a_shift_to_the_left_loses_nothing(products):
    some = products[::4]
    shifted = raw(fixed(some, 32).cast(int_bits=32, frac_bits=1))
    assert np.array_equal(ours(Words().current_in_d, some), shifted)
