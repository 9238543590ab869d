"""Joint 2 under MicroPython on vcan0: what lies on a board at a CAN socket of its own, and behind `hil node`."""

import subprocess
from pathlib import Path

import pytest

from examples.joint_micropython import board, node
from hil.bus_rig import run_on_bus
from hil.can_node import Place
from hil.scenario_file import load
from tests import micropython
from tests.lab.inside import kernel, rig, warm
from tests.lab.inside.test_rig import PATIENCE_S, Got, same_as_inline
from tests.lab.packages import Missing

LIMIT_S = 60.0
DURATION_S = 0.1
CPU = f"{node.__name__}:{node.MicroPythonJoint.__name__}"


@pytest.fixture
def program(monkeypatch: pytest.MonkeyPatch) -> str:
    """MicroPython, which `hil node` finds, too."""
    try:
        path = str(micropython.program())
    except Missing as missing:
        kernel.give_up(missing)
    monkeypatch.setenv(micropython.NAMED_IN, path)
    return path


def plays(joint: subprocess.Popen[str] | warm.Warm, channel: str) -> str:
    """Have the rig play with this joint 2; return that all was as inline, and what it said at its end."""
    scenario, place = rig.scenario("paper-joint", DURATION_S), Place("socketcan", channel, {})
    try:
        outcome = run_on_bus(scenario, place, ["joint2"], patience_s=PATIENCE_S)
        said, complaint = joint.communicate(timeout=LIMIT_S)
    finally:
        joint.kill()
    assert joint.returncode == 0, complaint
    return f"{same_as_inline(outcome, 'paper-joint', DURATION_S)}; it said: {said.strip()!r}"


@pytest.mark.row("micropython")
@pytest.mark.usefixtures("nodes")
def test_a_boards_folder_plays_joint_2(vcan: str, program: str, tmp_path: Path, got: Got) -> None:
    board.lay_out(tmp_path, board.joint_of(load("paper-joint"), 2))
    ends = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([program, "main.py", vcan], cwd=tmp_path, text=True, **ends) as joint:
        assert joint.stdout is not None
        assert "waits for the set-up" in joint.stdout.readline()
        got(f"a board's folder at {vcan}: {plays(joint, vcan)}")


@pytest.mark.row("micropython")
@pytest.mark.usefixtures("nodes", "program")
def test_behind_hil_node_it_plays_joint_2(vcan: str, tmp_path: Path, got: Got) -> None:
    words = [word for setting in (*rig.settings(DURATION_S), f"joint2.cpu={CPU}") for word in ("--set", setting)]
    joint = warm.hil(tmp_path, "node", "joint", "2", "-i", "socketcan", "-c", vcan, *words)
    got(f"behind `hil node joint 2` at {vcan}: {plays(joint, vcan)}")
