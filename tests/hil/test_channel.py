"""Channels by name: which names there are, who may listen, and what a dead bus leaves behind."""

import os
import signal
import socket
import stat
import subprocess
import sys

import pytest

from hil.errors import ChannelError
from hil.wire import channel
from hil.wire.channel import Listener

pytestmark = pytest.mark.usefixtures("bounded", "runtime")


@pytest.fixture
def listener(runtime):
    listener = Listener("arm")
    assert listener.path.is_relative_to(runtime)
    yield listener
    listener.close()


ACCEPTED = ["a", "0", "arm", "Arm_2.left-hand", "a" * 41, "9..", "x-", "can0"]
REFUSED = [
    "",
    ".",
    "..",
    ".arm",
    "-arm",
    "_arm",
    "a" * 42,
    "a/b",
    "../arm",
    "/tmp/arm",
    "a b",
    "a\n",
    "\narm",
    "a\0b",
    "ärm",
    "a:b",
    "a*",
]


@pytest.mark.parametrize("name", ACCEPTED)
def test_name_is_accepted_and_stays_in_the_directory(name, runtime):
    assert channel.socket_path(name).parent == runtime / "hil"


@pytest.mark.parametrize("name", REFUSED)
def test_name_is_refused_by_all_with_the_name_in_the_text(name, runtime):
    for use in (channel.socket_path, Listener, channel.connect):
        with pytest.raises(ChannelError) as refusal:
            use(name)
        assert repr(name) in str(refusal.value)
    assert list(runtime.glob("hil/*")) == []


@pytest.mark.parametrize("umask", [0o000, 0o022, 0o077])
def test_socket_is_for_the_user_alone_whatever_the_umask(umask, runtime):
    before = os.umask(umask)
    try:
        listener = Listener("arm")
    finally:
        os.umask(before)
    mode = listener.path.stat().st_mode
    assert stat.S_ISSOCK(mode)
    assert stat.S_IMODE(mode) == 0o600
    assert stat.S_IMODE((runtime / "hil").stat().st_mode) == 0o700
    listener.close()


def test_without_a_run_time_directory_the_channel_lies_in_a_private_one_of_the_temporary(monkeypatch, runtime):
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setattr(channel.tempfile, "gettempdir", lambda: str(runtime))
    path = channel.folder()
    assert path.parent == runtime
    assert stat.S_IMODE(path.stat().st_mode) == 0o700


def test_directory_of_somebody_else_is_refused(monkeypatch, runtime):
    (runtime / "hil").mkdir(mode=0o700)
    uid = os.getuid()
    monkeypatch.setattr(channel.os, "getuid", lambda: uid + 1)
    with pytest.raises(ChannelError, match="XDG_RUNTIME_DIR"):
        channel.folder()


def test_directory_that_cannot_be_made_is_refused_with_the_cure(monkeypatch, runtime):
    (runtime / "file").write_text("")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime / "file"))
    with pytest.raises(ChannelError, match="XDG_RUNTIME_DIR"):
        Listener("arm")


