"""What goes wrong in the middle of a run by the Sync frame: it ends, says why, and leaves nothing behind."""

import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import pytest

from hil.bus_rig import run_on_bus
from hil.can_node import Place
from hil.can_port import CanPort
from hil.errors import NodeError
from tests.lab.inside import kernel, rig
from tests.lab.inside.test_rig import PATIENCE_S, Got

STOP = 0x010
DOWN_S = 0.5


class Once:
    """Does something in the middle of a run, once."""

    def __init__(self, act: Callable[[], object]) -> None:
        self.act: Callable[[], object] | None = act

    def __call__(self, share: float) -> None:
        if share >= 0.5 and self.act is not None:
            act, self.act = self.act, None
            act()


def run(channel: str, progress: Once, elsewhere: dict[str, str] | None = None) -> list[str]:
    """Run; return what the rig said."""
    said: list[str] = []
    place = Place("socketcan", channel, {})
    run_on_bus(rig.scenario("paper-joint"), place, (), elsewhere or {}, progress, said.append, PATIENCE_S)
    return said


def heard(witness: CanPort) -> tuple[int, bytes]:
    """Return the next frame, whatever happened to the interface in the meantime."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        with suppress(NodeError):
            found = witness.receive(1.0)
            if found is not None:
                return found
    raise AssertionError("heard nothing")


@pytest.mark.row("trouble")
@pytest.mark.usefixtures("nodes", "lab", "up")
def test_interface_that_goes_down_and_up_ends_the_run_with_a_stop(vcan: str, got: Got) -> None:
    witness = CanPort("socketcan", vcan, {STOP})

    def down_and_up() -> None:
        kernel.set_link(vcan, "down")
        time.sleep(DOWN_S)
        kernel.set_link(vcan, "up")

    with pytest.raises(NodeError, match=f"socketcan {vcan}: cannot .*Network is down") as caught:
        run(vcan, Once(down_and_up))
    assert heard(witness) == (STOP, b"\1")
    witness.close()
    got(f"interface down and up: {caught.value}; Stop was sent")


@pytest.mark.row("trouble")
@pytest.mark.usefixtures("nodes", "lab", "up")
def test_interface_that_stays_down_ends_the_run_without_a_stop_and_says_so(vcan: str, got: Got) -> None:
    said: list[str] = []
    down = Once(lambda: kernel.set_link(vcan, "down"))
    with pytest.raises(NodeError, match=f"socketcan {vcan}: cannot .*Network is down"):
        run_on_bus(rig.scenario("paper-joint"), Place("socketcan", vcan, {}), progress=down, notice=said.append)
    assert "no Stop was sent" in said[-1]
    got(f"interface down for good: {said[-1]}")


@pytest.mark.row("trouble")
@pytest.mark.usefixtures("nodes", "lab")
def test_cut_link_ends_the_run_with_a_stop(cards: tuple[str, str], got: Got) -> None:
    witness = CanPort("socketcan", cards[0], {STOP})
    try:
        with pytest.raises(NodeError, match=f"joint1 .*socketcan {cards[1]}: cannot .*Network is down") as caught:
            run(cards[0], Once(lambda: kernel.set_link(cards[1], "down")), {"joint1": cards[1]})
    finally:
        kernel.set_link(cards[1], "up")
    assert heard(witness) == (STOP, b"\1")
    witness.close()
    got(f"link cut: {caught.value}; Stop was sent")


@pytest.mark.row("trouble")
def test_killed_node_ends_the_run_with_its_name_and_a_stop(vcan: str, nodes: dict[str, Any], got: Got) -> None:
    witness = CanPort("socketcan", vcan, {STOP})
    with pytest.raises(NodeError, match="joint3 was killed by SIGKILL in the middle of the run") as caught:
        run(vcan, Once(lambda: os.kill(nodes["joint3"].pid, signal.SIGKILL)))
    assert heard(witness) == (STOP, b"\1")
    witness.close()
    got(f"node killed: {caught.value}; Stop was sent")
