"""docs/board.md: its tables are those of the database, its frames those of a run, its commands work."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from dbc.crc import crc8, crc16
from tests.examples.board_page import PAGE, with_blocks
from tests.examples.conftest import ROOT, SOURCES
from tests.examples.test_joint_c import record

TEXT = PAGE.read_text()


def test_what_is_generated_is_what_the_page_shows() -> None:
    assert with_blocks(TEXT) == TEXT, "python -m tests.examples.board_page writes it anew"


@pytest.mark.usefixtures("built")  # which skips loudly where there is no compiler
def test_the_commands_of_the_page_work(tmp_path: Path) -> None:
    """In a copy of what they need."""
    for name in ("examples/joint_c", "dbc"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("build", "__pycache__"))
    env = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    env["PYTHONPATH"] = os.pathsep.join(filter(None, [str(tmp_path), os.environ.get("PYTHONPATH")]))
    (block,) = re.findall(r"^```sh\n(.*?)^```", TEXT, re.M | re.S)
    for command in block.splitlines():
        done = subprocess.run(command.split(), cwd=tmp_path, env=env, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["frame_log_sha256"] == record("paper-joint")[0].sha256()


@pytest.mark.parametrize("target", re.findall(r"\]\((?!http)(.*?)\)", TEXT))
def test_what_the_page_points_to_is_there(target: str) -> None:
    assert (PAGE.parent / target).exists()


def test_the_calls_and_the_usage_are_the_real_ones() -> None:
    header = (SOURCES / "joint.h").read_text()
    for name, arguments in re.findall(r"`(joint_\w+)\((.*?)\)`", TEXT):
        declared = re.search(rf"{name}\((.*?)\);", header, re.S)
        assert declared
        names = [each.split()[-1].lstrip("*") for each in declared[1].split(",")]
        assert [each.strip().lstrip("&") for each in arguments.split(",")] == names
    assert "INTERFACE NUMBER [-j JOINTS] [-p PERIOD_US] [-w]" in (SOURCES / "main_socketcan.c").read_text()


def test_the_check_values_of_the_page_are_those_of_the_checksums() -> None:
    assert [f"0x{value:X}" for value in (crc8(b"123456789"), crc16(b"123456789"))] == re.findall(
        r'"123456789" gives (0x\w+)', TEXT
    )
