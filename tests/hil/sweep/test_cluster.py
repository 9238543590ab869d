"""A Dask cluster on loopback: a real scheduler and two real workers, one of which is killed in the middle."""

import json
import os
import signal
import subprocess
import sys
import time

import pyarrow.parquet
import pytest

from tests.hil.sweep.conftest import HEAD, SWEEPS

PATIENCE_S = 60


class Cluster:
    """Processes of Dask in a folder of their own; no dashboard, no nanny that would start a worker again."""

    def __init__(self, folder):
        self.folder = folder
        self.started = []
        file = folder / "scheduler.json"
        self.start("scheduler", "--port", "0", "--scheduler-file", str(file))
        self.wait(lambda: file.exists() and file.read_text().endswith("}"))
        self.address = json.loads(file.read_text())["address"]

    def start(self, *words):
        log = (self.folder / f"{len(self.started)}.log").open("w")
        command = [sys.executable, "-m", "dask", *words, "--host", "127.0.0.1", "--no-dashboard"]
        self.started.append(subprocess.Popen(command, stdout=log, stderr=log, cwd=self.folder))
        return self.started[-1]

    def worker(self):
        return self.start("worker", self.address, "--nthreads", "1", "--no-nanny")

    def wait(self, condition):
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < deadline
            assert all(process.poll() is None for process in self.started)
            time.sleep(0.02)

    def end(self):
        for process in self.started:
            process.kill()
            process.wait()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    found = Cluster(tmp_path_factory.mktemp("dask"))
    yield found
    found.end()


def test_a_cluster_without_workers_is_an_error_with_its_cure(hil, cluster):
    run = hil.run("sweep", "quantisation", "--json", "--scheduler", cluster.address)
    assert (run.returncode, run.stdout) == (4, "")
    assert run.stderr.splitlines()[-1] == (
        f"hil: scheduler {cluster.address} has no workers: start one with `dask worker {cluster.address}`"
    )


def test_a_killed_worker_changes_nothing_of_the_table(hil, cluster, tmp_path):
    """Two workers, one killed when the first part is there; then the same sweep by one process of our own."""
    first, second = cluster.worker(), cluster.worker()
    file = tmp_path / "sweep.toml"
    file.write_text(HEAD.format(seed=1) + SWEEPS.format(samples=600))
    logs = [cluster.folder / f"{number}.log" for number in (1, 2)]
    cluster.wait(lambda: all("Registered to" in log.read_text() for log in logs))
    out = tmp_path / "out"
    process = hil.start("sweep", str(file), "--out", str(out), "--scheduler", cluster.address)
    cluster.wait(lambda: list(out.glob("parts/part-*.parquet")))
    os.kill(first.pid, signal.SIGKILL)
    first.wait()
    done = sum(pyarrow.parquet.read_table(part).num_rows for part in out.glob("parts/part-*.parquet"))
    assert 0 < done < 606
    _, stderr = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, stderr
    assert second.poll() is None
    alone = hil.run("sweep", str(file), "--json", "--jobs", "1")
    assert json.loads(alone.stdout) == json.loads((out / "sweep.json").read_text())
