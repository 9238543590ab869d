"""The folder: goes on where it was, whatever became of its parts; nobody else's sweep, and nobody else at work."""

import json
import os

import pyarrow.parquet
import pytest

from hil.errors import OutputError
from hil.sweep import sweep_file
from hil.sweep.folder import sweep_folder
from hil.sweep.run import carry_out, plan


class Interrupted(Exception):
    """After some parts."""


@pytest.fixture
def sweep(at_once, tmp_path):
    """Run a sweep in a folder; return its summary. stop_after: chunks until it is interrupted."""

    def run(path, out="out", stop_after=None, notice=print):
        file = sweep_file.load(path)
        steps = []

        def step(done):
            steps.append(sum(done.values()))
            if stop_after is not None and len(steps) > stop_after:
                raise Interrupted

        with sweep_folder(tmp_path / out, sweep_file.to_toml(file)) as folder:
            return carry_out(plan(file), folder, at_once, step, notice)

    return run


def interrupted(sweep, path, **keys):
    with pytest.raises(Interrupted):
        sweep(path, **keys)


def test_the_folder_holds_the_file_the_table_and_the_summary(sweep, write, tmp_path):
    found = sweep(write())
    out = tmp_path / "out"
    assert sorted(path.name for path in out.iterdir()) == ["results.parquet", "sweep.json", "sweep.toml"]
    assert json.loads((out / "sweep.json").read_text()) == found
    rows = pyarrow.parquet.read_table(out / "results.parquet").to_pylist()
    assert [(row["sweep"], row["index"]) for row in rows] == [(name, k) for name in ("g", "drawn") for k in range(6)]
    assert [row["status"] for row in rows] == ["ok"] * 4 + ["refused"] * 2 + ["ok"] * 6
    assert [row["joint.g_rad_s"] for row in rows[:6]] == [100, 100, 700, 700, 1200, 1200]
    assert {type(row["joint.observer"]) for row in rows[6:]} == {bool}
    assert rows[0]["encoder.counts_per_turn"] is None
    assert rows[4]["max_deviation_rad_1"] is None


def test_the_best_and_the_worst_are_those_of_the_table(sweep, write, tmp_path):
    found = sweep(write())
    rows = pyarrow.parquet.read_table(tmp_path / "out" / "results.parquet").to_pylist()
    for each in found["sweeps"]:
        run = {row["index"]: row["max_tip_deviation_m"] for row in rows if row["sweep"] == each["name"]}
        run = {index: tip for index, tip in run.items() if tip is not None}
        assert run[each["best"]["index"]] == min(run.values()) == each["best"]["max_tip_deviation_m"]
        assert run[each["worst"]["index"]] == max(run.values())
    assert "1" in found["sweeps"][0]["first_refused"]["reason"]
    assert (found["ok"], found["refused"], found["points"]) == (10, 2, 12)


def test_an_interrupted_sweep_runs_what_is_missing_and_ends_the_same(sweep, write, at_once):
    whole = sweep(write(), out="whole")
    interrupted(sweep, write(), stop_after=2)
    assert sweep(write()) == whole
    at_once.executor.points = 0
    assert sweep(write()) == whole
    assert at_once.executor.points == 0


def test_a_run_point_is_not_run_again(sweep, write, at_once, tmp_path):
    interrupted(sweep, write(), stop_after=2)
    kept = sum(
        pyarrow.parquet.read_table(part).num_rows for part in (tmp_path / "out" / "parts").glob("part-*.parquet")
    )
    at_once.executor.points = 0
    sweep(write())
    assert 0 < kept < 12
    assert at_once.executor.points == 12 - kept


