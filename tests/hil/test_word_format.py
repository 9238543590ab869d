"""A scenario's [joint.word] in the joint's step, against the law in exact fractions; and what it refuses."""

from fractions import Fraction
from math import floor

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.compiler import load_arm
from firmware_py.joint_cpu import make_step
from firmware_py.words import ROUNDINGS, Words
from hil import scenario_file
from hil.constants import parameter_table
from hil.errors import ScenarioError
from hil.word_format import WordFormat, words_of

CODEC = load_arm()
HALF = Fraction(1, 2)


def whole(x, rounding):
    """Round a fraction by the name of the rounding, as a textbook has it."""
    if rounding == "floor":
        return floor(x)
    if rounding == "toward-zero":
        return int(x)
    if rounding == "convergent":
        return round(x)
    return floor(x + HALF)


def fitted(x, fraction, bits, overflow):
    """Bring a value with that many bits behind the point into a word of bits."""
    raw = x * Fraction(2) ** fraction
    assert raw.denominator == 1
    low, high = -(1 << (bits - 1)), (1 << (bits - 1)) - 1
    raw = (int(raw) - low) % (1 << bits) + low if overflow == "wrap" else min(max(int(raw), low), high)
    return raw / Fraction(2) ** fraction


def naive_step(word, form, count, count_prev, w_prev, d, a_ref, ka, kb, kj, limit):
    """The law in the bus's counts, every number a fraction, rounded and fitted where the format says so."""
    bits, overflow = form.bits, word.overflow
    ulp = Fraction(1, 2) ** form.current_shift  # one count of the CPU
    a_ulp = Fraction(1, 2) ** form.acceleration_shift
    counter = min(bits, 16)
    w = fitted(Fraction(count - count_prev), 0, counter, "wrap")
    dw = fitted(w - w_prev, 0, counter, "wrap")
    a = fitted(whole(a_ref / a_ulp, "nearest") * a_ulp, form.acceleration_shift, bits, overflow)
    bound = whole(limit / ulp, "nearest") * ulp
    d_ulp = ulp * Fraction(1, 2) ** form.d_fraction

    def in_d(x):
        return whole(x / d_ulp, word.round_d) * d_ulp

    def sized_d(x):
        return fitted(x / ulp, form.d_fraction, bits + form.d_fraction, overflow) * ulp

    pull = fitted(kb * dw, form.kb_fraction, bits + form.kb_fraction, overflow)
    d = sized_d(d - in_d(pull * ulp))
    estimate = fitted(Fraction(whole(d / ulp, word.round_estimate)), 0, bits, overflow) * ulp
    i = whole(kj * a / ulp, word.round_reference) * ulp + estimate
    i = max(-bound, min(bound, i))
    error = fitted((i - estimate) / ulp, 0, bits, overflow) * ulp
    return w, sized_d(d + in_d(ka * error)), i, estimate


formats = st.fixed_dictionaries(
    {
        "bits": st.integers(10, 32),
        "round_d": st.sampled_from(ROUNDINGS),
        "round_estimate": st.sampled_from(ROUNDINGS),
        "round_reference": st.sampled_from(ROUNDINGS),
        "overflow": st.sampled_from(["saturate", "wrap"]),
    }
)


@settings(max_examples=300, deadline=None)
@given(data=st.data(), chosen=formats)
def test_the_step_in_any_format_is_the_law_in_fractions(data, chosen):
    bits = chosen["bits"]
    chosen["d_fraction"] = data.draw(st.integers(0, min(bits, 62 - bits)))
    chosen["kb_fraction"] = data.draw(st.integers(max(-8, 4 - bits), 8))
    chosen["current_fraction"] = 11 + data.draw(st.integers(-4, 12))
    chosen["acceleration_fraction"] = 7 + data.draw(st.integers(-4, 4))
    scenario = scenario_file.load(
        "paper-joint",
        [
            f'joint.word.{key}="{value}"' if isinstance(value, str) else f"joint.word.{key}={value}"
            for key, value in chosen.items()
        ],
    )
    form, words = WordFormat.of(scenario, CODEC), words_of(scenario, CODEC)
    top = form.largest_constant
    ka, kb, kj, shift = (data.draw(st.integers(0, n)) for n in (top, top, top, 15))
    near = st.integers(-40, 40)
    count = data.draw(st.integers(0, 0xFFFF))
    count_prev = data.draw(st.integers(0, 0xFFFF) | near.map(lambda x: (count + x) & 0xFFFF))
    w_prev = data.draw(near | st.integers(-(1 << (min(bits, 16) - 1)), (1 << (min(bits, 16) - 1)) - 1))
    whole_d = bits + form.d_fraction - 1
    d = data.draw(st.integers(-(1 << whole_d), (1 << whole_d) - 1) | st.integers(-1000, 1000))
    a_ref, limit = data.draw(st.integers(-0x8000, 0x7FFF)), data.draw(st.integers(0, 0x3FFF))
    w, d_next, i, estimate = make_step(Words)(words, count, count_prev, w_prev, d, a_ref, ka, kb, kj, shift, limit)
    behind = Fraction(1, 2) ** (form.d_fraction + form.current_shift)
    expected = naive_step(
        scenario.joint.word,
        form,
        *(count, count_prev, w_prev, d * behind, Fraction(a_ref)),
        *(Fraction(ka, 1 << form.ka_fraction), kb * Fraction(1, 2) ** form.kb_fraction),
        *(kj * Fraction(1, 2) ** form.kj_places(shift), Fraction(limit)),
    )
    assert (w, d_next * behind) == expected[:2]
    for ours, theirs in zip((i, estimate), expected[2:], strict=True):
        assert ours == fitted(Fraction(whole(theirs, "nearest")), 0, 16, scenario.joint.word.overflow)


