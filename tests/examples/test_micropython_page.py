"""docs/micropython.md: its commands work, what it points to is there, its class is one that by_frames.py can use."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from unittest.mock import Mock, call

import pytest

from dbc.compiler import load_arm
from examples.joint_micropython import board
from hil.rig import run_inline
from hil.scenario_file import load
from tests.micropython import ROOT, needed

PAGE = ROOT / "docs" / "micropython.md"
TEXT = PAGE.read_text()


def blocks(kind):
    """Return the page's blocks of this kind."""
    return re.findall(rf"^```{kind}\n(.*?)^```", TEXT, re.M | re.S)


def test_the_commands_of_the_page_work(tmp_path):
    """With `micropython` on the path, as a user has it."""
    (tmp_path / "micropython").symlink_to(needed())
    env = os.environ | {"PATH": os.pathsep.join([str(tmp_path), str(Path(sys.executable).parent), os.environ["PATH"]])}
    env |= {"PYTHONPATH": str(ROOT), "HIL_MICROPYTHON": ""}
    said = []
    for command in "".join(blocks("sh")).splitlines():
        done = subprocess.run(
            command.split(), cwd=tmp_path, env=env, capture_output=True, text=True, timeout=120, check=False
        )
        assert done.returncode == 0, done.stderr
        said.append(done.stdout)
    laid_out, inline, processes, measured = said
    assert laid_out.startswith("build/board: joint 2 of paper-joint")
    sha256 = run_inline(load("paper-joint")).log.sha256()
    assert [json.loads(text)["frame_log_sha256"] for text in (inline, processes)] == [sha256] * 2
    (shown,) = blocks("text")
    assert [re.sub(r"[\d.]+", "#", line) for line in measured.splitlines()] == [
        re.sub(r"[\d.]+", "#", line) for line in shown.splitlines()
    ]


@pytest.mark.parametrize("target", re.findall(r"\]\((?!http)(.*?)\)", TEXT))
def test_what_the_page_points_to_is_there(target):
    assert (PAGE.parent / target).exists()


def test_the_files_of_the_page_are_those_of_the_folder(tmp_path):
    board.lay_out(tmp_path, board.joint_of(load("paper-joint"), 2))
    table = TEXT[TEXT.index("| file | what |") : TEXT.index("A folder is made")]
    named = {name.rpartition("/")[2] for name in re.findall(r"`([\w/]+\.py)`", table)}
    assert {path.name for path in tmp_path.rglob("*.py")} == named | {"__init__.py"}


def test_the_identifiers_of_the_page_are_the_databases():
    codec = load_arm()
    found = dict(re.findall(r"\b(Stop|Encoder_n|Parameter_n|AccelRef|AccelRef_2)\s(0x[0-9A-F]{3})", TEXT))
    assert {name: int(value, 16) for name, value in found.items()} == {
        "Stop": codec["Stop"].identifier,
        "Encoder_n": codec["Encoder_2"].identifier - 2,
        "Parameter_n": codec["Parameter_2"].identifier - 2,
        "AccelRef": codec["AccelRef"].identifier,
        "AccelRef_2": codec["AccelRef_2"].identifier,
    }


def test_the_class_of_the_page_is_a_bus(monkeypatch):
    """What it asks of the controller is what the documentation of pyb.CAN has, which says what recv returns."""
    pyb = Mock()
    can = pyb.CAN.return_value
    can.any.side_effect = [False, True]
    can.recv.return_value = 0x102, False, 0, bytearray(b"\0\0\0\x5d")
    monkeypatch.setitem(sys.modules, "pyb", pyb)
    names = {}
    (source,) = blocks("python")
    exec(source, names)
    bus = names["Bus"]((0x102, 0x010, 0x130, 0x302))
    assert bus.receive() == (0x102, b"\0\0\0\x5d")
    bus.send(0x122, b"\1\2")
    assert pyb.mock_calls == [
        call.CAN(1, pyb.CAN.NORMAL, baudrate=1_000_000, sample_point=80),
        call.CAN().setfilter(0, pyb.CAN.LIST16, 0, (0x102, 0x010, 0x130, 0x302)),
        call.CAN().any(0),
        call.CAN().any(0),
        call.CAN().recv(0),
        call.CAN().send(b"\1\2", 0x122, timeout=10),
    ]
