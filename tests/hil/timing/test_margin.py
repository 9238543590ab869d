"""All margins of a scenario: measured, as JSON, as tables, as figures; and what is said where there is nothing."""

import json
import xml.etree.ElementTree as ET
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from hil import scenario_file
from hil.timing import margin, margin_figures, margin_show
from hil.timing.limits import DelayMargin, Raised
from hil.timing.margin import Margins, margins, to_json
from hil.timing.search import Largest

SCENARIO = scenario_file.load("two-joints")
FOUND = Margins(
    SCENARIO,
    delay_margins=[
        DelayMargin(1, 0.0, Largest(7.5e-4), Largest(7e-4), Largest(7e-4)),
        DelayMargin(2, 0.0, Largest(3e-3, beyond=True), Largest(3e-3, beyond=True), Largest(3e-3, beyond=True)),
    ],
    with_jitter=[DelayMargin(1, 2e-4, Largest(6e-4), Largest(5.5e-4), Largest(4.5e-4))],
    largest_g=[
        Raised(0.0, 4e-4, Largest(1000.0, beyond=True), Largest(900.0)),
        Raised(5e-4, 9e-4, Largest(600.0), Largest(500.0)),
    ],
    largest_inertia=[
        Raised(0.0, 4e-4, Largest(1.5), Largest(1.25)),
        Raised(5e-4, 9e-4, Largest(None), Largest(None)),
    ],
)
UNPREDICTED = replace(
    FOUND,
    without_theory="joint.observer = false: the theory is that of the observer",
    delay_margins=[replace(row, predicted=None, by_largest=None) for row in FOUND.delay_margins],
    with_jitter=[replace(row, predicted=None, by_largest=None) for row in FOUND.with_jitter],
    largest_g=[],
    largest_inertia=[],
)
FAILS = Margins(SCENARIO, fails="saturations: joint1 i 78")
KINDS = {"measured": FOUND, "unpredicted": UNPREDICTED, "fails": FAILS}


def shown(found: Margins) -> str:
    text = StringIO()
    margin_show.show_margins(Console(file=text, width=110, markup=False, highlight=False), found)
    return text.getvalue()


def cells(text: str) -> list[list[str]]:
    return [[cell.strip() for cell in line.strip("│").split("│")] for line in text.splitlines() if line[:1] == "│"]


def texts(svg: Path) -> set[str]:
    return {"".join(node.itertext()) for node in ET.parse(svg).iter("{http://www.w3.org/2000/svg}text")}


def test_of_a_scenario_everything_is_sought_and_progress_goes_from_nothing_to_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(margin, "EXTRAS", (0.5,))
    monkeypatch.setattr(margin, "JITTERS", (0.1,))
    short = ["duration_s=0.4", "trajectory.time_s=0.2", "trajectory.by_rad=[0.03]"]
    shares: list[float] = []
    with ThreadPoolExecutor(1) as executor:
        found = to_json(margins(scenario_file.load("linear-joint", short), executor, shares.append))
    assert shares == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert (found["fails"], found["without_theory"]) == (None, None)
    rows = [row for part in ("delay_margins", "with_jitter", "largest_g", "largest_inertia") for row in found[part]]
    assert len(rows) == 4
    assert [row["ratio"] for row in rows] == [pytest.approx(1.0, abs=0.1)] * 4


def test_a_scenario_that_fails_as_it_is_is_not_searched() -> None:
    with ThreadPoolExecutor(1) as executor:
        found = margins(scenario_file.load("linear-joint", ["joint.inertia_kg_m2=[2.6]"]), executor)
    assert found.fails.startswith("saturations: joint1")
    assert not found.delay_margins


def test_jitter_of_its_own_is_not_replaced_and_without_observer_g_and_Jn_are_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(margin, "delay_margin", lambda _rig, joint, jitter_s=0.0: (joint, jitter_s))
    settings = [
        "drive.dead_time_jitter_s=[0.0001]",
        "joint.observer=false",
        "duration_s=0.1",
        "trajectory.by_rad=[0.0]",
    ]
    with ThreadPoolExecutor(1) as executor:
        found = margins(scenario_file.load("linear-joint", settings), executor)
    assert found == Margins(
        found.scenario, "", "joint.observer = false: the theory is that of the observer", [(1, 0.0)], [], [], []
    )


@pytest.mark.parametrize("found", KINDS.values(), ids=KINDS)
def test_json_is_json_and_says_what_is_more_and_what_is_unknown(found: Margins) -> None:
    values = json.loads(json.dumps(to_json(found), allow_nan=False))
    assert values["ceiling_s"] == pytest.approx(0.003)
    assert values.keys() >= {"fails", "without_theory", "delay_margins", "with_jitter", "largest_g", "largest_inertia"}


def test_json_has_the_ratio_only_where_both_are_known() -> None:
    values = to_json(FOUND)
    first, second = values["delay_margins"]
    assert first["joint"] == 1
    assert (first["measured_s"], first["predicted_s"], first["measured_beyond"]) == (7.5e-4, 7e-4, False)
    assert first["ratio"] == pytest.approx(75 / 70)
    assert (second["measured_s"], second["measured_beyond"], second["ratio"]) == (3e-3, True, None)
    assert values["with_jitter"][0]["by_largest_delay_s"] == 4.5e-4
    assert [row["ratio"] for row in values["largest_g"]] == [None, pytest.approx(1.2)]
    assert [row["measured_factor"] for row in values["largest_inertia"]] == [1.5, None]
    assert to_json(UNPREDICTED)["delay_margins"][0]["predicted_s"] is None


def test_tables_say_it_to_a_person() -> None:
    text = shown(FOUND)
    assert cells(text) == [
        ["1", "none", "750", "700 (x 1.071)", ""],
        ["2", "none", "> 3000", "> 3000", ""],
        ["1", "0 to 200", "600", "550 (x 1.091)", "450"],
        ["0", "400", "> 1000", "900", "1.500", "1.250 (x 1.200)"],
        ["500", "900", "600", "500 (x 1.200)", "none", "none"],
    ]
    assert "3000 us at most" in text
    assert "no prediction" not in text


def test_tables_say_why_there_is_no_prediction_or_nothing() -> None:
    text = shown(UNPREDICTED)
    assert cells(text)[0] == ["1", "none", "750", "-", ""]
    assert "no prediction: joint.observer = false" in text
    assert shown(FAILS) == "two-joints fails as it is, without any delay more: saturations: joint1 i 78\n"


def test_figures_show_every_row_and_are_the_same_twice(tmp_path: Path) -> None:
    paths = margin_figures.write_figures(tmp_path, FOUND)
    assert [path.name for path in paths] == [
        *("delay-margins.png", "delay-margins.svg"),
        *("largest-g-and-jn.png", "largest-g-and-jn.svg"),
    ]
    assert texts(paths[1]) >= {"joint 1, no jitter", "joint 2, no jitter", "joint 1, jitter 0 to 200 µs", "measured"}
    assert texts(paths[3]) >= {"largest g", "sampled loop", "measured", "measured: more than this", "g, rad/s"}
    before = [path.read_bytes() for path in paths]
    again = [path.read_bytes() for path in margin_figures.write_figures(tmp_path, FOUND)]
    assert again == before


def test_figures_without_theory_have_points_only_and_there_are_none_of_nothing(tmp_path: Path) -> None:
    paths = margin_figures.write_figures(tmp_path, UNPREDICTED)
    assert [path.name for path in paths] == ["delay-margins.png", "delay-margins.svg"]
    assert not any("sampled loop" in text for text in texts(paths[1]))
    assert margin_figures.write_figures(tmp_path, FAILS) == []
