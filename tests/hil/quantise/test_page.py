"""docs/quantise.md and the README: the commands work, and the figures are those that they find."""

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PAGE, README = ((ROOT / name).read_text() for name in ("docs/quantise.md", "README.md"))


def commands(text, kind):
    blocks = re.findall(rf"^```{kind}\n(.*?)^```", text, re.M | re.S)
    return [line.split(" # ")[0].split() for block in blocks for line in block.splitlines()]


def cells(head):
    """Return the rows of the page's table with this head, their first cell aside."""
    (table,) = re.findall(rf"^\| {re.escape(head)} .*\n\|[ |-]+\n((?:\|.*\n)+)", PAGE, re.M)
    return {row.split("|")[1].strip(): [cell.strip() for cell in row.split("|")[2:-1]] for row in table.splitlines()}


@pytest.fixture(scope="module")
def whole(module_hil):
    """What the page's command for all of it leaves."""
    (words,) = [words for words in commands(PAGE, "sh") if "--out" in words]
    run = module_hil.run(*words[1:])
    assert run.returncode == 0, run.stderr
    folder = module_hil.folder / words[words.index("--out") + 1]
    assert {path.name for path in folder.iterdir()} >= {"word-lengths.png", "rest.png", "quantisation.json"}
    return json.loads((folder / "quantisation.json").read_text())


def test_the_commands_of_the_readme_are_those_of_the_page():
    shown = commands(PAGE, "sh")
    assert [words for words in commands(README, "sh quantise") if words not in shown] == []


def test_the_report_of_the_page(whole):
    rows = cells("joint of paper-joint | head-room of i, bits")
    for compared in whole["closed_loop"]["joints"]:
        i = next(r for r in whole["signals"] if (r["name"], r["joint"]) == ("i", compared["joint"]))
        shares = [f"{100 * compared[key]:+.1f} %" for key in ("penalty", "database_penalty")]
        assert rows[str(compared["joint"])] == [str(i["headroom_bits"]), f"{i['sqnr_db']:.1f}", *shares]
        assert compared["penalty"] <= 0.10
    assert (whole["proposal"]["formats"], whole["proposal"]["proved"]) == ({"joint.word.kb_fraction": 4}, True)


def test_the_knee_of_the_page(whole):
    knee, first = cells("scenario | knee, bits")["paper-joint"]
    assert whole["words"]["knee_bits"] == int(knee)
    assert first.startswith(
        f"{whole['words']['fails_first']['what']}, from {whole['words']['fails_first']['bits']} bits"
    )


def test_the_rest_of_the_page(whole):
    """Within a factor of 2 in every case, and the encoder dominates."""
    assert len(whole["rest"]) == 3 * 41
    assert all(0.5 <= row["ratio"] <= 2.0 for row in whole["rest"])
    first = next(row for row in whole["rest"] if row["joint"] == 1)
    assert first["dominant"] == "encoder"
    alone, predicted, measured, _ = cells("joint of paper-joint | alone, urad: encoder, reference, current, d")["1"]
    assert f"{first['predicted']['encoder_rad'] * 1e6:.2f}" == alone.split(",")[0]
    assert f"{first['predicted']['range_rad'] * 1e6:.1f}" == predicted
    assert f"{first['measured_rad'] * 1e6:.1f}" == measured
