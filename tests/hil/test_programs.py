"""Other people's programs on interface `hil`, unchanged and as processes: python-can's own, and cantools monitor."""

import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from copy import copy
from pathlib import Path

import can
import pyte
import pytest

from tests.hil.frames import standard

pytestmark = pytest.mark.usefixtures("bounded")

DATABASE = Path(__file__).parents[2] / "dbc" / "arm.dbc"
GUARD_S = 10
ROWS, COLUMNS = 40, 120


FRAMES = [
    can.Message(arbitration_id=0x12, is_extended_id=True, data=[0xFF]),
    standard(0x123, 0x11, 0x22, 0x33),
    can.Message(arbitration_id=0x200, is_extended_id=False, is_remote_frame=True),
    can.Message(arbitration_id=0x1ABCDEF0, is_extended_id=True, data=range(8)),
    standard(0x7FF),
]
"""In the order in which arbitration lets them pass, so that they keep it even if some of them wait together."""


def same(received, sent):
    return len(received) == len(sent) and all(
        message.equals(other, timestamp_delta=None, check_channel=False, check_direction=False)
        for message, other in zip(received, sent, strict=True)
    )


@pytest.fixture
def join():
    made = []

    def make(channel="arm", **kwargs):
        made.append(can.Bus(interface="hil", channel=channel, **kwargs))
        return made[-1]

    yield make
    for bus in made:
        bus.shutdown()


def lines_until(process, pattern):
    """What a program prints, up to the line that matches."""
    lines = []
    for line in process.stdout:
        lines.append(line)
        if re.search(pattern, line):
            return lines
    pytest.fail("".join([*lines, process.stderr.read()]))


def interrupt(process):
    """Ctrl-C; return (exit code, the rest of its output, its errors)."""
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=GUARD_S)
    return process.returncode, output, errors


# -- python -m can.logger --


@pytest.mark.parametrize("ending", ["log", "asc", "blf", "csv", "db"])
def test_logger_writes_its_files(hil, join, ending):
    """The bus ends first, and ends for an observer when it has got all frames: so the file has them all."""
    serving, bus, ear = hil.bus("arm"), join(), join()
    logger = hil.program("can.logger", "-i", "hil", "-c", "arm", "-f", f"arm.{ending}")
    lines_until(logger, "Can Logger")
    sent = [message for message in FRAMES for _ in range(3)]
    for message in sent:
        bus.send(message, timeout=GUARD_S)
        assert same([ear.recv(GUARD_S)], [message])
    interrupt(serving)
    _, errors = logger.communicate(timeout=GUARD_S)
    assert "the bus has ended" in errors
    with can.LogReader(hil.folder / f"arm.{ending}") as reader:
        logged = list(reader)
    assert same(logged, sent)
    times = [message.timestamp for message in logged]
    assert times == sorted(times)


def test_logger_prints_and_ends_by_ctrl_c(hil, join):
    hil.bus("arm")
    bus = join()
    logger = hil.program("can.logger", "-i", "hil", "-c", "arm", "--filter", "100:700")
    assert any("hil channel arm" in line for line in lines_until(logger, "Can Logger"))
    for identifier in (0x223, 0x123, 0x145):
        bus.send(standard(identifier, 0xAB))
    printed = "".join(lines_until(logger, "ID: +145"))
    assert re.search("ID: +123", printed)
    assert not re.search("ID: +223", printed)
    assert interrupt(logger)[0] == 0


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["-c", "leg"], "start one with `hil bus leg`"),
        (["-c", "arm", "-b", "250000"], "250000"),
        (["-c", "arm", "--fd"], "--data-bitrate"),
    ],
)
def test_program_is_told_why_it_cannot_join(hil, words, text):
    hil.bus("arm")
    logger = hil.program("can.logger", "-i", "hil", *words)
    _, errors = logger.communicate(timeout=GUARD_S)
    assert logger.returncode != 0
    assert text in errors


# -- python -m can.player --


def test_player_replays_a_log_in_its_time(hil, join):
    hil.bus("arm")
    bus = join()
    with can.Logger(hil.folder / "arm.log") as log:
        for number, message in enumerate(FRAMES):
            stamped = copy(message)
            stamped.timestamp = 1 + 0.05 * number
            log(stamped)
    player = hil.program("can.player", "-i", "hil", "-c", "arm", "arm.log")
    heard = [bus.recv(GUARD_S) for _ in FRAMES]
    assert same(heard, FRAMES)
    assert bus.recv(0.1) is None
    assert player.wait(GUARD_S) == 0
    assert heard[-1].timestamp - heard[0].timestamp > 0.1


# -- python -m can.bridge --


