"""What keeps a run from a real interface, and what its controller tells: each with its cure."""

import errno
import threading
from collections.abc import Iterator

import can
import pytest

from dbc.compiler import load_arm
from hil import scenario_file
from hil.before_run import check_place, check_silence
from hil.can_node import Place
from hil.can_port import CanPort
from hil.errors import ChannelError, NodeError
from tests.hil.frames import standard
from tests.lab.inside import kernel
from tests.lab.inside.conftest import Join
from tests.lab.inside.test_socketcan import BUFFERED, burst

SCENARIO = scenario_file.load("paper-joint")


@pytest.fixture
def card(request: pytest.FixtureRequest, cards: tuple[str, str]) -> Iterator[str]:
    """A card of the lab that may be set up as a test likes; afterwards it is as before."""
    request.getfixturevalue("lab")
    yield cards[0]
    kernel.set_link(cards[0], "down")
    kernel.set_link(cards[0], "type", "can", "bitrate", "1000000", "listen-only", "off")
    kernel.set_link(cards[0], "up")


def test_healthy_interfaces_are_taken(vcan: str, cards: tuple[str, str]) -> None:
    for channel in (vcan, *cards):
        check_place(Place("socketcan", channel, {}), SCENARIO)


WRONG = {
    ("bitrate", "500000"): "bit rate: 500000 bit/s .wanted: 1000000.*sudo ip link set can0 type can bitrate 1000000",
    ("bitrate", "1000000", "listen-only", "on"): "controller: LISTEN-ONLY: it neither sends nor acknowledges",
}


@pytest.mark.parametrize("settings", WRONG, ids=" ".join)
def test_interface_that_is_set_up_otherwise_is_refused(card: str, settings: tuple[str, ...]) -> None:
    kernel.set_link(card, "down")
    kernel.set_link(card, "type", "can", *settings)
    kernel.set_link(card, "up")
    with pytest.raises(ChannelError, match=WRONG[settings]):
        check_place(Place("socketcan", card, {}), SCENARIO)


def test_interface_that_is_down_is_refused_and_one_that_goes_down_names_the_cure(card: str) -> None:
    port = CanPort("socketcan", card, None)
    kernel.set_link(card, "down")
    try:
        with pytest.raises(ChannelError, match=f"up: down .wanted: up.: sudo ip link set {card} up"):
            check_place(Place("socketcan", card, {}), SCENARIO)
        with pytest.raises(NodeError, match=f"cannot send 0x10: .*it is down.*`sudo ip link set {card} up`"):
            port.send(0x010, b"\1")
    finally:
        port.close()


def test_interface_that_is_not_there_is_named(vcan: str) -> None:
    with pytest.raises(ChannelError, match=f"No such device.*`sudo ip link add dev {vcan}9 type vcan`") as caught:
        CanPort("socketcan", f"{vcan}9", None)
    assert f"Errno {errno.ENODEV}" in str(caught.value)


def test_sender_of_our_identifiers_is_named(pair: tuple[str, str], join: Join) -> None:
    stranger, over = join(pair[1]), threading.Event()
    place, codec = Place("socketcan", pair[0], {}), load_arm()
    port = CanPort("socketcan", pair[0], None)
    check_silence(port, place, codec, ())

    def send() -> None:
        while not over.wait(0.02):
            stranger.send(standard(0x122, 1))

    sender = threading.Thread(target=send)
    sender.start()
    try:
        check_silence(port, place, codec, ["joint2"])
        with pytest.raises(ChannelError, match=r"somebody else sends Current_2 0x122 [0-9]+ times a second: another"):
            check_silence(port, place, codec, ["joint1"])
    finally:
        over.set()
        sender.join()
        port.close()


@pytest.mark.usefixtures("lab")
def test_overrun_of_the_controllers_fifo_is_a_loss_that_counts(cards: tuple[str, str], join: Join) -> None:
    left, port = join(cards[0]), CanPort("socketcan", cards[1], {0x010})
    before = kernel.received(cards[1])
    for _ in range(500):
        burst(left, BUFFERED)
        while port.receive(0.3) is not None:
            pass
        if port.errors.counts["receive FIFO overrun"]:
            break
    overruns = kernel.received(cards[1])["over_errors"] - before["over_errors"]
    assert 0 < port.errors.counts["receive FIFO overrun"] == overruns
    port.close()


def test_error_frames_of_socketcan_are_read(pair: tuple[str, str], join: Join) -> None:
    """As a driver would tell: vcan passes on what is sent with CAN_ERR_FLAG; a card does not send it."""
    if pair[0] != "vcan0":
        pytest.skip("a card sends no error frame")
    port, driver = CanPort("socketcan", pair[1], {0x010}), join(pair[0])
    told = can.Message(
        arbitration_id=0x0A8, is_error_frame=True, is_extended_id=False, data=bytes.fromhex("0000801900008000")
    )
    driver.send(told)
    assert port.receive(5.0) is None
    assert port.errors.counts == {"no acknowledgement": 1}
    driver.send(can.Message(arbitration_id=0x040, is_error_frame=True, is_extended_id=False, data=bytes(8)))
    with pytest.raises(NodeError, match=r"socketcan vcan0: the bus is off: .*restart-ms 100"):
        port.receive(5.0)
    port.close()
