"""Word lengths: the knee by its definition, read off the rows again; formats alone that are those of short words."""

from math import inf

import pytest

from dbc.compiler import load_arm
from hil import scenario_file
from hil.constants import parameter_table
from hil.quantise import word_length
from hil.quantise.word_length import COUNTER, _Judge, word_lengths
from hil.quantise.words_show import explained
from hil.word_format import WordFormat, with_word

CODEC = load_arm()
PAPER = scenario_file.load("paper-joint")
COUNT_RAD = 2 * 3.141592653589793 / 819_200


@pytest.fixture(scope="module")
def paper():
    return word_lengths(PAPER)


def test_the_knee_is_where_ten_per_cent_and_a_count_are_kept_from_there_on(paper):
    assert [row["bits"] for row in paper["lengths"]] == list(range(8, 33))
    best = paper["lengths"][-1]

    def kept(row):
        return row["overflows"] == 0 and all(
            x <= 1.1 * y + COUNT_RAD
            for name in ("max_deviation_rad", "final_deviation_rad")
            for x, y in zip(row[name], best[name], strict=True)
        )

    below = [row["bits"] for row in paper["lengths"] if not kept(row)]
    assert paper["knee_bits"] == max(below) + 1 == 13


def test_what_fails_first_is_the_worst_alone_of_the_longest_words_in_which_one_does(paper):
    first, alone = paper["fails_first"], paper["alone"]
    assert first["what"] == "current count"  # and as of the paper's 16 bits, nobody's: 13 are enough
    assert first["excess"] == max(row["excess"] for row in alone if row["excess"] is not None) > 1.0
    assert all(row["excess"] <= 1.0 for row in alone if row["bits"] > first["bits"])
    assert {row["bits"] for row in alone} == set(range(first["bits"], paper["knee_bits"]))
    lines = list(explained(paper))
    assert "knee: 13 bits are enough, 12 are not" in lines
    assert f"  fails first: current count, from {first['bits']} bits down" in lines


def test_a_format_alone_is_that_of_the_short_word(paper):
    """By what the constants and counts are worth, in the bus's counts."""
    for row in paper["alone"]:
        short_scenario = with_word(PAPER, bits=row["bits"])
        scenario = with_word(PAPER, **row["formats"])
        short, alone, usual = (WordFormat.of(each, CODEC) for each in (short_scenario, scenario, PAPER))
        last_bits = {
            "current count": lambda form: form.current,
            "acceleration count": lambda form: form.acceleration,
            "last bit of d": lambda form: form.current + form.d_fraction,
            "last bit of KB": lambda form: form.kb_places,
        }
        for what, last_bit in last_bits.items():
            if what == row["what"]:
                assert last_bit(alone) == last_bit(short) < last_bit(usual)
            elif (row["what"], what) != ("current count", "last bit of d"):  # d's follow the count's
                assert last_bit(alone) == last_bit(usual)
        for joint in (1, 2, 3):
            parameter_table(scenario, joint, CODEC)  # all fit


def test_what_is_beyond_is_counted_in_what_is_allowed():
    best = {"reason": "", "overflows": 0, "max_deviation_rad": [100e-6], "final_deviation_rad": [1e-6]}
    judge = _Judge(PAPER, best)
    assert judge.excess(best) == 0.0
    assert judge.excess(best | {"max_deviation_rad": [110e-6 + COUNT_RAD]}) == pytest.approx(1.0)
    assert judge.excess(best | {"final_deviation_rad": [1.1e-6 + COUNT_RAD]}) == pytest.approx(1.0)
    assert judge.excess(best | {"overflows": 1}) == judge.excess(best | {"reason": "stopped"}) == inf


def test_a_counter_that_is_too_short_is_named(monkeypatch):
    """A joint that moves by 300 counts a sample needs 10 bits, its sign among them."""
    fast = {"reason": "", "overflows": 0, "counter_bits": 10, "max_deviation_rad": [0.0], "final_deviation_rad": [0.0]}
    monkeypatch.setattr(word_length, "_run", lambda _scenario: fast)
    judge = _Judge(PAPER, fast)
    rows = word_length._alone(PAPER, 11, CODEC, judge)
    assert [row["bits"] for row in rows if row["what"] == COUNTER and row["excess"] == inf] == [9]
    assert word_length._first(rows)["what"] == COUNTER


def test_a_word_that_cannot_hold_its_constants_has_its_reason():
    found = word_lengths(scenario_file.load("five-joints", ["duration_s=0.1"]))
    assert "KB = 0 does not fit" in found["lengths"][0]["reason"]
    assert found["lengths"][0]["excess"] is None
    assert any(line.startswith("8 bits: joint3: KB = 0") for line in explained(found))


def test_a_run_that_never_begins_has_its_reason():
    found = word_lengths(scenario_file.load("linear-joint", ["clock.setup_cycles=10", "duration_s=0.1"]))
    assert found["knee_bits"] is None
    assert "not ready" in found["lengths"][0]["reason"]
    assert any(line.startswith("no knee") for line in explained(found))
