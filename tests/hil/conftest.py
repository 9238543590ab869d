"""What tests of the wire share: a bound on every test, and channels of their own."""

import shutil
import signal
import tempfile
from pathlib import Path

import can
import pytest

from hil.wire.agenda import FAULT, QUEUE
from hil.wire.events import ERROR_NAMES, STATUS
from hil.wire.faults import FaultScript
from hil.wire.frame_reader import BUS_ERROR
from hil.wire.kernel import Kernel

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


# -- the wire inline, in bits --


class Everything:
    def __contains__(self, identifier):
        return True


class Listener:
    """A participant that takes every frame and sends only what its port is told to."""

    wakes_on = Everything()
    stores = ()

    def __init__(self, name, bit_ns):
        self.name, self._bit_ns = name, bit_ns
        self.arrivals = []

    def start(self, _now_ns):
        return 0, None, []

    def wake(self, _now_ns, _stored, cause):
        end_ns, identifier, data = cause
        self.arrivals.append((in_bits(end_ns, self._bit_ns), identifier, bytes(data)))
        return 0, None, []


def in_bits(time_ns, bit_ns):
    """Bits since time 0, a whole number where it is one."""
    whole, rest = divmod(time_ns, bit_ns)
    return whole + rest / bit_ns if rest else whole


class Wire:
    """A bus of named nodes; times are bit times since 0, when the first bit of the first frame begins.

    frames: (end, sender, identifier, data). errors: (when its flag begins, node, error, field).
    """

    def __init__(self, names="abc", script=(), seed=0, bit_ns=1000, data_bit_ns=None):
        self.bit_ns = bit_ns
        self.kernel = Kernel(bit_ns=bit_ns, data_bit_ns=data_bit_ns)
        self.nodes, self.ports = {}, {}
        self.frames, self.events = [], []
        for name in names:
            self.join(name)
        FaultScript(script, seed).install(self.kernel)
        self.kernel.watchers.append(self._frame)
        self.kernel.listeners.append(self._event)
        self.kernel.start()

    def __getitem__(self, name):
        return self.ports[name].controller

    def _frame(self, end_ns, identifier, data, sender):
        self.frames.append((in_bits(end_ns, self.bit_ns), sender, identifier, bytes(data)))

    def _event(self, event):
        self.events.append((in_bits(event.time_ns, self.bit_ns), event))

    # -- what happens to it --

    def join(self, name):
        self.nodes[name] = Listener(name, self.bit_ns)
        self.ports[name] = self.kernel.join(self.nodes[name])

    def set(self, name, tec=0, rec=0, **settings):
        """Give a controller error counters and settings before anything happens."""
        controller = self[name]
        confinement = controller.confinement
        confinement.tec, confinement.rec, confinement.off = tec, rec, tec > 255
        for setting, value in settings.items():
            setattr(controller, setting, value)
        controller.told = confinement.state, confinement.warning
        self.kernel.medium.assess()
        return self

    def send(self, name, identifier, data=b"", at=0):
        """Let a node queue a frame at this bit time."""
        port = self.ports[name]
        self.kernel.agenda.at(round(at * self.bit_ns), QUEUE, port.order, port.queue, (identifier, data))
        return self

    def call(self, at, action):
        """Carry something out at this bit time, before frames end."""
        self.kernel.agenda.at(round(at * self.bit_ns), FAULT, -1, lambda _: action(), None)
        return self

    def run(self, bits):
        self.kernel.run(round(bits * self.bit_ns))
        return self

    # -- what came of it --

    @property
    def errors(self):
        return [(t, e.port.name, ERROR_NAMES[e.code], e.field) for t, e in self.events if e.name == BUS_ERROR]

    @property
    def states(self):
        return [(t, e.port.name, e.code) for t, e in self.events if e.name == STATUS]

    def ends(self, sender=None):
        """When frames ended."""
        return [frame[0] for frame in self.frames if sender in (None, frame[1])]

    def got(self, name):
        """When a node got frames."""
        return [arrival[0] for arrival in self.nodes[name].arrivals]

    def counters(self, name):
        return self[name].confinement.tec, self[name].confinement.rec

    def lost(self, name):
        return dict(self[name].lost)


@pytest.fixture
def wire():
    """The class of buses that tests of error handling drive inline."""
    return Wire