@pytest.mark.parametrize("servers", [["arm leg"], ["arm", "leg"]], ids=["one-server", "two-servers"])
def test_bridge_carries_frames_both_ways(hil, join, servers):
    for channels in servers:
        hil.bus(channels)
    ends = ["--bus1-interface", "hil", "--bus1-channel", "arm", "--bus2-interface", "hil", "--bus2-channel", "leg"]
    bridge = hil.program("can.bridge", *ends)
    lines_until(bridge, "Started")
    arm, leg = join("arm"), join("leg")
    for here, there in ((arm, leg), (leg, arm)):
        for message in FRAMES:
            here.send(message)
            heard = there.recv(GUARD_S)
            assert same([heard], [message])
            assert heard.channel == there.channel_info.split()[-1]
        assert here.recv(0) is None
    code, output, _ = interrupt(bridge)
    assert code == 0
    assert "Stopped" in output


def test_bridged_channels_of_one_server_share_their_time(hil, join):
    """A frame ends on the one channel before its copy ends on the other, by one and the same clock."""
    hil.bus("arm leg")
    ends = ["--bus1-interface", "hil", "--bus1-channel", "arm", "--bus2-interface", "hil", "--bus2-channel", "leg"]
    lines_until(hil.program("can.bridge", *ends), "Started")
    arm, leg = join("arm", receive_own_messages=True), join("leg")
    for number in range(10):
        arm.send(standard(0x123, number))
        assert arm.recv(GUARD_S).timestamp < leg.recv(GUARD_S).timestamp


# -- programs with a screen --


class Terminal:
    """A program in a terminal of its own, and what its screen shows."""

    def __init__(self, folder, *words):
        self.screen = pyte.Screen(COLUMNS, ROWS)
        self._stream = pyte.ByteStream(self.screen)
        self._master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, COLUMNS, 0, 0))
        self.process = subprocess.Popen(
            [sys.executable, "-m", *words],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            cwd=folder,
            env=os.environ | {"TERM": "linux"},
            start_new_session=True,
        )
        os.close(slave)

    def until(self, *patterns):
        """Wait for lines that match, one for each pattern, to stand on the screen."""
        deadline = time.monotonic() + GUARD_S
        while not all(re.search(pattern, "\n".join(self.screen.display), re.M) for pattern in patterns):
            if time.monotonic() > deadline or not self._take(0.1):
                pytest.fail(f"{patterns} are not all on the screen:\n" + "\n".join(self.screen.display))

    def _take(self, timeout_s):
        """Take what it draws; False at its end."""
        if not select.select([self._master], [], [], timeout_s)[0]:
            return True
        try:
            drawn = os.read(self._master, 1 << 16)
        except OSError:
            return False
        self._stream.feed(drawn)
        return bool(drawn)

    def press(self, key):
        os.write(self._master, key.encode())

    def end(self):
        """Take the rest, so that nothing holds it; return the exit code."""
        deadline = time.monotonic() + GUARD_S
        while time.monotonic() < deadline and self._take(0.1):
            pass
        return self.process.wait(GUARD_S)

    def close(self):
        self.process.kill()
        self.process.wait()
        os.close(self._master)


@pytest.fixture
def terminal(tmp_path):
    made = []

    def start(*words):
        made.append(Terminal(tmp_path, *words))
        return made[-1]

    yield start
    for each in made:
        each.close()


def test_viewer_shows_every_identifier_and_quits(hil, join, terminal):
    hil.bus("arm")
    bus = join()
    viewer = terminal("can.viewer", "-i", "hil", "-c", "arm")
    viewer.until("Count", "DLC")
    for message in [*FRAMES, FRAMES[1]]:
        bus.send(message)
    viewer.until("0x7FF +0", "0x1ABCDEF0 +8 +00 01 02 03 04 05 06 07", "0x00000012 +1 +FF", "0x200 +0")
    viewer.until(r"^2 +\S+ +\S+ +0x123 +3 +11 22 33")
    viewer.press("q")
    assert viewer.end() == 0


def test_monitor_decodes_by_the_database(hil, join, terminal):
    """Frames of arm.dbc by name, with signals and units; one that is not in it is counted."""
    hil.bus("arm")
    bus = join()
    monitor = terminal("cantools", "monitor", str(DATABASE), "-i", "hil", "-c", "arm")
    monitor.until("q: Quit")
    bus.send(standard(0x101, 0xE8, 0x03, 42, 0))
    bus.send(standard(0x080, 42))
    bus.send(standard(0x7F0, 1))
    monitor.until("Received: 3, Discarded: 1, Errors: 0", r"Encoder_1\(", r"Sync\(", "Cycle: 42 cycle")
    monitor.press("q")
    assert monitor.end() == 0
