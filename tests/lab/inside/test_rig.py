"""The rig by the Sync frame, on vcan0 and across two cards: what every node sends is what it sends inline.

In the lab the processes are forked (warm.py), which leaves the lab's time to the runs.
"""

import os
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hil.bus_rig import run_on_bus
from hil.can_node import Place
from hil.rig import Outcome
from tests.lab.inside import candump, kernel, rig

PATIENCE_S = 60.0
AT_THE_OTHER = ("plant", "joint1", "joint3")
"""Nodes at the second card: each Encoder and each Current but joint 2's crosses over."""
HELD_S = 10.0

Got = Callable[[str], None]


def same_as_inline(outcome: Outcome, name: str, duration_s: float = rig.DURATION_S) -> str:
    """Assert that a run is worth what the inline one is; return both in a line."""
    found, wanted = rig.of(outcome), rig.of(rig.functional(name, duration_s))
    assert found.keys() == wanted.keys()
    assert found == wanted
    assert rig.sha256(found) == rig.sha256(wanted)
    assert rig.summary(outcome) == rig.functional_summary(name, duration_s)
    assert outcome.lost_frames == 0
    frames = len(outcome.log.frames)
    return (
        f"{name}, {duration_s:g} s: {frames} frames of {len(found)} identifiers, sha256 {rig.sha256(found)[:16]}, as "
        f"inline; the same summary; lost 0; {outcome.wall_s:.0f} s of wall time"
    )


def witnessed(outcome: Outcome, channel: str, path: Path) -> str:
    """Assert that candump heard what the rig logged, and that cantools reads it; return both in a line."""
    heard = candump.frames(path)
    places = candump.same(outcome, heard)
    return (
        f"candump at {channel} heard the {len(heard)} frames that the rig logged, each identifier in order ({places} "
        f"places differ between identifiers); cantools decoded {candump.decode(heard)}"
    )


@pytest.mark.row("vcan0", "witnesses")
@pytest.mark.usefixtures("nodes")
def test_paper_task_on_vcan0(vcan: str, tmp_path: Path, got: Got) -> None:
    with candump.dumped(vcan, tmp_path) as path:
        outcome = run_on_bus(rig.scenario("paper-task"), Place("socketcan", vcan, {}), patience_s=PATIENCE_S)
    got(same_as_inline(outcome, "paper-task"))
    got(witnessed(outcome, vcan, path))


@pytest.mark.row("cards", "witnesses")
@pytest.mark.parametrize("name", ["paper-joint", "paper-task"])
@pytest.mark.usefixtures("nodes")
def test_nodes_at_two_cards(name: str, cards: tuple[str, str], tmp_path: Path, got: Got) -> None:
    before = kernel.losses(*cards)
    place, elsewhere = Place("socketcan", cards[0], {}), dict.fromkeys(AT_THE_OTHER, cards[1])
    with candump.dumped(cards[1], tmp_path) as path:
        outcome = run_on_bus(rig.scenario(name), place, elsewhere=elsewhere, patience_s=PATIENCE_S)
    got(same_as_inline(outcome, name))
    got(witnessed(outcome, cards[1], path))
    assert kernel.losses(*cards) == before
    refused = sum(report["full_queue"] for report in outcome.reports.values())
    got(
        f"{', '.join(AT_THE_OTHER)} at {cards[1]}, the others at {cards[0]}: ENOBUFS met {refused} times; "
        f"{', '.join(kernel.LOSSES)} of both cards 0"
    )


@pytest.mark.row("debugger")
def test_joint_in_a_debugger_holds_the_robot_still(vcan: str, nodes: dict[str, Any], got: Got) -> None:
    said: list[str] = []
    held: list[threading.Timer] = []

    def stop_in_the_middle(share: float) -> None:
        if share >= 0.5 and not held:
            os.kill(nodes["joint1"].pid, signal.SIGSTOP)
            held.append(threading.Timer(HELD_S, os.kill, (nodes["joint1"].pid, signal.SIGCONT)))
            held[0].start()

    place = Place("socketcan", vcan, {})
    outcome = run_on_bus(rig.scenario("paper-joint"), place, progress=stop_in_the_middle, notice=said.append)
    got(same_as_inline(outcome, "paper-joint"))
    assert outcome.wall_s > HELD_S
    waited = [text for text in said if text.startswith("waiting for joint1 for ")]
    assert any(int(text.split()[-2]) >= HELD_S / 2 for text in waited), said
    got(f"joint1 held by SIGSTOP for {HELD_S:g} s; said: {waited[-1]!r}")
