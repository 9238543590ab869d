"""An interface is looked at before a run: recordings of `ip -json` (links/), of what an emulated card cannot be."""

from pathlib import Path
from typing import Any

import pytest

from hil import before_run, scenario_file
from hil.before_run import check_place
from hil.can_node import Place
from hil.doctor.link import from_ip
from hil.errors import ChannelError

RECORDED = Path(__file__).parent / "links"
REFUSED = {
    "bus-off": "can0: error state: BUS-OFF .wanted: ERROR-ACTIVE.: look for a node at another bit rate.*set can0 up",
    "500k": "can0: bit rate: 500000 bit/s .wanted: 1000000 bit/s.*sudo ip link set can0 type can bitrate 1000000",
    "down": "can0: up: down .wanted: up.: sudo ip link set can0 up",
    "listen-only": "can0: controller: LISTEN-ONLY: it neither sends nor acknowledges",
    "vcan0-down": "vcan0: up: down .wanted: up.: sudo ip link set vcan0 up",
    "lo": "lo: interface: lo is not CAN",
}
TAKEN = ("can0", "vcan0", "restart-0")


def check(recording: str, monkeypatch: pytest.MonkeyPatch, *change: str) -> None:
    text = (RECORDED / f"{recording}.json").read_text()
    link = from_ip(text.replace(*change) if change else text)
    monkeypatch.setattr(before_run, "read_link", lambda _name: link)
    check_place(Place("socketcan", link.name, {}), scenario_file.load("paper-joint"))


@pytest.mark.parametrize("recording", REFUSED)
def test_interface_on_which_no_run_can_be_is_refused_with_the_cure(
    recording: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ChannelError, match=f"socketcan {REFUSED[recording]}"):
        check(recording, monkeypatch)


@pytest.mark.parametrize("recording", TAKEN)
def test_interface_that_will_do_is_taken(recording: str, monkeypatch: pytest.MonkeyPatch) -> None:
    check(recording, monkeypatch)


@pytest.mark.parametrize(("state", "taken"), [("ERROR-PASSIVE", True), ("ERROR-WARNING", True), ("SLEEPING", False)])
def test_error_states(state: str, taken: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A controller that was alone is error-passive, until somebody acknowledges."""
    if taken:
        check("can0", monkeypatch, "ERROR-ACTIVE", state)
        return
    with pytest.raises(ChannelError, match=f"error state: {state}"):
        check("can0", monkeypatch, "ERROR-ACTIVE", state)


def test_interface_inside_one_process_is_refused(hil: Any) -> None:
    run = hil.run("run", "-i", "virtual", "-c", "x")
    assert run.returncode == 4
    assert "virtual x is inside one process" in run.stderr
    assert "-i hil" in run.stderr
