"""The rig's own way to an interface, hil/can_port.py, under a burst: what is not lost, and what is said of what is."""

import threading

import pytest

from hil.can_port import CanPort
from tests.lab.inside import kernel
from tests.lab.inside.conftest import needs
from tests.lab.inside.test_rig import Got

BURST = 300
PART = 100
QUIET_S = 0.5
LIMIT_S = 20.0


def frame(k: int) -> tuple[int, bytes]:
    return 0x101, bytes([k & 0xFF, k >> 8, *range(6)])


def joined(*channels: str) -> list[CanPort]:
    return [CanPort("socketcan", channel, None) for channel in channels]


def taken(port: CanPort) -> list[tuple[int, bytes]]:
    """Return what comes until there is silence."""
    found, strangers = [], -1
    while strangers != port.strangers:
        strangers = port.strangers
        while (heard := port.receive(QUIET_S)) is not None:
            found.append(heard)
    return found


@pytest.mark.row("burst")
@pytest.mark.usefixtures("slow_wire")
def test_a_burst_waits_for_the_queue_and_loses_nothing(cards: tuple[str, str], got: Got) -> None:
    left, right = joined(*cards)
    refused = needs(kernel.refused, cards[0])
    sender = threading.Thread(target=lambda: [left.send(*frame(k)) for k in range(BURST)])
    sender.start()
    heard = [right.receive(LIMIT_S) for _ in range(BURST)]
    sender.join()
    left.close()
    right.close()
    assert heard == [frame(k) for k in range(BURST)]
    assert 0 < left.retries == kernel.refused(cards[0]) - refused
    got(f"{BURST} frames at once, the wire at 100 kbit/s: ENOBUFS {left.retries} times, counted; all heard")


@pytest.mark.row("burst")
@pytest.mark.usefixtures("lab")
def test_an_overrun_of_the_receive_fifo_is_counted(cards: tuple[str, str], got: Got) -> None:
    left, right = joined(*cards)
    before, sent, heard = kernel.losses(*cards)["rx_over_errors"], 0, 0
    while not right.strangers and sent < 500 * PART:
        for k in range(PART):
            left.send(*frame(k))
        sent += PART
        heard += len(taken(right))
    left.close()
    right.close()
    overruns = kernel.losses(*cards)["rx_over_errors"] - before
    assert 0 < overruns == right.strangers
    assert 0 < heard < sent
    got(
        f"{sent} frames as fast as they go: {sent - heard} lost in {overruns} overruns of the FIFO, each an error frame"
    )
