"""The ground that the rig will stand on: python-can's SocketCAN on vcan0 and between two cards, seen by others, too.

The cards' receive FIFO holds 64 bytes and overruns, so a test that wants all its frames waits for each of them.
"""

import errno
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import can
import pytest

from tests.hil.frames import standard
from tests.lab.inside import kernel
from tests.lab.inside.conftest import Join, needs

ROUND_TRIPS = 500
BURST = 1000
BUFFERED = 100
"""Frames that the buffer of a socket surely holds (by default some 270)."""
LIMIT_S = 20.0
GUARD_S = 120.0
STAMP_S = 0.01
"""How much earlier or later than the calls around it a stamp may be: clocks are slewed."""
KINDS = [
    *(standard(0x100 + length, *range(length)) for length in range(9)),
    standard(0x7FF),
    can.Message(arbitration_id=0x1ABCDEF0, is_extended_id=True, data=range(8)),
    can.Message(arbitration_id=0x200, is_extended_id=False, is_remote_frame=True),
]
"""The remote frame asks for no bytes: QEMU's SJA1000 would store those that it asks for, skip none of them when the
frame is taken, and from then on hand out what lies in its FIFO at the wrong places (`can_sja1000.c` of QEMU 7.2)."""


def heard(bus: can.BusABC) -> can.Message:
    """Return the next frame."""
    message = bus.recv(LIMIT_S)
    assert message is not None
    return message


def content(message: can.Message) -> tuple[int, bytes]:
    return message.arbitration_id, bytes(message.data)


def same(one: can.Message, other: can.Message) -> bool:
    return one.equals(other, timestamp_delta=None, check_channel=False, check_direction=False)


@contextmanager
def listening(channel: str, *command: str) -> Iterator[subprocess.Popen[str]]:
    """Run a program that listens to a channel; go on when it does."""
    before = kernel.listeners(channel)
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        guard = threading.Timer(GUARD_S, process.kill)
        guard.start()
        try:
            kernel.wait_for(lambda: kernel.listeners(channel) > before, f"{command[0]} listens to {channel}")
            yield process
        finally:
            guard.cancel()
            process.kill()


def test_there_and_back(pair: tuple[str, str], join: Join, report: Callable[[str, dict[str, Any]], None]) -> None:
    left, right = (join(channel) for channel in pair)
    began = time.monotonic()
    for k in range(ROUND_TRIPS):
        left.send(standard(0x101, k & 0xFF, 1, 2, 3))
        assert content(heard(right)) == (0x101, bytes([k & 0xFF, 1, 2, 3]))
        right.send(standard(0x121, k & 0xFF, 4, 5, 6))
        assert content(heard(left)) == (0x121, bytes([k & 0xFF, 4, 5, 6]))
    rate = ROUND_TRIPS / (time.monotonic() - began)
    report(f"round-trips-{pair[0]}-{pair[1]}", {"frames there and back a second": round(rate)})
    assert left.recv(0) is None


def test_every_kind_of_classic_frame(pair: tuple[str, str], join: Join) -> None:
    left, right = (join(channel) for channel in pair)
    for message in KINDS:
        left.send(message)
        assert same(heard(right), message)


def test_stamps_are_of_the_system_clock(pair: tuple[str, str], join: Join) -> None:
    left, right = (join(channel) for channel in pair)
    last = 0.0
    for k in range(50):
        before = time.time()
        left.send(standard(0x101, k))
        stamp = heard(right).timestamp
        assert before - STAMP_S <= stamp <= time.time() + STAMP_S
        assert stamp >= last
        last = stamp


def test_a_sender_hears_itself_if_it_wants(pair: tuple[str, str], join: Join) -> None:
    own = join(pair[0], receive_own_messages=True)
    own.send(standard(0x101, 1))
    message = heard(own)
    assert content(message) == (0x101, b"\1")
    assert not message.is_rx


def test_candump_hears_the_same(pair: tuple[str, str], join: Join) -> None:
    candump = needs(kernel.program, "candump")
    sent = [standard(0x101 + k % 7, k, 255 - k) for k in range(100)]
    with listening(pair[1], candump, "-L", "-n", str(len(sent)), pair[1]) as witness:
        left, right = (join(channel) for channel in pair)
        for message in sent:
            left.send(message)
            heard(right)
        lines = witness.communicate(timeout=LIMIT_S)[0].split()[2::3]
    assert lines == [f"{m.arbitration_id:03X}#{m.data.hex().upper()}" for m in sent]


def test_cansend_is_heard(pair: tuple[str, str], join: Join) -> None:
    right = join(pair[1])
    subprocess.run([needs(kernel.program, "cansend"), pair[0], "010#02"], check=True)
    assert content(heard(right)) == (0x010, b"\2")


