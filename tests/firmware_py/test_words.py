"""Word arithmetic against a model made of ranges and remainders, for word lengths 8 to 32."""

from math import floor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_py.words import InstrumentedWords, Words

SIGNALS = 4
KINDS = [Words, InstrumentedWords]
INTEGERS = {8: np.int8, 16: np.int16, 32: np.int32, 64: np.int64}


def range_of(bits):
    return -(2 ** (bits - 1)), 2 ** (bits - 1) - 1


@st.composite
def bits_and_value(draw, factor=1, room=3):
    """A word length and a value around the edges of factor words, or far beyond."""
    bits = draw(st.integers(8, 32))
    low, high = range_of(factor * bits)
    near = st.sampled_from([low, high, 0, -1, 2 * low, 2 * high]).flatmap(lambda x: st.integers(x - 3, x + 3))
    return bits, draw(near | st.integers(room * low, room * high))


@pytest.mark.parametrize("kind", KINDS)
@given(case=bits_and_value())
def test_wrap_is_the_remainder_in_range(kind, case):
    bits, x = case
    low, high = range_of(bits)
    wrapped = kind(bits, SIGNALS).wrap(0, x)
    assert low <= wrapped <= high
    assert (wrapped - x) % 2**bits == 0


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("bits", [8, 16, 32])
@given(data=st.data())
def test_wrap_is_numpys_cast(kind, bits, data):
    x = data.draw(st.integers(-(2**62), 2**62))
    assert kind(bits, SIGNALS).wrap(1, x) == int(np.array([x], dtype=np.int64).astype(INTEGERS[bits])[0])


@pytest.mark.parametrize("kind", KINDS)
@given(case=bits_and_value())
def test_saturate_is_the_nearest_word_and_counts_by_signal(kind, case):
    bits, x = case
    low, high = range_of(bits)
    words = kind(bits, SIGNALS)
    assert words.saturate(2, x) == sorted((low, x, high))[1]
    assert words.saturations == [0, 0, int(not low <= x <= high), 0]


@pytest.mark.parametrize("kind", KINDS)
@given(case=bits_and_value(factor=2))
def test_saturate_d_is_the_nearest_double_and_counts_by_signal(kind, case):
    bits, x = case
    low, high = range_of(2 * bits)
    words = kind(bits, SIGNALS)
    assert words.saturate_d(3, x) == sorted((low, x, high))[1]
    assert words.saturations == [0, 0, 0, int(not low <= x <= high)]


@pytest.mark.parametrize("kind", KINDS)
@given(case=bits_and_value(), share=st.floats(0.0, 1.0))
def test_limit_is_symmetric_and_counts_by_signal(kind, case, share):
    bits, x = case
    bound = int(share * range_of(bits)[1])
    words = kind(bits, SIGNALS)
    assert words.limit(0, x, bound) == sorted((-bound, x, bound))[1]
    assert words.saturations == [int(abs(x) > bound), 0, 0, 0]


@pytest.mark.parametrize("kind", KINDS)
@given(bits=st.integers(8, 32), calls=st.lists(st.tuples(st.integers(0, 3), st.integers(-400, 400)), max_size=30))
def test_each_saturation_is_counted_under_its_signal(kind, bits, calls):
    words = kind(bits, SIGNALS)
    expected = [0] * SIGNALS
    for signal, size in calls:
        x = size * 2 ** (bits - 8)
        words.saturate(signal, x)
        expected[signal] += not -(2 ** (bits - 1)) <= x < 2 ** (bits - 1)
    assert words.saturations == expected


@pytest.mark.parametrize("kind", KINDS)
@given(x=st.integers(-(2**31), 2**31 - 1), count=st.integers(0, 20))
def test_shifts_floor(kind, x, count):
    words = kind(16, SIGNALS)
    assert words.shift_right(x, count) == floor(x / 2**count)  # exact in float64: |x| < 2^53


@pytest.mark.parametrize("kind", KINDS)
@given(case=bits_and_value(factor=2, room=1))
def test_whole_floors_and_speed_in_d_goes_back(kind, case):
    bits, x = case
    words = kind(bits, SIGNALS)
    high = words.whole(0, x)
    assert words.speed_in_d(high) <= x < words.speed_in_d(high + 1)
    assert words.speed_in_d(high) == high * 2**bits
    assert words.whole(0, words.speed_in_d(high)) == high


