"""The run folder, read by other people's programs."""

import json
import subprocess
import sys
from pathlib import Path

import can
import numpy as np
import pyarrow.parquet
import pytest

from hil import scenario_file
from hil.errors import OutputError
from hil.evaluate import evaluate
from hil.experiment import examine, write
from hil.record import run_folder
from hil.rig import Outcome, run_inline
from tests.conftest import SHORT


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    return run_inline(scenario_file.load("paper-joint", SHORT))


@pytest.fixture(scope="module")
def folder(outcome: Outcome, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("record") / "run"
    write(examine(outcome, 0.0), path)
    return path


def test_can_player_s_reader_reads_the_log_back(folder: Path, outcome: Outcome) -> None:
    messages = list(can.LogReader(str(folder / "frames.log")))
    assert [(m.arbitration_id, bytes(m.data)) for m in messages] == [f[1:3] for f in outcome.log.frames]
    assert max(abs(m.timestamp - f[0] * 1e-9) for m, f in zip(messages, outcome.log.frames, strict=True)) <= 0.51e-6


def test_cantools_decodes_every_frame_of_the_log(folder: Path, outcome: Outcome) -> None:
    decoded = subprocess.run(
        [sys.executable, "-m", "cantools", "decode", "--single-line", str(folder / "arm.dbc")],
        stdin=(folder / "frames.log").open(),
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()
    assert len(decoded) == len(outcome.log.frames)
    assert all("::" in line and "Unknown" not in line for line in decoded)
    assert "Encoder_1(Position: 0.0 rad, Cycle: 0" in decoded[1]


def test_the_signals_are_those_of_the_evaluation(folder: Path, outcome: Outcome) -> None:
    table = pyarrow.parquet.read_table(folder / "signals.parquet")
    evaluation = evaluate(outcome)
    assert evaluation is not None
    assert table.num_rows == 200
    np.testing.assert_array_equal(table["q_rad_2"].to_numpy(), evaluation.q[:, 1])
    np.testing.assert_array_equal(table["estimate_Nm_3"].to_numpy(), evaluation.estimate[:, 2])
    terms = [name for name in table.column_names if name.startswith("disturbance_") and name.endswith("_Nm_1")]
    parts = sum(table[name].to_numpy() for name in terms if name != "disturbance_Nm_1")
    np.testing.assert_allclose(parts, table["disturbance_Nm_1"].to_numpy(), atol=1e-12)


def test_the_summary_in_the_folder_is_the_one_that_is_printed(folder: Path, outcome: Outcome) -> None:
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["frame_log_sha256"] == outcome.log.sha256()
    assert summary["counterpart"]["observer"] is False


def test_a_folder_that_fails_half_way_is_not_left(tmp_path: Path) -> None:
    def fail() -> None:
        with run_folder(tmp_path / "run") as folder:
            (folder / "something").touch()
            raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match="No space left on device; nothing was kept"):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_an_empty_folder_may_be_given(tmp_path: Path) -> None:
    with run_folder(tmp_path) as folder:
        (folder / "something").touch()
    assert [path.name for path in tmp_path.iterdir()] == ["something"]
