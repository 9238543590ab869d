"""docs/bus.md: its example prints what the page says, its commands start, its messages are the real ones."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import can
import pytest

from hil.wire import fault_file

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "bus.md").read_text()


def block(kind: str) -> str:
    """Return the page's only block of this kind."""
    (text,) = re.findall(rf"^```{kind}\n(.*?)^```", PAGE, re.M | re.S)
    return str(text)


def test_the_example_prints_what_the_page_says(hil: Any) -> None:
    """Twice: the second time in another session of the same bus."""
    bus, example = block("sh terminals").splitlines()
    assert bus.split()[:2] == ["hil", "bus"]
    name, *options = bus.split()[2:]
    hil.bus(name, *options)
    script = ROOT / example.removeprefix("python ")
    for _ in range(2):
        run = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=60, check=False)
        assert run.stderr == ""
        assert run.stdout == block("text")


def test_the_page_shows_the_example_as_it_is() -> None:
    assert block("python") in (ROOT / "examples" / "two_nodes.py").read_text()


@pytest.mark.parametrize("line", block("sh").splitlines())
def test_a_bus_of_the_page_starts(hil: Any, line: str) -> None:
    words = line.split("#")[0].split()[2:]
    names = [word for word in words if word in ("arm", "leg")]
    hil.bus(" ".join(names), *words[len(names) :])


def test_the_commands_to_the_clock_are_obeyed(hil: Any) -> None:
    bus, *commands = [line.split("#")[0].split() for line in block("sh clock").splitlines()]
    hil.bus(bus[2], *bus[3:])
    for words in commands:
        if words[1] == "clock":
            answer = hil.run(*words[1:])
            assert answer.returncode == 0, answer.stderr
            assert "not there yet: left, right" in answer.stdout


def test_the_faults_of_the_page_are_a_script(tmp_path: Path) -> None:
    script = tmp_path / "faults.toml"
    script.write_text(block("toml"))
    kinds = [fault.kind for fault in fault_file.load(script, functional=False, fd=False)]
    assert kinds == ["bit error", "bit error rate", "stuck dominant"]


@pytest.mark.parametrize("target", re.findall(r"\]\((?!http)(.*?)\)|`(tests/[\w/.]+)`", PAGE))
def test_what_the_page_points_to_is_there(target: tuple[str, str]) -> None:
    link, path = target
    assert (ROOT / "docs" / link if link else ROOT / path).exists()


def refusal(**kwargs: Any) -> str:
    """Return why a client is refused."""
    with pytest.raises(can.CanInitializationError) as caught:
        can.Bus(interface="hil", **{"channel": "arm"} | kwargs)
    return str(caught.value)


def test_the_refusals_of_the_page_are_the_real_ones(hil: Any) -> None:
    hil.bus("arm", "--expect", "left")
    with can.Bus(interface="hil", channel="arm", name="eye") as eye:
        for kwargs in (
            {"channel": "leg"},
            {"channel": "../arm"},
            {"name": "extra", "timed": True},
            {"name": "left"},
            {"name": "eye"},
        ):
            assert refusal(**kwargs) in PAGE
        with pytest.raises(can.CanOperationError) as caught:
            eye.send(can.Message(is_error_frame=True))
        assert str(caught.value) in PAGE


def test_the_ends_of_the_command_are_the_real_ones(hil: Any) -> None:
    hil.bus("arm")
    taken = hil.run("bus", "arm")
    assert taken.returncode == 4
    assert taken.stderr.strip().removeprefix("hil: ") in PAGE
    odd = hil.run("bus", "leg", "--bitrate", "300000", env=os.environ | {"COLUMNS": "200"})
    assert odd.returncode == 2
    said = re.search(r"a bit lasts .*\d", odd.stderr)
    assert said
    assert said.group() in PAGE