@pytest.mark.parametrize("harm", ["truncated", "emptied", "a bit flipped", "another's"])
def test_a_damaged_part_is_named_and_put_aside_and_its_points_run_again(sweep, write, tmp_path, harm):
    whole = sweep(write(), out="whole")
    interrupted(sweep, write(), stop_after=3)
    part = min((tmp_path / "out" / "parts").iterdir())
    data = bytearray(part.read_bytes())
    if harm == "a bit flipped":
        data[data.index(b"drawn") if b"drawn" in data else data.index(b"ok")] ^= 4
    if harm == "another's":
        pyarrow.parquet.write_table(pyarrow.table({"sweep": ["g"], "index": [0]}), part)
    else:
        part.write_bytes({"truncated": data[: len(data) // 2], "emptied": b""}.get(harm, data))
    said = []
    assert sweep(write(), notice=said.append) == whole
    assert any(str(part) in text and "put aside" in text and "run again" in text for text in said)
    assert part.with_name(f"{part.name}.damaged").exists()


def test_a_half_written_part_is_removed_and_said(sweep, write, tmp_path):
    whole = sweep(write(), out="whole")
    interrupted(sweep, write(), stop_after=2)
    half = tmp_path / "out" / "parts" / "part-0000005.parquet.partial"
    half.write_bytes(b"PAR1")
    said = []
    assert sweep(write(), notice=said.append) == whole
    assert f"{half} is half-written: removed; its points run again" in said
    assert not half.exists()


def test_a_damaged_table_is_made_again(sweep, write, tmp_path):
    whole = sweep(write())
    table = tmp_path / "out" / "results.parquet"
    table.write_bytes(table.read_bytes()[:-100])
    said = []
    assert sweep(write(), notice=said.append) == whole
    assert "results.parquet is damaged" in said[0]


def test_rows_that_are_there_twice_count_once(sweep, write, tmp_path):
    """Killed between the table's writing and the removal of the parts."""
    whole = sweep(write())
    out = tmp_path / "out"
    (out / "parts").mkdir()
    (out / "parts" / "part-0000003.parquet").write_bytes((out / "results.parquet").read_bytes())
    assert sweep(write()) == whole


def test_another_sweep_is_refused_with_the_line_that_differs(sweep, write):
    sweep(write())
    with pytest.raises(OutputError, match=r"holds another sweep: its sweep.toml has 'seed = 1' where .* 'seed = 2'"):
        sweep(write(seed=2))
    with pytest.raises(OutputError, match=r"has 'samples = 6' where this one has 'samples = 7'"):
        sweep(write(samples=7))


def test_a_folder_of_something_else_is_refused(sweep, write, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.tex").touch()
    with pytest.raises(OutputError, match=r"holds something, but no sweep.toml"):
        sweep(write())
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["thesis.tex"]


def test_only_one_at_a_time_works_in_a_folder(sweep, write, tmp_path):
    with (
        sweep_folder(tmp_path / "out", sweep_file.to_toml(sweep_file.load(write()))),
        pytest.raises(OutputError, match=r"another hil sweep works in it"),
    ):
        sweep(write())
    sweep(write())


def test_a_sweep_that_did_nothing_leaves_nothing(sweep, write, tmp_path):
    interrupted(sweep, write(), stop_after=0)
    assert not (tmp_path / "out").exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_cannot_be_written_is_an_error_of_output(sweep, write, tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(OutputError, match=r"Permission denied"):
        sweep(write())


def test_a_file_in_the_folders_place_is_an_error_of_output(sweep, write, tmp_path):
    (tmp_path / "out").touch()
    with pytest.raises(OutputError, match=r"sweep folder .*: File exists"):
        sweep(write())


def test_the_same_seed_gives_the_same_table_and_another_one_another(sweep, write):
    hashes = [sweep(write(seed=seed), out=out)["table_sha256"] for seed, out in ((1, "a"), (1, "b"), (2, "c"))]
    assert hashes[0] == hashes[1] != hashes[2]


def test_the_order_of_the_table_is_that_of_the_points_whatever_came_first(sweep, write, tmp_path):
    whole = sweep(write(), out="whole")
    interrupted(sweep, write(), stop_after=3)
    part = min((tmp_path / "out" / "parts").iterdir())
    part.rename(part.with_name("part-9999999.parquet"))
    assert sweep(write()) == whole
