"""`hil sweep` as a user runs it: killed and given again, interrupted, on one process and two, in bits, wrong."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet
import pytest

from hil.errors import ChannelError
from hil.sweep import crew, sweep_file

HELD = """
import sys
for name in {names}:
    sys.modules[name] = None
from hil.cli import main
main()
"""


def parts_of(out):
    return sorted(out.glob("parts/part-*.parquet"))


def wait_for_parts(out, process):
    deadline = time.monotonic() + 60
    while not parts_of(out):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.01)


def gone(pids):
    """Wait until none of these processes is there, or only as a zombie."""
    deadline = time.monotonic() + 20
    while any(alive(pid) for pid in pids):
        assert time.monotonic() < deadline
        time.sleep(0.02)


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.fixture(scope="module")
def whole(module_hil):
    """An uninterrupted run by one process: its summary, and the file."""
    from tests.hil.sweep.conftest import HEAD, SWEEPS

    file = module_hil.folder / "sweep.toml"
    file.write_text(HEAD.format(seed=1) + SWEEPS.format(samples=300))
    run = module_hil.run("sweep", str(file), "--jobs", "1", "--json")
    assert run.returncode == 0, run.stderr
    assert run.stderr == ""
    assert [path.name for path in module_hil.folder.iterdir()] == ["sweep.toml"]
    return json.loads(run.stdout), str(file)


def test_a_killed_sweep_goes_on_to_the_same_table(hil, whole, children_of, tmp_path):
    """SIGKILL in the middle; its workers end with it, and the next run, by two processes, does the rest."""
    summary, file = whole
    out = tmp_path / "out"
    process = hil.start("sweep", file, "--out", str(out), "--jobs", "2")
    wait_for_parts(out, process)
    workers = children_of(process.pid)
    process.kill()
    process.wait()
    gone(workers)
    kept = sum(pyarrow.parquet.read_table(part).num_rows for part in parts_of(out))
    assert 0 < kept < summary["points"]
    again = hil.run("sweep", file, "--out", str(out), "--jobs", "2")
    assert again.returncode == 0, again.stderr
    assert f"{kept} of {summary['points']} points are in {out} already" in again.stderr
    assert summary["table_sha256"] in again.stdout
    assert json.loads((out / "sweep.json").read_text()) == summary
    assert not (out / "parts").exists()
    assert (out / "sweep.toml").read_text() == sweep_file.to_toml(sweep_file.load(file))
    assert max(len(line) for line in again.stdout.splitlines() if not line.startswith(("first", "sweep f"))) <= 80


def test_ctrl_c_ends_everything_at_once_and_keeps_what_is_done(hil, whole, children_of, tmp_path):
    """To the whole group, as a terminal does."""
    _, file = whole
    out = tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-m", "hil", "sweep", file, "--out", str(out), "--jobs", "2"],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    hil.started.append(process)
    wait_for_parts(out, process)
    workers = children_of(process.pid)
    os.killpg(process.pid, signal.SIGINT)
    stdout, stderr = process.communicate(timeout=30)
    assert (process.returncode, stdout) == (130, "")
    assert stderr.splitlines() == [
        f"hil: what is done is in {out}: the same command with --out {out} goes on",
        "hil: interrupted: everything was ended",
    ]
    gone(workers)
    assert sum(pyarrow.parquet.read_table(part).num_rows for part in parts_of(out)) > 0


def test_a_worker_that_dies_ends_the_sweep_with_its_cure(hil, whole, children_of, tmp_path):
    _, file = whole
    out = tmp_path / "out"
    process = hil.start("sweep", file, "--out", str(out), "--jobs", "2")
    wait_for_parts(out, process)
    workers = [pid for pid in children_of(process.pid) if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    os.kill(workers[0], signal.SIGKILL)
    _, stderr = process.communicate(timeout=30)
    assert process.returncode == 5
    assert "a worker died in the middle of its points" in stderr
    assert "Traceback" not in stderr
    gone(workers)


@pytest.mark.parametrize(
    ("words", "said", "code"),
    [
        (["quantisation", "--set", "joint.g_rads=3"], "unknown key joint.g_rads: did you mean joint.g_rad_s?", 3),
        (["quantisation", "--jobs", "2", "--scheduler", "a:1"], "a cluster has as many workers", 2),
        (["quantisation", "--scheduler", "127.0.0.1:99999"], "scheduler '127.0.0.1:99999': write HOST:PORT", 4),
    ],
)
def test_what_cannot_be_begun_is_refused_and_leaves_nothing(hil, words, said, code):
    run = hil.run("sweep", *words, "--out", "out", env={"COLUMNS": "200"})
    assert (run.returncode, run.stdout) == (code, "")
    assert said in run.stderr
    assert "Traceback" not in run.stderr
    assert list(hil.folder.iterdir()) == []


@pytest.mark.parametrize("address", ["", "127.0.0.1", "http://127.0.0.1:1", "tls://127.0.0.1:1", "a b:1", ":1"])
def test_an_address_that_is_none_is_refused(address):
    with pytest.raises(ChannelError, match=r"write HOST:PORT, for example 127.0.0.1:8786"), crew.cluster(address):
        pass


def test_a_scheduler_that_is_not_there_is_an_error_with_its_cure(hil):
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    run = hil.run("sweep", "quantisation", "--json", "--scheduler", f"127.0.0.1:{port}")
    assert (run.returncode, run.stdout) == (4, "")
    assert run.stderr == (
        f"hil: scheduler 127.0.0.1:{port}: Connection refused: start one with `dask scheduler`, "
        "and workers with `dask worker ADDRESS`\n"
    )


@pytest.mark.parametrize(
    ("missing", "words", "said"),
    [
        ("pyarrow", [], "sweeps are written by pyarrow, which is not installed: pip install 'hil[sweep]'"),
        ("distributed", ["--scheduler", "127.0.0.1:1"], "--scheduler needs Dask, which is not installed: pip install"),
    ],
)
def test_a_missing_extra_is_named(hil, missing, words, said):
    program = HELD.format(names=[missing])
    run = subprocess.run(
        [sys.executable, "-c", program, "sweep", "quantisation", "--json", *words],
        capture_output=True,
        text=True,
        cwd=hil.folder,
        timeout=60,
    )
    assert (run.returncode, run.stdout) == (8, "")
    assert said in run.stderr
    assert "Traceback" not in run.stderr
