"""docs/bridge.md as it stands: the robot on the wire of `hil`, joint 2 on vcan0, python-can's bridge between them."""

from typing import Any

import pytest

from tests.hil.test_bridge import commands, functional, payloads, play

LIMIT_S = 400.0
"""Eight Python processes take over a minute to start where the machine is emulated."""
SHORT = [
    *("--set", "duration_s=0.1", "--set", "clock.setup_cycles=60"),
    *("--set", "trajectory.time_s=0.05", "--set", "trajectory.by_rad=[0.002, -0.002, 0.002]"),
]


@pytest.mark.usefixtures("vcan")
def test_joint_2_on_vcan0_is_part_of_the_same_robot(hil: Any) -> None:
    summary = play(hil, commands(), SHORT, LIMIT_S)
    assert payloads(hil.folder / "out" / "frames.log") == functional(SHORT)
    assert summary["lost_frames"] == 0