def test_path_that_is_too_long_for_a_socket_is_refused_with_the_reason(monkeypatch, runtime):
    """A Unix socket's path has 107 bytes at most (unix(7)); Python's error for that has no strerror."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime / ("long" * 30)))
    for use in (Listener, channel.connect):
        with pytest.raises(ChannelError) as refusal:
            use("arm")
        assert "arm" in str(refusal.value)
        assert "None" not in str(refusal.value)
        assert "long" in str(refusal.value)


def test_client_reaches_the_listener(listener):
    client = channel.connect("arm")
    listener.socket.setblocking(True)
    accepted, _ = listener.socket.accept()
    with client, accepted:
        client.sendall(b"hello")
        assert accepted.recv(5) == b"hello"


@pytest.mark.usefixtures("listener")
def test_second_listener_on_a_busy_channel_is_refused_and_the_first_goes_on():
    with pytest.raises(ChannelError, match="'arm' is in use"):
        Listener("arm")
    channel.connect("arm").close()
    assert channel.names() == ["arm"]


@pytest.mark.usefixtures("listener")
def test_two_channels_do_not_touch_each_other():
    other = Listener("other")
    assert channel.names() == ["arm", "other"]
    other.close()
    assert channel.names() == ["arm"]
    channel.connect("arm").close()


def test_channel_is_free_again_when_its_listener_closes(runtime):
    Listener("arm").close()
    assert list((runtime / "hil").iterdir()) == []
    Listener("arm").close()


def test_listener_closed_twice_leaves_its_successor_alone():
    first = Listener("arm")
    first.close()
    second = Listener("arm")
    first.close()
    channel.connect("arm").close()
    assert channel.names() == ["arm"]
    second.close()


@pytest.mark.usefixtures("dead_bus")
def test_looking_for_channels_does_not_keep_a_bus_from_starting(monkeypatch):
    """A client that waits for its bus looks again and again at the lock that a dead one left behind."""
    taken = []
    flock = channel.fcntl.flock

    def start_a_bus_in_the_middle(lock, operation):
        flock(lock, operation)
        if operation & channel.fcntl.LOCK_SH:
            monkeypatch.setattr(channel.fcntl, "flock", flock)
            taken.append(Listener("arm"))

    monkeypatch.setattr(channel.fcntl, "flock", start_a_bus_in_the_middle)
    channel.names()
    for listener in taken:
        listener.close()


# -- what a dead bus leaves --

BUS = """
import sys
from hil.wire.channel import Listener
kept = Listener("arm")
print("there", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def bus_process(runtime):
    """A process that holds the channel 'arm'."""
    process = subprocess.Popen([sys.executable, "-c", BUS], cwd=runtime, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout.readline() == b"there\n"
    yield process
    process.kill()
    process.communicate()


@pytest.fixture
def dead_bus(bus_process, runtime):
    """The socket of a bus that was killed."""
    os.kill(bus_process.pid, signal.SIGKILL)
    bus_process.wait()
    path = runtime / "hil" / "arm.sock"
    assert stat.S_ISSOCK(path.stat().st_mode)
    return path


@pytest.mark.usefixtures("bus_process")
def test_channel_of_another_process_is_seen_reached_and_refused_to_others():
    assert channel.names() == ["arm"]
    channel.connect("arm").close()
    with pytest.raises(ChannelError, match="in use"):
        Listener("arm")


@pytest.mark.usefixtures("dead_bus")
def test_dead_bus_is_not_listed_and_does_not_answer():
    assert channel.names() == []
    with pytest.raises(ChannelError, match=r"'arm': no bus is running there; start one with `hil bus arm`"):
        channel.connect("arm")


def test_dead_bus_is_replaced(dead_bus):
    listener = Listener("arm")
    assert listener.path == dead_bus
    channel.connect("arm").close()
    assert channel.names() == ["arm"]
    listener.close()


@pytest.mark.usefixtures("listener")
def test_connect_to_nothing_says_so_and_what_there_is():
    with pytest.raises(ChannelError, match=r"'leg': no bus is running there; .*\(running: arm\)"):
        channel.connect("leg")


def test_connect_where_nothing_runs_says_none():
    with pytest.raises(ChannelError, match=r"\(running: none\)"):
        channel.connect("arm")


def test_file_in_the_place_of_a_socket_is_no_bus(runtime):
    (runtime / "hil").mkdir(mode=0o700)
    (runtime / "hil" / "arm.sock").write_text("")
    with pytest.raises(ChannelError, match="'arm'"):
        channel.connect("arm")
    assert channel.names() == []


def test_socket_without_a_lock_is_not_listed(runtime):
    (runtime / "hil").mkdir(mode=0o700)
    with socket.socket(socket.AF_UNIX) as stranger:
        stranger.bind(str(runtime / "hil" / "arm.sock"))
        assert channel.names() == []
