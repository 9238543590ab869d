"""docs/bridge.md as it stands: the robot on the wire of `hil`, joint 2 on vcan0, python-can's bridge between them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import Hil
from tests.hil.test_bridge import commands, functional, play
from tests.lab.inside import candump, rig, warm

LIMIT_S = 300.0
SHORT = [
    *("--set", "duration_s=0.1", "--set", "clock.setup_cycles=60"),
    *("--set", "trajectory.time_s=0.05", "--set", "trajectory.by_rad=[0.002, -0.002, 0.002]"),
]


class WarmHil(Hil):
    """The command `hil`, forked in the lab; somebody else's programs start as ever."""

    def start(self, *words: str) -> Any:
        folder = self.folder / f"process{len(self.started)}"
        folder.mkdir()
        process: Any = warm.hil(folder, *words)
        self.started.append(process)
        return process


@pytest.fixture
def terminals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[WarmHil]:
    monkeypatch.chdir(tmp_path)
    command = WarmHil(tmp_path)
    yield command
    for process in command.started:
        process.kill()
        process.wait(LIMIT_S)


def test_joint_2_on_vcan0_is_part_of_the_same_robot(vcan: str, terminals: WarmHil) -> None:
    """As candump hears it on the far side. No run folder: its figures would take two minutes here."""
    with candump.dumped(vcan, terminals.folder) as path:
        summary = play(terminals, commands(), SHORT, LIMIT_S)
    assert rig.payloads(candump.frames(path)) == functional(SHORT)
    assert summary["lost_frames"] == 0
