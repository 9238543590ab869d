"""Joint 2 as a board: the program in C plays it on vcan0, and at the far card of two; the rig plays the others."""

import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from hil.bus_rig import run_on_bus
from hil.can_node import Place
from hil.can_port import CanPort
from hil.errors import NodeError
from tests.lab.inside import kernel, rig
from tests.lab.inside.test_rig import PATIENCE_S, Got, same_as_inline

SHORT_PATIENCE_S = 4.0
LIMIT_S = 60.0
STOP = 0x010

Board = subprocess.Popen[str]
Start = Callable[[str], Board]


@pytest.fixture
def start(joint_c: Path) -> Iterator[Start]:
    """Start the board at an interface; go on when it listens."""
    started: list[Board] = []

    def play(channel: str) -> Board:
        board = subprocess.Popen([joint_c, channel, "2"], text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        started.append(board)
        assert board.stdout is not None
        assert "waits for the set-up" in board.stdout.readline()
        return board

    yield play
    for board in started:
        board.kill()
        board.communicate()


@pytest.mark.row("board")
@pytest.mark.usefixtures("nodes")
def test_board_plays_joint_2(pair: tuple[str, str], start: Start, got: Got) -> None:
    name = "paper-joint" if pair[0] == pair[1] else "paper-task"
    board = start(pair[1])
    before = kernel.losses(*set(pair))
    outcome = run_on_bus(rig.scenario(name), Place("socketcan", pair[0], {}), ["joint2"], patience_s=PATIENCE_S)
    said, complaint = board.communicate(timeout=LIMIT_S)
    assert board.returncode == 0, complaint
    assert "fault 0" in said
    assert kernel.losses(*set(pair)) == before
    got(f"board at {pair[1]}: {same_as_inline(outcome, name)}; it said: {said.strip()!r}")


@pytest.mark.row("trouble")
@pytest.mark.usefixtures("nodes")
def test_board_that_was_killed_and_started_again_cannot_go_on(vcan: str, start: Start, got: Got) -> None:
    boards = [start(vcan)]
    said: list[str] = []
    witness = CanPort("socketcan", vcan, {STOP})

    def kill_in_the_middle(share: float) -> None:
        if share >= 0.5 and len(boards) == 1:
            boards[0].send_signal(signal.SIGKILL)
            boards.append(start(vcan))

    with pytest.raises(NodeError, match="joint2 has not answered for") as caught:
        run_on_bus(rig.scenario("paper-joint"), Place("socketcan", vcan, {}), ["joint2"],
                   progress=kill_in_the_middle, notice=said.append, patience_s=SHORT_PATIENCE_S)  # fmt: skip
    assert any(text.startswith("waiting for joint2") for text in said)
    assert [witness.receive(LIMIT_S), witness.receive(LIMIT_S)] == [(STOP, b"\1")] * 2
    witness.close()
    assert boards[1].poll() is None
    got(f"board killed and started again: {caught.value}; Stop was sent; the new one waits for the next set-up")


@pytest.mark.row("trouble")
@pytest.mark.usefixtures("nodes", "lab")
def test_board_whose_link_is_cut_is_named(cards: tuple[str, str], start: Start, got: Got) -> None:
    board = start(cards[1])
    witness = CanPort("socketcan", cards[0], {STOP})
    cut: list[float] = []

    def cut_in_the_middle(share: float) -> None:
        if share >= 0.5 and not cut:
            cut.append(share)
            kernel.set_link(cards[1], "down")

    try:
        with pytest.raises(NodeError, match="joint2 has not answered for") as caught:
            run_on_bus(rig.scenario("paper-joint"), Place("socketcan", cards[0], {}), ["joint2"],
                       progress=cut_in_the_middle, patience_s=SHORT_PATIENCE_S)  # fmt: skip
    finally:
        kernel.set_link(cards[1], "up")
    assert [witness.receive(LIMIT_S), witness.receive(LIMIT_S)] == [(STOP, b"\1")] * 2
    witness.close()
    _, complaint = board.communicate(timeout=LIMIT_S)
    assert board.returncode == 4
    assert "Network is down" in complaint
    got(f"link of the board cut: {caught.value}; Stop was sent; the board: {complaint.strip()!r}")