def burst(bus: can.BusABC, frames: int) -> list[int | None]:
    """Send without a pause; return the errors of those that were not taken."""
    errors: list[int | None] = []
    for k in range(frames):
        try:
            bus.send(standard(0x101, k & 0xFF, *range(7)))
        except can.CanOperationError as error:
            errors.append(error.error_code)
    return errors


@pytest.mark.usefixtures("slow_wire")
def test_a_burst_fills_the_queue_and_every_refusal_counts(cards: tuple[str, str], join: Join) -> None:
    left = join(cards[0])
    sent, refused = kernel.sent(cards[0])["packets"], needs(kernel.refused, cards[0])
    errors = burst(left, BURST)
    assert 0 < len(errors) < BURST
    assert set(errors) == {errno.ENOBUFS}
    kernel.wait_for(lambda: kernel.sent(cards[0])["packets"] - sent == BURST - len(errors), "what was taken is sent")
    assert kernel.refused(cards[0]) - refused == len(errors)


def overrun(message: can.Message) -> bool:
    """Return whether this is CAN_ERR_CRTL with CAN_ERR_CRTL_RX_OVERFLOW of linux/can/error.h."""
    return message.is_error_frame and bool(message.arbitration_id & 0x04 and message.data[1] & 0x01)


@pytest.mark.usefixtures("lab")
def test_the_receive_fifo_overruns_and_says_so(cards: tuple[str, str], join: Join) -> None:
    before = kernel.received(cards[1])
    left, right = (join(channel) for channel in cards)
    taken, frames, overruns = 0, 0, 0
    while not overruns and taken < 50 * BURST:
        taken += BUFFERED - len(burst(left, BUFFERED))
        while (message := right.recv(0.5)) is not None:
            overruns += overrun(message)
            frames += not message.is_error_frame
    after = kernel.received(cards[1])
    assert 0 < overruns == after["over_errors"] - before["over_errors"]
    assert 0 < frames < taken


def test_the_bit_rate_is_read_back(cards: tuple[str, str]) -> None:
    for card in cards:
        controller = kernel.link(card)["linkinfo"]["info_data"]
        assert controller["bittiming"]["bitrate"] == 1_000_000
        assert controller["state"] == "ERROR-ACTIVE"


@pytest.mark.usefixtures("lab")
def test_another_bit_rate_takes_the_link_down_and_up(cards: tuple[str, str], join: Join) -> None:
    for rate in (500_000, 1_000_000):
        kernel.set_link(cards[0], "down")
        kernel.set_link(cards[0], "type", "can", "bitrate", str(rate))
        kernel.set_link(cards[0], "up")
        assert kernel.link(cards[0])["linkinfo"]["info_data"]["bittiming"]["bitrate"] == rate
    left, right = (join(channel) for channel in cards)
    left.send(standard(0x101))
    assert content(heard(right)) == (0x101, b"")


@pytest.mark.usefixtures("lab")
def test_a_link_that_is_down_refuses(pair: tuple[str, str], join: Join) -> None:
    left = join(pair[0])
    kernel.set_link(pair[0], "down")
    try:
        with pytest.raises(can.CanOperationError) as caught:
            left.send(standard(0x101))
        assert caught.value.error_code == errno.ENETDOWN
    finally:
        kernel.set_link(pair[0], "up")


def test_an_interface_that_is_not_there() -> None:
    needs(kernel.family)
    with pytest.raises(OSError, match="No such device") as caught:
        can.Bus(interface="socketcan", channel="can99")
    assert caught.value.errno == errno.ENODEV


def test_python_cans_logger_hears_its_player(pair: tuple[str, str], tmp_path: Path) -> None:
    """So few that they fit into the cards' queue, and with 4 bytes each into the FIFO, however late anybody is."""
    tape = tmp_path / "tape.log"
    with can.CanutilsLogWriter(tape, channel=pair[0]) as writer:
        for k in range(10):
            writer(can.Message(timestamp=k * 0.005, arbitration_id=0x120 + k % 3, is_extended_id=False, data=[k]))
    python = (sys.executable, "-u", "-m")
    with listening(pair[1], *python, "can.logger", "-i", "socketcan", "-c", pair[1]) as logger:
        subprocess.run([*python, "can.player", "-i", "socketcan", "-c", pair[0], str(tape)], check=True)
        assert logger.stdout is not None
        found = (re.search(r"ID:\s+(\w+) .* DL:\s+1\s+(\w+)", line) for line in logger.stdout)
        heard = [match.groups() for match in islice((match for match in found if match), 10)]
    assert heard == [(f"{0x120 + k % 3:x}", f"{k:02x}") for k in range(10)]