def test_the_default_is_the_8086():
    form = WordFormat.of(scenario_file.load("paper-joint"), CODEC)
    assert form == WordFormat(16, 16, 15, 0, 11, 7, 11, 7)
    assert vars(words_of(scenario_file.load("paper-joint"), CODEC)) == vars(Words(16, 8))


@pytest.mark.parametrize("bits", range(8, 33))
def test_every_word_length_holds_its_constants(bits):
    """To half a unit of each: what a rounding may cost."""
    scenario = scenario_file.load("paper-joint", [f"joint.word.bits={bits}"])
    form = WordFormat.of(scenario, CODEC)
    for joint, (jn, ktn) in enumerate(zip((1.344, 0.537, 0.0832), (10.0, 6.0, 2.0), strict=True), start=1):
        ka, kb, kj, shift, limit = parameter_table(scenario, joint, CODEC)
        assert abs(ka / 2**form.ka_fraction - 0.7) <= 0.5 / 2**form.ka_fraction
        exact = 700.0 * jn / ktn * 2048 * 2 * 3.141592653589793 / 819_200 / 1e-3
        assert abs(kb / 2.0**form.kb_places - exact) <= 0.5 / 2.0**form.kb_places
        assert abs(kj / 2.0 ** form.kj_places(shift) - jn / ktn * 16) <= 0.5 / 2.0 ** form.kj_places(shift)
        assert max(ka, kb, kj) < 1 << (min(bits, 16) - 1)
        assert limit == 16384


@pytest.mark.parametrize(
    ("chosen", "said"),
    [
        (["kb_fraction=5"], r"joint1: KB = 47\d+ does not fit its format Q10.5 .*: Q11.4 can: set joint.word.kb_f"),
        (["bits=8", "current_fraction=5"], r"current limit = 256 does not fit its format Q2.5 .*Q4.3 can"),
        (["bits=8", "kb_fraction=-8"], "kb_fraction = -8 with joint.word.bits = 8: KB dw would have 0 bits: take -6"),
        (["bits=32", "d_fraction=31"], r"d_fraction = 31 .* 63 bits, and 62 is the most: take 30 or less"),
        (
            ["kb_fraction=-16"],
            r"kb_fraction = -16 with .*: KB dw would have 0 bits: take -14 or more",
        ),
        (["bits=40"], "joint.word.bits = 40"),
        (["rounding='floor'"], "unknown key joint.word.rounding"),
    ],
)
def test_a_format_that_cannot_be_is_refused_with_one_that_can(chosen, said):
    def table():
        return parameter_table(scenario_file.load("paper-joint", [f"joint.word.{each}" for each in chosen]), 1, CODEC)

    with pytest.raises(ScenarioError, match=said):
        table()


@pytest.mark.parametrize(("setting", "fraction"), [("kb_fraction", 4), ("kb_fraction", -7)])
def test_what_is_said_to_fit_does(setting, fraction):
    scenario = scenario_file.load("paper-joint", [f"joint.word.{setting}={fraction}"])
    for joint in (1, 2, 3):
        parameter_table(scenario, joint, CODEC)


@pytest.mark.parametrize("bits", [8, 12, 16, 24])
@pytest.mark.parametrize("counts", [6400, 819_200, 2**26])
def test_a_kb_that_is_to_fit_has_all_the_bits_that_the_largest_leaves(bits, counts):
    fixed = [f"joint.word.bits={bits}", f"encoder.counts_per_turn={counts}"]
    scenario = scenario_file.load("paper-joint", [*fixed, "joint.word.kb_fraction=fit"])
    kbs = [parameter_table(scenario, joint, CODEC)[1] for joint in (1, 2, 3)]
    assert 1 << (min(bits, 16) - 2) <= max(kbs) < 1 << (min(bits, 16) - 1)
