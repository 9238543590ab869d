"""What tests of the wire share: a bound on every test, and channels of their own."""

import shutil
import signal
import tempfile
from pathlib import Path

import can
import pytest

BOUND_S = 30


@pytest.fixture
def bounded():
    """End a test that hangs: the alarm raises out of any blocking call what no code catches."""

    def overdue(_signal, _frame):
        pytest.fail(f"still waiting after {BOUND_S} s")

    before = signal.signal(signal.SIGALRM, overdue)
    signal.alarm(BOUND_S)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture
def runtime(monkeypatch):
    """A run-time directory of this test alone; short, since a Unix socket's path has 107 bytes at most."""
    path = Path(tempfile.mkdtemp(prefix="hil-", dir="/tmp"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(path))
    yield path
    shutil.rmtree(path)


# -- two interfaces, one class of tests --

BITRATE, DATA_BITRATE = 500_000, 2_000_000


class Backend:
    """An interface of python-can and a channel of it, on which any number of buses may be opened."""

    def __init__(self, interface, serve):
        self.interface, self._serve = interface, serve
        self.opened = []

    def open(self, kind=can.Bus, fd=False, **kwargs):
        """Open a bus with the keywords that python-can's own tests give to every interface."""
        channel = "fd" if fd else "classic"
        if self.interface == "hil":
            self._serve(channel)
        speed = {"bitrate": BITRATE, "fd": fd} | ({"data_bitrate": DATA_BITRATE} if fd else {})
        bus = kind(interface=self.interface, channel=channel, single_handle=True, **speed, **kwargs)
        self.opened.append(bus)
        return bus

    def pair(self, **kwargs):
        return self.open(**kwargs), self.open(**kwargs)


@pytest.fixture(scope="module")
def serve_once(module_hil):
    """Start a bus of this name when it is first asked for; the tests of a module share it."""
    running = set()

    def serve(channel):
        if channel not in running:
            fast = ["--data-bitrate", str(DATA_BITRATE)] if channel == "fd" else []
            module_hil.bus(channel, "--bitrate", str(BITRATE), *fast)
            running.add(channel)

    return serve


@pytest.fixture(scope="module")
def shared_runtime():
    """A short run-time directory for the buses of a module."""
    path = Path(tempfile.mkdtemp(prefix="hil-", dir="/tmp"))
    yield path
    shutil.rmtree(path)


@pytest.fixture(params=["hil", "virtual"])
def backend(request, serve_once, shared_runtime, monkeypatch):
    """`hil`, an open bus in a process of its own; and python-can's `virtual`, the yardstick."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(shared_runtime))
    backend = Backend(request.param, serve_once)
    yield backend
    for bus in backend.opened:
        bus.shutdown()


@pytest.fixture
def pair(backend):
    """Two buses on one channel."""
    return backend.pair()
