"""What all tests share: channels of their own, short scenarios, coverage where it counts, no process left behind."""

import os
import subprocess
import sys
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from coverage import Coverage

from hil import scenario_file
from hil.scenario import Scenario
from hil.wire import channel as channels

SHORT = (
    "clock.setup_cycles=60",
    "duration_s=0.2",
    "trajectory.time_s=0.15",
    "trajectory.by_rad=[0.05, -0.05, 0.05]",
)
"""A move in 200 cycles, behind as many as the set-up needs."""
COVERING = {"dbc", "firmware_py", "plant"}
"""Folders of the tests that cover the packages of the same names."""
LONGEST = [
    f"test_{name}.py"
    for name in (
        *("processes", "reproduce", "cli", "sync_rig", "readme", "experiment", "wall_rig", "rig_analysis"),
        *("joint_c", "bridge", "hostile", "command", "two_senders", "page", "bus_errors", "cluster", "arms", "fuzz"),
        *("words_apytypes", "frame_plan", "determinism", "rest", "dead_time", "limits", "rivals", "wall_drive"),
    )
]
"""Files of more than 10 s, the longest first: one that begins last would keep one process busy and the others idle."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    rank = {name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path.name, len(rank)))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Cover a package by its own tests alone: traced, a run of the whole rig takes 1.7 times as long."""
    if COVERING & set(item.nodeid.split("/")):
        return (yield)
    with untraced():
        return (yield)


@contextmanager
def untraced() -> Iterator[None]:
    """Cover nothing meanwhile. pytest-cov starts twice in a process of xdist: the end of one would resume the other."""
    stopped = []
    while (coverage := Coverage.current()) is not None:
        coverage.stop()
        stopped.append(coverage)
    try:
        yield
    finally:
        for coverage in reversed(stopped):
            coverage.start()


@pytest.fixture(autouse=True)
def own_channels(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give each test a run-time directory of its own, so that no two meet on a channel."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("run")))


@pytest.fixture
def short() -> Scenario:
    """paper-joint in 200 cycles."""
    return scenario_file.load("paper-joint", SHORT)


@pytest.fixture
def short_settings() -> list[str]:
    """The same as options of the command line."""
    return [word for setting in SHORT for word in ("--set", setting)]


class Hil:
    """The command `hil` as a user runs it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.started: list[subprocess.Popen[str]] = []

    def run(
        self, *words: str, env: dict[str, str] | None = None, timeout_s: float = 120.0
    ) -> subprocess.CompletedProcess[str]:
        """Run it to its end."""
        return subprocess.run(
            self._command(words),
            capture_output=True,
            text=True,
            cwd=self.folder,
            timeout=timeout_s,
            env=os.environ | (env or {}),
            check=False,
        )

    def start(self, *words: str) -> subprocess.Popen[str]:
        """Start it and let it run."""
        return self._start(self._command(words))

    def bus(self, names: str = "arm", *options: str) -> subprocess.Popen[str]:
        """Start `hil bus` with these channels and options; return when clients may join."""
        process = self.start("bus", *names.split(), *options)
        deadline = time.monotonic() + 20
        while not set(names.split()) <= set(channels.names()):
            if process.poll() is not None or time.monotonic() > deadline:
                process.kill()
                pytest.fail(f"hil bus {names} {' '.join(options)}: {''.join(process.communicate())}")
            time.sleep(0.01)
        return process

    def program(self, *words: str) -> subprocess.Popen[str]:
        """Start somebody else's program, a Python module; what it prints comes at once."""
        return self._start([sys.executable, "-u", "-m", *words])

    def _start(self, command: list[str]) -> subprocess.Popen[str]:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=self.folder)
        self.started.append(process)
        return process

    @staticmethod
    def _command(words: tuple[str, ...]) -> list[str]:
        return [sys.executable, "-m", "hil", *words]


@contextmanager
def commands_in(folder: Path) -> Iterator[Hil]:
    """Give the command `hil` in this folder; what it started ends behind it."""
    command = Hil(folder)
    yield command
    for process in command.started:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.fixture
def hil(tmp_path: Path) -> Iterator[Hil]:
    with commands_in(tmp_path) as command:
        yield command


@pytest.fixture(scope="module")
def module_hil(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hil]:
    """The command `hil` for what the tests of a module share."""
    with commands_in(tmp_path_factory.mktemp("module")) as command:
        yield command


def descendants(pid: int) -> list[int]:
    """Return the process ids of all children, and theirs."""
    found = []
    for line in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        found += [int(line), *descendants(int(line))]
    return found


@pytest.fixture
def children_of():  # type: ignore[no-untyped-def]
    return descendants
