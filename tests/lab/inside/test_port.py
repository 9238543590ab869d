"""The rig's own way to an interface, hil/can_port.py, under a burst: what is not lost, and what is said of what is."""

import threading

import pytest

from hil.can_port import CanPort
from tests.lab.inside import kernel
from tests.lab.inside.conftest import needs
from tests.lab.inside.test_rig import Got

SENDERS = 4
BURST = 100
QUIET_S = 0.5
LIMIT_S = 20.0


def frame(k: int, n: int = 0) -> tuple[int, bytes]:
    return 0x101 + n, bytes([k & 0xFF, k >> 8, *range(6)])


def send(port: CanPort, n: int) -> None:
    for k in range(BURST):
        port.send(*frame(k, n))


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
    """A socket waits for its own frames, so it takes several to fill the queue of a device."""
    *senders, right = joined(*[cards[0]] * SENDERS, cards[1])
    refused = needs(kernel.refused, cards[0])
    threads = [threading.Thread(target=send, args=(port, n)) for n, port in enumerate(senders)]
    for thread in threads:
        thread.start()
    heard = [right.receive(LIMIT_S) for _ in range(SENDERS * BURST)]
    for thread in threads:
        thread.join()
    retries = sum(port.retries for port in senders)
    for port in (*senders, right):
        port.close()
    for n in range(SENDERS):
        assert [each for each in heard if each is not None and each[0] == 0x101 + n] == [
            frame(k, n) for k in range(BURST)
        ]
    refused = kernel.refused(cards[0]) - refused
    assert 0 < refused <= retries
    got(
        f"{SENDERS} sockets, {BURST} frames each at once, the wire at 100 kbit/s: ENOBUFS {refused} times, "
        f"{retries} tries counted; all heard, in order"
    )


@pytest.mark.row("burst")
@pytest.mark.usefixtures("lab")
def test_an_overrun_of_the_receive_fifo_is_counted(cards: tuple[str, str], got: Got) -> None:
    """By the controller; each is an error frame, too (test_socketcan.py)."""
    left, right = joined(*cards)
    before, overruns, sent, heard = kernel.losses(*cards)["rx_over_errors"], 0, 0, 0
    while not overruns and sent < 500 * BURST:
        send(left, 0)
        sent += BURST
        heard += len(taken(right))
        overruns = kernel.losses(*cards)["rx_over_errors"] - before
    left.close()
    right.close()
    assert overruns > 0
    assert 0 < heard < sent
    got(f"{sent} frames as fast as they go: {sent - heard} lost in {overruns} overruns of the receive FIFO, counted")
