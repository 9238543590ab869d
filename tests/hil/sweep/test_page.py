"""docs/sweep.md: its file is a sweep, its commands work, its columns are the table's."""

import json
import re
from pathlib import Path

import pyarrow.parquet
import pytest

from hil.sweep import sweep_file
from hil.sweep.sampling import points

PAGE = (Path(__file__).parents[3] / "docs" / "sweep.md").read_text()


def block(kind):
    (text,) = re.findall(rf"^```{kind}\n(.*?)^```", PAGE, re.M | re.S)
    return text


def commands(kind):
    return [line.split(" # ")[0].split() for line in block(kind).splitlines()]


@pytest.fixture(scope="module")
def done(module_hil):
    """What the page's commands print, in their order."""
    (module_hil.folder / "sweep.toml").write_text(block("toml"))
    found = [module_hil.run(*words[1:]) for words in commands("sh")]
    assert [run.returncode for run in found] == [0, 0, 0], [run.stderr for run in found]
    return module_hil.folder, found


def test_the_commands_work_and_the_second_has_nothing_to_do(done):
    folder, (first, second, third) = done
    assert first.stdout == second.stdout
    summary = json.loads((folder / "runs" / "mine" / "sweep.json").read_text())
    assert (summary["points"], summary["refused"]) == (21, 3)
    assert json.loads(third.stdout)["table_sha256"] != summary["table_sha256"]
    assert [path.name for path in (folder / "runs").iterdir()] == ["mine"]


def test_the_columns_of_the_page_are_those_of_the_table(done):
    folder, _ = done
    columns = pyarrow.parquet.read_table(folder / "runs" / "mine" / "results.parquet").column_names
    named = [name for row in re.findall(r"^\| (`.*?) \|", PAGE, re.M) for name in re.findall(r"`([\w*]+)`", row)]
    named = [name for name in named if not name.startswith(("grid", "list", "latin", "monte"))]
    patterns = [re.sub("_n$", r"_\\d", name).replace("*", ".*") for name in named]
    figures = columns[columns.index("reason") + 1 :]
    assert [name for name in figures if not any(re.fullmatch(pattern, name) for pattern in patterns)] == []
    assert [pattern for pattern in patterns if not any(re.fullmatch(pattern, name) for name in figures)] == []


def test_the_cluster_of_the_page_is_a_command_of_ours(tmp_path):
    *_, (name, command, file, *options) = commands("sh cluster")
    assert (name, command, options[2]) == ("hil", "sweep", "--scheduler")
    (tmp_path / file).write_text(block("toml"))
    assert len(points(sweep_file.load(str(tmp_path / file)))) == 21
