"""Proposed formats: as fine as the constants allow, and judged by a run of their own."""

import pytest

from dbc.compiler import load_arm
from hil import scenario_file
from hil.constants import parameter_table
from hil.errors import ScenarioError
from hil.quantise import study as studies
from hil.quantise.proposal import changes, propose
from hil.word_format import WordFormat

CODEC = load_arm()


def rows(**room):
    """Rows of two joints, with this head-room by signal and 9 bits on all others."""
    names = ("estimate", "i", "i-d", "d", "a_ref")
    return [
        {"name": name, "joint": joint, "headroom_bits": room.get(name.replace("-", "_"), 9)}
        for name in names
        for joint in (1, 2)
    ]


def table(scenario):
    return [parameter_table(scenario, joint, CODEC) for joint in range(1, scenario.joints + 1)]


@pytest.mark.parametrize("bits", [8, 10, 12, 16, 20, 32])
def test_constants_fit_and_would_not_with_a_bit_more(bits):
    scenario = scenario_file.load("paper-joint", [f"joint.word.bits={bits}"])
    chosen = propose(scenario, CODEC, rows())
    table(chosen)
    word = chosen.joint.word
    assert word.acceleration_fraction == 7  # the bus's
    finer = scenario_file.load(
        "paper-joint",
        [
            f"joint.word.bits={bits}",
            f"joint.word.current_fraction={word.current_fraction}",
            f"joint.word.kb_fraction={WordFormat.of(chosen, CODEC).kb_fraction + 1}",
        ],
    )
    with pytest.raises(ScenarioError, match="KB = "):
        table(finer)


def test_a_signal_that_fills_its_word_gets_a_bit_of_room():
    scenario = scenario_file.load("paper-joint")
    assert propose(scenario, CODEC, rows(estimate=0)).joint.word.current_fraction == 10
    assert propose(scenario, CODEC, rows(a_ref=-1)).joint.word.acceleration_fraction == 5
    assert changes(scenario, scenario, CODEC) == {}


def test_paper_joint_is_better_off_with_four_bits_of_kb(paper_proposal):
    assert paper_proposal["formats"] == {"joint.word.kb_fraction": 4}
    assert (paper_proposal["proved"], paper_proposal["overflows"]) == (True, 0)
    for row in paper_proposal["joints"]:
        assert row["sqnr_proposed_db"] > row["sqnr_db"] + 5.0  # KB's own rounding was what cost most
        # a rerun's limit cycle is another one: some urad of a hundred
        assert row["max_deviation_proposed_rad"] < 1.05 * row["max_deviation_rad"]


@pytest.fixture(scope="module")
def paper_proposal():
    """Of a short part of paper-joint."""
    short = ["duration_s=0.4"]
    return studies.study(scenario_file.load("paper-joint", short)).found["proposal"]


@pytest.mark.parametrize(("setting", "value"), [("kb_fraction", -6), ("current_fraction", 3)])
def test_a_proposal_that_is_worse_is_not_proved(monkeypatch, setting, value):
    def worse(scenario, _codec, _rows):
        word = scenario.joint.word.model_copy(update={setting: value})
        return scenario.model_copy(update={"joint": scenario.joint.model_copy(update={"word": word})})

    monkeypatch.setattr(studies, "propose", worse)
    short = scenario_file.load("paper-joint", ["duration_s=0.2", "trajectory.time_s=0.15"])
    proposal = studies.study(short).found["proposal"]
    assert proposal["proved"] is False
    assert "a current is less exact" in proposal["against"]


def test_without_an_observer_there_is_nothing_to_propose():
    scenario = scenario_file.load("paper-joint", ["joint.observer=false"])
    assert propose(scenario, CODEC, rows()) is scenario
