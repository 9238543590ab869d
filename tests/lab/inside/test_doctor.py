"""`hil doctor` of real interfaces: what it says of them, and that its cures are cures."""

import subprocess
import threading
import time
from collections.abc import Iterator

import can
import pytest

from hil import scenario_file
from hil.can_node import Place
from hil.doctor.examine import examine
from hil.doctor.finding import Finding
from hil.doctor.link_checks import CLAIMS, OF_BITS
from hil.scenario import Scenario
from tests.lab.inside import kernel
from tests.lab.inside.conftest import Join

LISTEN_S = 1.0


@pytest.fixture
def scenario() -> Scenario:
    return scenario_file.load("paper-joint")


@pytest.fixture
def card(request: pytest.FixtureRequest, cards: tuple[str, str]) -> Iterator[str]:
    """A card of the lab that may be set up as a test likes; afterwards it is as before."""
    request.getfixturevalue("lab")
    yield cards[0]
    kernel.set_link(cards[0], "down")
    kernel.set_link(cards[0], "txqueuelen", "10")
    kernel.set_link(cards[0], "type", "can", "bitrate", "1000000", "restart-ms", "0", "listen-only", "off")
    kernel.set_link(cards[0], "up")


def examined(channel: str, scenario: Scenario, listen_s: float = 0.1) -> dict[str, Finding]:
    return {found.name: found for found in examine(Place("socketcan", channel, {}), scenario, listen_s)}


def test_vcan_is_there_and_nothing_is_claimed_of_it(vcan: str, scenario: Scenario) -> None:
    found = examined(vcan, scenario)
    assert (found["kernel"].verdict, found["interface"].verdict, found["up"].verdict) == ("ok", "ok", "ok")
    assert {found[name].verdict for name in (*OF_BITS, CLAIMS)} == {"unknown"}
    assert found["time stamps"].verdict == "ok"


def test_card_is_fit(cards: tuple[str, str], scenario: Scenario) -> None:
    found = examined(cards[0], scenario)
    for name in ("bit rate", "sample point", "controller", "error state", "error counters", "txqueuelen", CLAIMS):
        assert found[name].verdict == "ok", found[name]


def test_sender_of_our_identifiers_is_heard(pair: tuple[str, str], join: Join, scenario: Scenario) -> None:
    stranger, over = join(pair[1]), threading.Event()

    def send() -> None:
        while not over.is_set():
            stranger.send(can.Message(arbitration_id=0x102, is_extended_id=False, data=b"\1"))
            time.sleep(0.05)

    sender = threading.Thread(target=send)
    sender.start()
    try:
        found = examined(pair[0], scenario, LISTEN_S)
    finally:
        over.set()
        sender.join()
    assert found["other traffic"].verdict == "bad"
    assert "ours: Encoder_2" in found["other traffic"].value
    assert "old when taken" in found["time stamps"].value
    assert found["time stamps"].verdict == "ok"


def test_what_is_wrong_is_found_and_its_cures_mend_it(card: str, scenario: Scenario) -> None:
    kernel.set_link(card, "down")
    kernel.set_link(card, "type", "can", "bitrate", "500000", "listen-only", "on", "restart-ms", "0")
    kernel.set_link(card, "txqueuelen", "2")
    found = examined(card, scenario)
    wrong = {"up": "bad", "bit rate": "bad", "controller": "bad", "restart-ms": "warn", "txqueuelen": "warn"}
    assert {name: found[name].verdict for name in wrong} == wrong
    assert found["other traffic"].value == "not listened to"
    for name in wrong:
        subprocess.run(["sh", "-c", found[name].cure.replace("sudo ", "")], check=True)
    found = examined(card, scenario)
    assert {found[name].verdict for name in wrong} == {"ok"}


@pytest.mark.usefixtures("vcan")
def test_interface_that_is_not_there(scenario: Scenario) -> None:
    assert examined("can9", scenario)["interface"].verdict == "bad"