@pytest.mark.parametrize(("x", "high"), [(-1, -1), (-65536, -1), (-65537, -2), (65535, 0), (65536, 1), (0, 0)])
def test_whole_at_16_bit_edges(x, high):
    assert Words().whole(0, x) == high


@pytest.mark.parametrize("kind", KINDS)
@given(x=st.integers(-(2**15), 2**15 - 1), y=st.integers(-(2**15), 2**15 - 1))
def test_multiply_add_subtract_are_exact(kind, x, y):
    words = kind()
    product = words.multiply(x, y)
    assert product == int(np.int64(x) * np.int64(y))
    assert words.add(product, x) == x * y + x
    assert words.subtract(product, x) == x * y - x


@st.composite
def programs(draw):
    """A word length and calls whose operands fit."""
    bits = draw(st.integers(8, 32))
    word, double = (st.integers(*range_of(n)) for n in (bits, 2 * bits))
    wide = st.integers(3 * range_of(2 * bits)[0], 3 * range_of(2 * bits)[1])
    signal, bound, shift = st.integers(0, SIGNALS - 1), st.integers(0, range_of(bits)[1]), st.integers(0, bits)
    forms = [
        st.tuples(st.just("multiply"), word, word),
        *(st.tuples(st.just(name), double, double) for name in ("add", "subtract")),
        *(st.tuples(st.just(name), signal, wide) for name in ("wrap", "saturate", "saturate_d")),
        st.tuples(st.just("limit"), signal, wide, bound),
        st.tuples(st.just("shift_right"), double, shift),
        *(st.tuples(st.just(name), double) for name in ("speed_in_d", "current_in_d")),
        st.tuples(st.just("whole"), signal, double),
        st.tuples(st.just("saturate_speed"), signal, wide),
    ]
    return bits, draw(st.lists(st.one_of(forms), max_size=30))


@given(program=programs())
def test_instrumented_words_compute_the_same_and_count(program):
    bits, calls = program
    bare, counted = Words(bits, SIGNALS), InstrumentedWords(bits, SIGNALS)
    seen = [[] for _ in range(SIGNALS)]
    wraps = [0] * SIGNALS
    for name, *operands in calls:
        result = getattr(bare, name)(*operands)
        assert getattr(counted, name)(*operands) == result
        if name in ("wrap", "saturate", "saturate_d", "saturate_speed", "limit"):
            seen[operands[0]].append(result)
            wraps[operands[0]] += name == "wrap" and result != operands[1]
    names = [name for name, *_ in calls]
    assert counted.multiplications == names.count("multiply")
    assert counted.additions == names.count("add") + names.count("subtract")
    assert counted.saturations == bare.saturations
    assert counted.wraps == wraps
    assert counted.minimum == [min(values, default=None) for values in seen]
    assert counted.maximum == [max(values, default=None) for values in seen]


@pytest.mark.parametrize("bits", [8, 16, 32])
@pytest.mark.parametrize(("operation", "factor"), [("multiply", 1), ("add", 2), ("subtract", 2)])
@pytest.mark.parametrize("position", [0, 1])
@pytest.mark.parametrize(("beyond", "fits"), [((1, 0), True), ((1, 1), False), ((0, 0), True), ((0, -1), False)])
def test_instrumented_words_refuse_what_no_operand_holds(bits, operation, factor, position, beyond, fits):
    edge, step = beyond
    operands = [0, 0]
    operands[position] = range_of(factor * bits)[edge] + step
    words = InstrumentedWords(bits, SIGNALS)
    if fits:
        getattr(words, operation)(*operands)
        assert words.multiplications + words.additions == 1
    else:
        with pytest.raises(OverflowError, match=f"operand {operands[position]} does not fit {factor * bits} bits"):
            getattr(words, operation)(*operands)
        assert words.multiplications + words.additions == 0


def test_default_is_the_8086s_word():
    words = Words()
    assert (words.bits, words.low_word, words.high_word) == (16, -32768, 32767)
