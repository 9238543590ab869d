"""docs/cpu.md and the README: the commands work, and print what the page says."""

import json
import os
import re
from pathlib import Path
from typing import Any

import pytest

from hil.i8086.cost import floor_clocks
from hil.paper.table1 import planar_operations
from hil.rig import run_inline
from hil.scenario_file import load

ROOT = Path(__file__).parents[3]
PAGE, README = ((ROOT / name).read_text() for name in ("docs/cpu.md", "README.md"))
STEP = (ROOT / "firmware_py" / "joint_cpu.py").read_text()
SOURCE = (ROOT / "firmware_py" / "targets" / "i8086" / "joint.asm").read_text()


def commands(text: str, kind: str) -> list[list[str]]:
    blocks = re.findall(rf"^```{kind}\n(.*?)^```", text, re.M | re.S)
    return [line.split("# ")[0].split() for block in blocks for line in block.splitlines()]


def lines(text: str) -> list[str]:
    return [line.rstrip() for line in text.strip().splitlines()]


@pytest.fixture(scope="module")
def report(module_hil: Any) -> tuple[str, Path]:
    """What the page's command with a folder prints and leaves."""
    (words,) = [words for words in commands(PAGE, "sh") if "--out" in words]
    run = module_hil.run(*words[1:], env=os.environ | {"COLUMNS": "80"})
    assert run.returncode == 0, run.stderr
    return run.stdout, module_hil.folder / words[words.index("--out") + 1]


def test_the_page_shows_what_is_printed(report: tuple[str, Path]) -> None:
    (shown,) = re.findall(r"^```text\n(.*?)^```", PAGE, re.M | re.S)
    *printed, where = lines(report[0])
    assert where.startswith("results: ")
    assert printed == lines(shown)


def test_the_folder_is_whole(report: tuple[str, Path]) -> None:
    assert {path.name for path in report[1].iterdir()} == {"cpu.json", "scenario.toml", "clocks.png", "clocks.svg"}
    assert load(str(report[1] / "scenario.toml")).cpu(2) == "i8086"


def test_from_8_mhz_on_nobody_sees_how_long_it_took(report: tuple[str, Path], module_hil: Any) -> None:
    """At 5 MHz it shows: tests/hil/i8086/test_in_loop.py."""
    (words,) = [words for words in commands(PAGE, "sh") if words[1] == "run"]
    run = module_hil.run(*words[1:])
    assert run.returncode == 0, run.stderr
    hashes = [json.loads(text)["frame_log_sha256"] for text in (run.stdout, (report[1] / "cpu.json").read_text())]
    for settings in ([], ["joint.cpu=i8086", "joint.clock_hz=10e6"]):
        hashes.append(run_inline(load("paper-joint", settings)).log.sha256())
    assert len(set(hashes)) == 1


def test_the_commands_of_the_readme_are_those_of_the_page() -> None:
    assert [words for words in commands(README, "sh cpu") if words not in commands(PAGE, "sh")] == []


def test_the_table_has_every_line_of_the_step_and_labels_that_are_there() -> None:
    rows = re.findall(r"^\| `(.*?)` \| (.*?) \|", PAGE, re.M)
    (body,) = re.findall(r"    def step\(.*?\n(.*?)        return", STEP, re.S)
    of_the_law = [line.strip() for line in body.splitlines() if "_from_bus" not in line]
    assert [line for line, _ in rows if line != "make_step"] == of_the_law
    for label in re.findall(r"`(\w+)`", " ".join(labels for _, labels in rows)):
        assert re.search(rf"^{label}:", SOURCE, re.M), label


def test_the_planar_arm_takes_what_the_page_says(report: tuple[str, Path]) -> None:
    """In periods at 8 MHz, from alone to as steps."""
    cost = json.loads((report[1] / "cpu.json").read_text())["cost"]
    planar = planar_operations(3)
    alone_s = floor_clocks(planar, cost["imul_clocks"]) / 8e6
    as_steps_s = alone_s * cost["step"]["clocks"] / cost["step"]["floor_clocks"]
    said = f"{planar.multiplications} and {planar.additions} operations"
    assert f"{said} (`hil/paper/table1.py`), it would be {alone_s * 1e3:.1f} to {as_steps_s * 1e3:.1f} periods" in PAGE


@pytest.mark.parametrize("path", sorted({*re.findall(r"`((?:hil|firmware_py)/[\w/.]+)`", PAGE)}))
def test_what_the_page_names_is_there(path: str) -> None:
    assert (ROOT / path).exists()
