"""The README's commands, run as they stand in a fresh folder."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def commands(kind: str) -> list[str]:
    """Return the command lines of the README's code blocks of this kind, without comments."""
    blocks = re.findall(rf"^```{kind}\n(.*?)^```", README, re.M | re.S)
    return [line.split(" # ")[0].strip() for block in blocks for line in block.splitlines() if line.strip()]


@pytest.fixture
def environment() -> dict[str, str]:
    return os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}


@pytest.mark.parametrize("command", commands("sh"))
def test_a_command_of_the_readme_works(command: str, tmp_path: Path, environment: dict[str, str]) -> None:
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    run = subprocess.run(
        command, shell=True, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout


def test_the_terminals_of_the_readme_play_together(tmp_path: Path, environment: dict[str, str]) -> None:
    """The logger first, as an observer for whom time does not wait; then the nodes in their order."""
    bus, logger, *nodes = commands("sh terminals")
    channel = Path(environment["XDG_RUNTIME_DIR"]) / "hil" / "arm.sock"
    log = tmp_path / "arm.log"
    started: list[subprocess.Popen[bytes]] = []

    def start(command: str) -> subprocess.Popen[bytes]:
        started.append(subprocess.Popen(command.split(), cwd=tmp_path, env=environment, stdout=subprocess.DEVNULL))
        return started[-1]

    try:
        start(bus)
        wait_for(channel.exists)
        listening = start(logger)
        wait_for(log.exists)
        for node in [start(command) for command in nodes]:
            assert node.wait(60) == 0
        listening.send_signal(signal.SIGINT)  # it stays for the next session
        assert listening.wait(60) == 0
    finally:
        for process in started:
            process.kill()
            process.wait()
    assert log.read_text().count("121#") >= 1500


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_the_scenario_of_the_readme_runs(hil: Any) -> None:
    (text,) = re.findall(r"^```toml\n(.*?)^```", README, re.M | re.S)
    (hil.folder / "my-move.toml").write_text(text)
    assert hil.run("run", "my-move.toml", "--inline", "--json").returncode == 0


@pytest.mark.parametrize("target", [*re.findall(r"^    make (\w+)", README, re.M), "check", "bench"])
def test_the_make_targets_of_the_readme_exist(target: str) -> None:
    """make test is what runs this; make run's command is among those above."""
    assert subprocess.run(["make", "--dry-run", target], cwd=ROOT, capture_output=True).returncode == 0
