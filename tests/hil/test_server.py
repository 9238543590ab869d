"""The bus for other processes, with real sockets: nodes as processes, strangers, observers, and those that go wrong.

A raw client is a socket of this very process. It may say all its answers beforehand: they wait in the stream until the
bus asks, so that no second thread is needed.
"""

import os
import select
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from types import SimpleNamespace

import pytest

from hil import pace as pace_module
from hil.drive import Direct
from hil.errors import ChannelError, NodeError
from hil.pace import Pace
from hil.wire import channel, control, protocol
from hil.wire import client as client_module
from hil.wire import door as door_module
from hil.wire import observer as observer_module
from hil.wire import participants as participants_module
from hil.wire import server as server_module
from hil.wire.agenda import Agenda
from hil.wire.bits import frame_bits
from hil.wire.channel import Listener
from hil.wire.identifier import EXTENDED, FD
from hil.wire.kernel import Kernel
from hil.wire.protocol import Closed, Connection
from hil.wire.server import Bus, Server

pytestmark = pytest.mark.usefixtures("bounded", "runtime")

BIT_NS = 1000
END_NS = 40_000_000
ROUNDS = 30

NODES = """
import os, signal, sys

class Ping:
    '''Asks, and some time after the answer again; when and what hangs on all that it heard.'''
    name, wakes_on, stores = "ping", (0x200,), (0x300, 0x80000400)

    def __init__(self, trouble=""):
        self.finished, self.asked, self.heard, self.trouble = False, 0, 0, trouble

    def on_start(self, now_ns):
        return 0, now_ns + 1000, []

    def store(self, identifier, data, at_ns):
        self.heard = (self.heard * 31 + identifier + sum(data) + at_ns) & 0xFFFF

    def on_timer(self, now_ns):
        self.asked += 1
        if self.trouble and self.asked == 10:
            os.kill(os.getpid(), getattr(signal, self.trouble))
        return 20_000, None, [(20_000, 0x100, bytes([self.asked, self.heard >> 8, self.heard & 0xFF]))]

    def on_frame(self, identifier, data, now_ns):
        self.finished = self.asked == ROUNDS
        return 5000, None if self.finished else now_ns + 5000 + 777 * data[0], []

class Pong:
    '''Answers after some computing, tells what it stored, and ticks.'''
    name, wakes_on, stores, finished = "pong", (0x100,), (0x500,), False

    def on_start(self, now_ns):
        return 0, None, []

    def store(self, identifier, data, at_ns):
        raise NotImplementedError

    def on_frame(self, identifier, data, now_ns):
        return 30_000, now_ns + 40_000, [(10_000, 0x200, data[::-1]), (0, 0x300, data + data)]

    def on_timer(self, now_ns):
        return 0, None, [(0, 0x80000400, b"tick")]

def play(name, trouble):
    from hil.drive import over
    from hil.wire import client
    node = Ping(trouble) if name == "ping" else Pong()
    connection, _ = client.join("arm", name, True, 0, node.wakes_on, node.stores)
    over(connection, node)
""".replace("ROUNDS", str(ROUNDS))


def ping_and_pong():
    """Fresh nodes from the source that the processes run."""
    names = {}
    exec(NODES, names)
    return [names["Ping"](), names["Pong"]()]


def watched(functional=False):
    kernel = Kernel(BIT_NS, functional)
    log = []
    kernel.watchers.append(lambda *frame: log.append(frame))
    return kernel, log


def inline_log(functional=False):
    kernel, log = watched(functional)
    for node in ping_and_pong():
        kernel.join(Direct(node))
    kernel.start()
    kernel.run(END_NS)
    return log


class Chatter:
    """A node in the bus's own process that sends `count` frames, one a `period_ns`."""

    name, wakes_on, stores, finished = "chatter", (), (), False

    def __init__(self, count, period_ns=200_000):
        self.count, self.period_ns, self.sent = count, period_ns, 0

    def on_start(self, now_ns):
        return 0, now_ns + self.period_ns, []

    def on_timer(self, now_ns):
        self.sent += 1
        return (
            0,
            now_ns + self.period_ns if self.sent < self.count else None,
            [(0, 0x100, self.sent.to_bytes(4, "big"))],
        )

    def report(self):
        return {}


class Silent:
    """A node in the bus's own process that does nothing but acknowledge."""

    name, wakes_on, stores, finished = "silent", (), (), False

    def on_start(self, _now_ns):
        return 0, None, []


class Bench:
    """A server on the channel `arm`, and what surrounds it; one node in the bus's own process at least."""

    def __init__(self, expect=(), functional=False, inline=(), **options):
        self.kernel, self.log = watched(functional)
        self.listener = Listener("arm")
        self.waits = []
        self.server = Server([Bus(self.listener, self.kernel)], expect, self.on_wait, **options)
        self.processes = {}
        self.clients = []
        self.inline = [self.kernel.join(Direct(node)) for node in (*inline, Silent())]

    def on_wait(self, name, _waited_s):
        """Continue whom the bus waits for, in case it is stopped; the signal does nothing to one that runs."""
        self.waits.append(name)
        if name not in self.processes:
            pytest.fail(f"the bus waits for {name}, which has said all that it has to say")
        os.kill(self.processes[name].pid, signal.SIGCONT)

    def spawn(self, name, trouble=""):
        self.processes[name] = subprocess.Popen([sys.executable, "-c", f"{NODES}\nplay({name!r}, {trouble!r})"])

    def gather(self):
        while self.server.missing():
            self.server.poll(0.1)

    def start(self):
        self.server.start()
        for port in self.inline:
            port.begin()

    def play(self):
        self.gather()
        self.start()
        self.server.run(END_NS)
        self.server.end("the run is over")
        return [process.wait() for process in self.processes.values()]

    def connect(self):
        client = Connection(channel.connect("arm"))
        self.clients.append(client)
        return client

    def introduce(self, name, timed=False, *answers, **values):
        """Send a HELLO, and behind it the answers of a timed client; return (client, the bus's kind, body)."""
        client = self.connect()
        hello = {"name": name, "role": "timed" if timed else "observer"} | ({"wakes_on": []} if timed else {}) | values
        client.stream.sendall(
            protocol.message(protocol.HELLO, protocol.encode_json(hello))
            + b"".join(protocol.message(kind, protocol.encode_yield(reaction)) for kind, reaction in answers)
        )
        return client, *self.answer(client)

    def answer(self, client):
        while not readable(client):
            self.server.poll(0.1)
        return client.receive()

    def close(self):
        for process in self.processes.values():
            process.kill()
            process.wait()
        for client in self.clients:
            client.close()
        self.listener.close()


def readable(client):
    return bool(select.select([client], [], [], 0)[0])


def messages(client):
    """All that the bus said until it closed the connection."""
    found = []
    try:
        while True:
            found.append(client.receive())
    except Closed:
        return found


def frames_in(messages):
    return [frame for kind, body in messages if kind == protocol.FRAMES for frame in protocol.decode_frames(body)]


@pytest.fixture
def bench():
    made = []

    def make(*args, **kwargs):
        made.append(Bench(*args, **kwargs))
        return made[-1]

    yield make
    for each in made:
        each.close()


# -- nodes as processes --


@pytest.mark.parametrize("functional", [False, True])
def test_processes_give_the_log_of_the_same_nodes_inline(bench, functional):
    bench = bench(("ping", "pong"), functional)
    bench.spawn("pong")
    bench.spawn("ping")
    assert bench.play() == [0, 0]
    expected = inline_log(functional)
    assert bench.log == expected
    assert len(expected) > 3 * ROUNDS
    assert bench.server.deterministic
    assert bench.server.lost_frames == 0


def test_stopped_and_continued_client_changes_nothing(bench, monkeypatch):
    monkeypatch.setattr(participants_module, "WAIT_S", 0.02)
    bench = bench(("ping", "pong"))
    bench.spawn("ping", "SIGSTOP")
    bench.spawn("pong")
    assert bench.play() == [0, 0]
    assert bench.log == inline_log()
    assert "ping" in bench.waits
    assert bench.server.deterministic


@pytest.mark.parametrize("trouble", ["SIGKILL", "SIGTERM"])
def test_client_that_is_killed_in_its_turn_ends_the_run_with_its_name(bench, trouble):
    bench = bench(("ping", "pong"))
    bench.spawn("ping", trouble)
    bench.spawn("pong")
    with pytest.raises(NodeError, match=r"^ping\b"):
        bench.play()
    bench.server.end("ping is gone")
    assert bench.processes["ping"].wait() == -getattr(signal, trouble)
    assert bench.processes["pong"].wait() == 1  # it is told that this is no good end
    expected = inline_log()
    assert 0 < len(bench.log) < len(expected)
    assert bench.log == expected[: len(bench.log)]


def test_client_that_hangs_is_given_up_by_who_waits(bench, monkeypatch):
    monkeypatch.setattr(participants_module, "WAIT_S", 0.02)
    bench = bench(("ping", "pong"))

    def give_up(name, _waited_s):
        raise NodeError(f"{name} hangs")

    bench.spawn("ping", "SIGSTOP")
    bench.spawn("pong")
    bench.gather()
    bench.server.timed["ping"]._on_wait = give_up
    with pytest.raises(NodeError, match="ping hangs"):
        bench.play()


# -- who may join --


def test_strangers_are_shown_out_and_the_others_go_on(bench):
    """Garbage, half a HELLO, nothing at all, one that is gone at once: before the start, and kept open beyond it."""
    bench = bench(("ping", "pong"))
    bench.spawn("ping")
    bench.spawn("pong")
    whole = protocol.message(protocol.HELLO, protocol.encode_json({"name": "half", "role": "observer"}))
    said = [b"GET / HTTP/1.1\r\n\r\n", b"\x00" * 5, bytes(range(256)), whole[:1], whole[:-1], b"", whole[:7]]
    strangers = [bench.connect() for _ in said]
    for stranger, words in zip(strangers, said, strict=True):
        stranger.stream.sendall(words)
    strangers[-1].close()
    assert bench.play() == [0, 0]
    assert bench.log == inline_log()
    assert bench.server.deterministic


GOOD_HELLO = {
    "name": "x",
    "role": "observer",
    "start_ns": None,
    "wakes_on": [1],
    "stores": [],
    "filters": [{"can_id": 1, "can_mask": 1, "extended": None}],
    "fd": False,
    "own": True,
    "errors": "all",
    "page": False,
    "listen_only": False,
    "bit_ns": BIT_NS,
    "data_bit_ns": None,
    "depth": 10,
    "fifo": True,
    "one_shot": False,
    "discards": False,
}


def refused_hellos():
    for key, value in [
        ("name", 1),
        ("name", None),
        ("name", ""),
        ("name", "x" * 101),
        ("role", "yes"),
        ("role", True),
        ("role", None),
        ("start_ns", "now"),
        ("start_ns", 1.5),
        ("start_ns", 1 << 63),
        ("start_ns", -(1 << 63)),
        ("wakes_on", 1),
        ("wakes_on", ["a"]),
        ("wakes_on", [-1]),
        ("wakes_on", [1 << 35]),
        ("wakes_on", [[1]]),
        ("stores", None),
        ("stores", [1.0]),
        ("stores", [True]),
        ("filters", {}),
        ("filters", [{"can_id": 1}]),
        ("filters", [{"can_id": 1, "can_mask": 1 << 32}]),
        ("filters", [{"can_id": -1, "can_mask": 1}]),
        ("filters", [{"can_id": 1, "can_mask": 1, "extended": 1}]),
        ("fd", "true"),
        ("own", 1),
        ("errors", "some"),
        ("page", None),
        ("bit_ns", 0),
        ("data_bit_ns", -1),
        ("depth", 0),
        ("depth", 4097),
        ("fifo", "no"),
        ("timed", True),
    ]:
        yield pytest.param(protocol.encode_json(GOOD_HELLO | {key: value}), key, id=f"{key}={str(value)[:30]!r}")
    for key in ("name", "role"):
        some = {k: v for k, v in GOOD_HELLO.items() if k != key}
        yield pytest.param(protocol.encode_json(some), key, id=f"no {key}")
    for key in ("wakes_on", "stores"):
        yield pytest.param(protocol.encode_json(GOOD_HELLO | {key: [1] * 4097}), key, id=f"{key} without end")
    for body in (b"", b"[]", b"{", b"\xff\xfe", b"null", b"[" * 10_000):
        yield pytest.param(body, "", id=repr(body[:10]))


@pytest.mark.parametrize(("body", "culprit"), list(refused_hellos()))
def test_hello_that_is_none_is_refused_with_a_reason(bench, body, culprit):
    bench = bench()
    client = bench.connect()
    client.send(protocol.HELLO, body)
    kind, reason = bench.answer(client)
    assert kind == protocol.REFUSED
    assert reason.decode().startswith(f"Hello: {culprit}" if culprit else "Hello: ")
    assert messages(client) == []
    assert bench.server.observers == []


@pytest.mark.parametrize("hello", [{"name": "x", "role": "observer"}, GOOD_HELLO], ids=["shortest", "all"])
@pytest.mark.parametrize("role", ["observer", "timed"])
def test_hello_with_all_or_with_what_it_must_have_is_welcome(bench, hello, role):
    bench = bench()
    client = bench.connect()
    client.send(protocol.HELLO, protocol.encode_json(hello | {"role": role}))
    assert bench.answer(client)[0] == protocol.WELCOME


@pytest.mark.parametrize("kind", [0, *range(protocol.WELCOME, protocol.STATUS + 2), 255])
def test_other_message_in_the_place_of_hello_is_refused(bench, kind):
    bench = bench()
    client = bench.connect()
    client.send(kind, b"")
    assert bench.answer(client)[0] == protocol.REFUSED


def test_first_message_is_short(bench):
    bench = bench()
    client = bench.connect()
    client.stream.sendall(b"\x01\x00\x04\x00\x01")
    kind, reason = bench.answer(client)
    assert (kind, b"262144" in reason) == (protocol.REFUSED, True)


def test_who_says_nothing_is_shown_out_after_a_while(bench, monkeypatch):
    bench = bench()
    client = bench.connect()
    client.stream.sendall(b"\x10")
    bench.server.poll(0.1)
    assert not readable(client)
    monkeypatch.setattr(door_module, "PATIENCE_S", -1.0)
    bench.server.poll(0.1)
    bench.server._door.attend()
    assert messages(client)[0][0] == protocol.REFUSED


def test_no_more_than_so_many_strangers_at_a_time(bench):
    bench = bench()
    crowd = [bench.connect() for _ in range(door_module.STRANGERS)]
    while len(bench.server._door._since) < len(crowd):
        bench.server.poll(0.1)
    late = bench.connect()
    kind, reason = bench.answer(late)
    assert (kind, b"64 others wait" in reason) == (protocol.REFUSED, True)
    crowd[0].close()
    bench.server.poll(0.1)
    assert bench.introduce("eye")[1] == protocol.WELCOME


def test_observer_may_not_take_the_name_of_a_client_that_time_waits_for(bench):
    bench = bench(("ping", "pong"))
    _, kind, reason = bench.introduce("ping", False)
    assert (kind, b"'ping'" in reason) == (protocol.REFUSED, True)
    assert bench.introduce("ping", True)[1] == protocol.WELCOME


@pytest.mark.parametrize(("first_timed", "second_timed"), [(True, True), (True, False), (False, False), (False, True)])
def test_second_client_of_a_name_is_refused_by_name(bench, first_timed, second_timed):
    bench = bench(("ping", "pong") if first_timed else ())
    first, kind, _ = bench.introduce("ping", first_timed)
    assert kind == protocol.WELCOME
    _, kind, reason = bench.introduce("ping", second_timed)
    assert kind == protocol.REFUSED
    assert b"'ping'" in reason
    assert not readable(first)


def test_timed_client_that_nobody_expects_is_refused_with_those_expected(bench):
    bench = bench(("ping", "pong"))
    _, kind, reason = bench.introduce("stranger", True)
    assert kind == protocol.REFUSED
    assert b"ping, pong" in reason
    assert bench.server.missing() == ["ping", "pong"]


def test_welcome_tells_bit_time_and_fidelity(bench):
    _, _, body = bench().introduce("a")
    assert protocol.decode_json(body) == {"bit_ns": BIT_NS, "data_bit_ns": None, "fidelity": "bits"}


# -- timed clients --


def test_time_starts_where_the_earliest_says(bench):
    bench = bench(("a", "b"))
    nothing = (protocol.LEAVE, (0, None, []))
    a, _, _ = bench.introduce("a", True, nothing, start_ns=-1000)
    b, _, _ = bench.introduce("b", True, nothing, start_ns=-5000)
    bench.start()
    assert a.receive() == b.receive() == (protocol.START, protocol.encode_time(-5000))


def test_timed_client_hears_what_it_asked_for_and_nothing_else(bench):
    bench = bench(inline=[Chatter(3)])
    bench.start()
    woken, _, _ = bench.introduce(
        "woken", True, *[(protocol.YIELD, (0, None, []))] * 3, (protocol.LEAVE, (0, None, [])), wakes_on=[0x100]
    )
    bench.introduce("deaf", True, (protocol.YIELD, (0, None, [])), wakes_on=[0x101])
    bench.server.run(END_NS)
    bench.server.end("")
    granted = [protocol.decode_grant(body) for kind, body in messages(woken) if kind == protocol.GRANT]
    assert granted == [(end_ns, [], (end_ns, 0x100, data)) for end_ns, _, data, _ in bench.log]
    assert len(granted) == 3


def test_null_wakes_on_every_frame(bench):
    bench = bench(inline=[Chatter(2)])
    bench.start()
    client, _, _ = bench.introduce("all", True, *[(protocol.YIELD, (0, None, []))] * 3, wakes_on=None)
    bench.server.run(END_NS)
    bench.server.end("")
    assert [kind for kind, _ in messages(client)] == [protocol.START, protocol.GRANT, protocol.GRANT, protocol.END]


def test_frame_is_stored_for_a_client_until_it_wakes(bench):
    bench = bench(inline=[Chatter(2)])
    bench.start()
    answers = [(protocol.YIELD, (0, 10_000_000, [])), (protocol.LEAVE, (0, None, []))]
    client, _, _ = bench.introduce("store", True, *answers, stores=[0x100])
    bench.server.run(END_NS)
    bench.server.end("")
    stored = [(end_ns, identifier, data) for end_ns, identifier, data, _ in bench.log]
    grants = [protocol.decode_grant(body) for kind, body in messages(client) if kind == protocol.GRANT]
    assert grants == [(10_000_000, stored, None)]


def test_run_returns_when_the_last_timed_client_has_left(bench):
    bench = bench(("a", "b"))
    leaving = (protocol.LEAVE, (0, None, [(0, 0x100, b"bye")]))
    bench.introduce("a", True, (protocol.YIELD, (0, 7_000_000, [])), leaving)
    bench.introduce("b", True, (protocol.YIELD, (0, 1_000_000, [])), leaving)
    bench.start()
    bench.server.run(1 << 50)
    assert bench.server.deserted
    assert 7_000_000 <= bench.kernel.now_ns < END_NS


@pytest.mark.parametrize("before_ns", [1, 0, -1])
def test_last_words_of_the_last_client_go_on_the_bus_whenever_it_leaves(bench, before_ns):
    """How the server slices virtual time is nothing that the frames may depend on."""
    bench = bench(("a",))
    leaves_ns = server_module.SLICE_NS - before_ns
    leaving = (protocol.LEAVE, (0, None, [(0, 0x100, b"bye")]))
    bench.introduce("a", True, (protocol.YIELD, (0, leaves_ns, [])), leaving)
    bench.start()
    bench.server.run(END_NS)
    assert [(identifier, data) for _, identifier, data, _ in bench.log] == [(0x100, b"bye")]


@pytest.mark.parametrize("after_start", [True, False])
def test_where_none_is_expected_who_comes_timed_is_waited_for(bench, after_start):
    bench = bench()
    if after_start:
        bench.start()
        bench.server.run(3_000_000)
    sending = (protocol.YIELD, (0, None, [(0, 0x100, b"hello")]))
    client, kind, _ = bench.introduce("late", True, sending)
    assert kind == protocol.WELCOME
    if not after_start:
        bench.start()
    bench.server.run(END_NS)
    bench.server.end("")
    now_ns = 3_000_000 if after_start else 0
    assert [(identifier, data, sender) for _, identifier, data, sender in bench.log] == [(0x100, b"hello", "late")]
    assert messages(client)[0] == (protocol.START, protocol.encode_time(now_ns))


BREACHES = {
    "another message": protocol.message(protocol.SEND, protocol.encode_yield((0, None, []))),
    "a yield cut short": protocol.message(protocol.YIELD, b"\x00" * 5),
    "bytes too many": protocol.message(protocol.YIELD, protocol.encode_yield((0, None, [])) + b"\x00"),
    "a message too long": b"\xff\xff\xff\xff\x00",
    "timer not ahead": protocol.message(protocol.YIELD, protocol.encode_yield((0, 1_000_000, []))),
    "timer in the past": protocol.message(protocol.YIELD, protocol.encode_yield((0, -1, []))),
    "nine bytes": protocol.message(protocol.YIELD, protocol.encode_yield((0, None, [(0, 0x100, bytes(9))]))),
    "a frame in the past": protocol.message(protocol.YIELD, protocol.encode_yield((0, None, [(-1, 0x100, b"")]))),
    "last words in the past": protocol.message(protocol.LEAVE, protocol.encode_yield((0, None, [(-1, 0x100, b"")]))),
    "CAN FD on a classic bus": protocol.message(protocol.YIELD, protocol.encode_yield((0, None, [(0, 1 | FD, b"")]))),
    "identifier of 12 bits": protocol.message(protocol.YIELD, protocol.encode_yield((0, None, [(0, 0x800, b"")]))),
}


# At the start the timer may be due at once.
CASES = [(b, w) for b in BREACHES for w in ("at the start", "later") if (b, w) != ("timer not ahead", "at the start")]


@pytest.mark.parametrize(("breach", "when"), CASES)
def test_client_that_breaks_the_protocol_ends_the_run_with_its_name(bench, breach, when):
    bench = bench(("a", "b"))
    bench.introduce("b", True, (protocol.YIELD, (0, None, [])))
    first = [] if when == "at the start" else [(protocol.YIELD, (0, 1_000_000, []))]
    client, _, _ = bench.introduce("a", True, *first, start_ns=1_000_000 if when == "at the start" else 0)
    client.stream.sendall(BREACHES[breach])
    with pytest.raises(NodeError, match=r"^a\b"):  # noqa: PT012 (either of the two may find it)
        bench.start()
        bench.server.run(END_NS)


def stored_by(bench, count, depth=None):
    """What a client with this much room has stored when its timer wakes it behind `count` frames; and its port."""
    granted = []
    client, _, _ = bench.introduce("store", True, (protocol.YIELD, (0, 1_000_000, [])), stores=[0x100])
    client.stream.sendall(protocol.message(protocol.YIELD, protocol.encode_yield((0, None, []))))
    port = bench.server.timed["store"].port
    port.controller.receive_depth = depth or port.controller.receive_depth
    reader = threading.Thread(target=granted.extend, args=(_grants(client),))
    reader.start()
    try:
        bench.start()
        bench.server.run(2_000_000)
    finally:
        bench.server.end("")
        reader.join()
    ((_, stored, _),) = granted
    assert len(bench.log) == count
    return stored, port


def test_node_that_stores_for_long_without_waking_is_handed_all(bench):
    """More frames than a message's counter of 16 bits holds."""
    bench = bench(("store",), functional=True, inline=[Chatter(66_000, 1)])
    stored, port = stored_by(bench, 66_000, 1 << 20)
    assert stored == [(end_ns, identifier, data) for end_ns, identifier, data, _ in bench.log]
    assert port.controller.lost == {}


def test_frames_that_find_no_room_are_lost_and_counted(bench):
    """The first 64 are kept, as in the receive FIFO of a controller; the bus goes on."""
    bench = bench(("store",), functional=True, inline=[Chatter(100, 1)])
    stored, port = stored_by(bench, 100)
    assert stored == [(end_ns, identifier, data) for end_ns, identifier, data, _ in bench.log[:64]]
    assert port.controller.lost == {"receive overrun": 36}
    assert control.status(bench.server)["nodes"]["store"]["lost"] == {"receive overrun": 36}


def _grants(client):
    """Decode grants as they come; a generator, so that the thread that consumes it does the reading."""
    for kind, body in messages(client):
        if kind == protocol.GRANT:
            yield protocol.decode_grant(body)


# -- observers --


def test_observer_sees_every_frame_with_its_virtual_time(bench):
    bench = bench(("ping", "pong"))
    observer, _, _ = bench.introduce("eye")
    bench.spawn("ping")
    bench.spawn("pong")
    assert bench.play() == [0, 0]
    heard = messages(observer)
    assert frames_in(heard) == [(end_ns, identifier, data) for end_ns, identifier, data, _ in inline_log()]
    assert heard[-1] == (protocol.END, b"the run is over")
    assert bench.server.deterministic


def test_what_an_observer_sends_is_queued_and_ends_determinism(bench):
    """It goes on the bus where time stands; the other observer hears it, its sender does not."""
    bench = bench()
    speaker, _, _ = bench.introduce("speaker")
    eye, _, _ = bench.introduce("eye")
    bench.start()
    bench.server.run(5_000_000)
    assert bench.server.deterministic
    speaker.send(protocol.SEND, protocol.encode_frames([(0, 0x123, b"one"), (99, 5 | EXTENDED, b"")]))
    while bench.server.deterministic:
        bench.server.poll(0.1)
    bench.server.run(10_000_000)
    bench.server.end("")
    sent = [(identifier, data, sender) for _, identifier, data, sender in bench.log]
    assert sorted(sent) == [(0x123, b"one", "speaker"), (5 | EXTENDED, b"", "speaker")]
    assert all(5_000_000 < end_ns < 6_000_000 for end_ns, *_ in bench.log)
    assert frames_in(messages(eye)) == [(end_ns, identifier, data) for end_ns, identifier, data, _ in bench.log]
    assert frames_in(messages(speaker)) == []


def test_bus_does_not_wait_with_frames_in_hand(bench, monkeypatch):
    """Observers once got what an idle bus had carried when its wait was over, 50 ms later."""
    bench = bench(pace=Pace(1.0))
    speaker, _, _ = bench.introduce("speaker")
    eye, _, _ = bench.introduce("eye")
    select, in_hand = bench.server._selector.select, []

    def looked(timeout_s):
        if timeout_s > 0:
            in_hand.append(sum(observer.unsent for observer in bench.server.observers))
        return select(timeout_s)

    monkeypatch.setattr(bench.server._selector, "select", looked)
    bench.start()
    speaker.send(protocol.SEND, protocol.encode_frames([(0, 0x123, b"one")]))
    bench.server.run(20_000_000)
    assert len(frames_in(messages_so_far(eye))) == 1
    assert len(in_hand) > 0
    assert not any(in_hand)


def messages_so_far(client):
    """Decode what has come, without waiting for more."""
    while readable(client):
        client.fill()
    return list(iter(client.next_message, None))


def test_frame_that_an_observer_sends_before_the_start_goes_at_the_start(bench):
    bench = bench(("a",))
    speaker, _, _ = bench.introduce("speaker")
    bench.introduce("a", True, (protocol.YIELD, (0, 100_000, [])), (protocol.YIELD, (0, None, [])), start_ns=50_000)
    speaker.send(protocol.SEND, protocol.encode_frames([(0, 0x123, b"")]))
    bench.server.poll(0.1)
    bench.start()
    assert bench.kernel.now_ns == 50_000
    bench.server.run(END_NS)
    assert [(identifier, sender) for _, identifier, _, sender in bench.log] == [(0x123, "speaker")]
    assert bench.log[0][0] > 50_000
    assert not bench.server.deterministic


NONSENSE = {
    "no message": b"\xff" * 100,
    "a yield": protocol.message(protocol.YIELD, protocol.encode_yield((0, None, []))),
    "frames cut short": protocol.message(protocol.SEND, b"\x05\x00abc"),
    "nine bytes": protocol.message(protocol.SEND, protocol.encode_frames([(0, 0x100, bytes(9))])),
    "255 bytes": protocol.message(protocol.SEND, protocol.encode_frames([(0, 0x100, bytes(255))])),
    "identifier of 12 bits": protocol.message(protocol.SEND, protocol.encode_frames([(0, 0xFFF, b"")])),
    "CAN FD on a classic bus": protocol.message(protocol.SEND, protocol.encode_frames([(0, 1 | FD, b"")])),
    "error flag of linux/can.h": protocol.message(protocol.SEND, protocol.encode_frames([(0, 0x20000001, b"")])),
}


@pytest.mark.parametrize("words", NONSENSE)
def test_observer_that_sends_nonsense_is_shown_out_and_the_others_go_on(bench, words):
    bench = bench(inline=[Chatter(20)])
    fool, _, _ = bench.introduce("fool")
    eye, _, _ = bench.introduce("eye")
    bench.start()
    fool.stream.sendall(NONSENSE[words])
    bench.server.run(END_NS)
    bench.server.end("")
    assert [sender for *_, sender in bench.log] == ["chatter"] * 20
    assert len(frames_in(messages(eye))) == 20


def test_observer_that_leaves_or_dies_is_forgotten(bench):
    bench = bench(inline=[Chatter(20)])
    polite, _, _ = bench.introduce("polite")
    rude, _, _ = bench.introduce("rude")
    bench.start()
    polite.send(protocol.LEAVE, b"")
    rude.close()
    bench.server.run(END_NS)
    assert bench.server.observers == []
    assert len(bench.log) == 20
    assert bench.introduce("rude")[1] == protocol.WELCOME


@pytest.fixture
def slow(bench, monkeypatch):
    """A bench with an observer that does not read, and little kept for it."""
    monkeypatch.setattr(observer_module, "OBSERVER_BYTES", 1000)
    bench = bench(inline=[Chatter(2000)])
    client, _, _ = bench.introduce("slow")
    bench.server.observers[0].connection.stream.setsockopt(
        participants_module.socket.SOL_SOCKET, participants_module.socket.SO_SNDBUF, 4096
    )
    return bench, client


def test_observer_that_never_reads_holds_nobody_and_what_it_misses_is_counted(slow):
    bench, client = slow
    bench.start()
    bench.server.run(1_000_000_000)
    assert len(bench.log) == 2000
    assert bench.server.lost_frames > 0
    heard = []
    while bench.server.observers[0].unsent or readable(client):
        bench.server.poll(0.0)
        while readable(client):
            client.fill()
            while (message := client.next_message()) is not None:
                heard.append(message)
    received = frames_in(heard)
    lost = bench.server.lost_frames
    assert len(received) + lost == 2000
    assert received == [frame for frame in [entry[:3] for entry in bench.log] if frame in set(received)]
    client.close()
    bench.server.poll(0.1)
    assert bench.server.observers == []
    assert bench.server.lost_frames == lost
    assert bench.server.deterministic


def test_what_an_observer_has_not_taken_by_the_end_is_counted_as_lost(slow, monkeypatch):
    bench, client = slow
    bench.start()
    bench.server.run(1_000_000_000)
    seconds = iter(range(1000))
    monkeypatch.setattr(server_module, "time", SimpleNamespace(monotonic=lambda: float(next(seconds))))
    bench.server.end("")
    assert len(frames_in(messages(client))) + bench.server.lost_frames >= 2000


# -- observers that change their controller --


def configure(**change):
    return protocol.message(protocol.CONFIGURE, protocol.encode_json(change))


FILTERS = {"set_filters": True, "filters": [{"can_id": 0x100, "can_mask": 0x7FF}]}


@pytest.mark.parametrize("when", ["before the start", "later"])
def test_observer_sees_what_its_filters_let_pass_and_leaves_the_run_deterministic(bench, when):
    bench = bench(("ping", "pong"))
    eye, _, _ = bench.introduce("eye")
    if when == "before the start":
        eye.stream.sendall(configure(**FILTERS))
        bench.server.poll(0.1)
    bench.spawn("ping")
    bench.spawn("pong")
    bench.gather()
    if when == "later":
        bench.start()
        eye.stream.sendall(configure(**FILTERS))
        bench.server.poll(0.1)
        bench.server.run(END_NS)
        bench.server.end("the run is over")
    else:
        bench.play()
    assert bench.log == inline_log()
    expected = [(end_ns, identifier, data) for end_ns, identifier, data, _ in bench.log if identifier == 0x100]
    assert frames_in(messages(eye)) == expected
    assert bench.server.deterministic


@pytest.mark.parametrize("when", ["before the start", "later"])
def test_task_of_an_observer_is_carried_out_in_virtual_time(bench, when):
    bench = bench(("a",))
    frames = [{"identifier": 0x123, "data": "01"}]
    task = configure(periodic={"task": 1, "frames": frames, "period_ns": 1_000_000, "duration_ns": 3_500_000})
    drummer, _, _ = bench.introduce("drummer")
    bench.introduce("a", True, (protocol.YIELD, (0, None, [])))
    if when == "later":
        bench.start()
    drummer.stream.sendall(task)
    bench.server.poll(0.1)
    if when == "before the start":
        bench.start()
    bench.server.run(10_000_000)
    first_ns = bench.log[0][0]
    assert [frame[1:] for frame in bench.log] == [(0x123, b"\x01", "drummer")] * 4
    assert [end_ns - first_ns for end_ns, *_ in bench.log] == [0, 1_000_000, 2_000_000, 3_000_000]


def test_frames_that_an_observer_flushes_before_the_start_are_not_sent(bench):
    bench = bench(("a",))
    speaker, _, _ = bench.introduce("speaker")
    bench.introduce("a", True, (protocol.YIELD, (0, None, [])))
    speaker.stream.sendall(
        protocol.message(protocol.SEND, protocol.encode_frames([(0, 0x123, b"")]))
        + configure(flush=True)
        + protocol.message(protocol.SEND, protocol.encode_frames([(0, 0x124, b"")]))
    )
    bench.server.poll(0.1)
    bench.start()
    bench.server.run(END_NS)
    assert [(identifier, sender) for _, identifier, _, sender in bench.log] == [(0x124, "speaker")]


def test_frames_of_an_observer_before_the_start_find_ten_places(bench):
    bench = bench(("a",))
    speaker, _, _ = bench.introduce("speaker")
    bench.introduce("a", True, (protocol.YIELD, (0, None, [])))
    frames = [(0, 0x100 + number, b"") for number in range(13)]
    speaker.send(protocol.SEND, protocol.encode_frames(frames))
    bench.server.poll(0.1)
    bench.start()
    bench.server.run(END_NS)
    assert [identifier for _, identifier, _, _ in bench.log] == list(range(0x100, 0x10A))
    assert control.status(bench.server)["nodes"]["speaker"]["lost"] == {"transmit queue full": 3}


@pytest.mark.parametrize("when", ["before the start", "later"])
@pytest.mark.parametrize("words", NONSENSE)
def test_nonsense_is_shown_out_before_the_start_as_later(bench, words, when):
    bench = bench(("a",), inline=[Chatter(20)])
    fool, _, _ = bench.introduce("fool")
    bench.introduce("a", True, (protocol.YIELD, (0, None, [])))
    if when == "later":
        bench.start()
    fool.stream.sendall(NONSENSE[words])
    bench.server.poll(0.1)
    if when == "before the start":
        bench.start()
    bench.server.run(END_NS)
    assert bench.server.observers == []
    bench.server.end("")
    assert [sender for *_, sender in bench.log] == ["chatter"] * 20
    assert messages(fool)[-1][0] == protocol.REFUSED


def test_observer_that_says_too_much_before_the_start_is_shown_out(bench):
    bench = bench(("a",))
    fool, _, _ = bench.introduce("fool")
    fool.stream.sendall(configure(flush=True) * (observer_module.EARLY_MESSAGES + 1))
    kind, reason = bench.answer(fool)
    assert (kind, b"more than 256 messages, or too long ones, before time begins" in reason) == (protocol.REFUSED, True)
    assert messages(fool) == []


def test_what_an_observer_says_together_with_hello_is_heard(bench):
    bench = bench()
    client = bench.connect()
    hello = protocol.message(protocol.HELLO, protocol.encode_json({"name": "speaker", "role": "observer"}))
    client.stream.sendall(hello + protocol.message(protocol.SEND, protocol.encode_frames([(0, 0x123, b"")])))
    assert bench.answer(client)[0] == protocol.WELCOME
    bench.start()
    bench.server.run(END_NS)
    assert [(identifier, sender) for _, identifier, _, sender in bench.log] == [(0x123, "speaker")]


def test_observer_where_clients_are_expected_listens_only_until_it_sends(bench):
    """a and the observer are alone (the third of the bench's own listens only): whether a is heard is up to it."""
    bench = bench(("a",))
    bench.inline[0].controller.listen_only = True
    eye, _, _ = bench.introduce("eye")
    sending = (protocol.YIELD, (0, 10_000_000, [(0, 0x100, b"")]))
    bench.introduce("a", True, sending, (protocol.YIELD, (0, None, [])))
    bench.start()
    bench.server.run(5_000_000)
    assert bench.log == []
    assert control.status(bench.server)["nodes"]["a"]["state"] == "error-passive"
    eye.send(protocol.SEND, protocol.encode_frames([(0, 0x123, b"")]))
    while bench.server.deterministic:
        bench.server.poll(0.1)
    bench.server.run(10_000_000)
    assert sorted(sender for *_, sender in bench.log) == ["a", "eye"]


def session(bench, listener, observers, *answers):
    """A second session on the same channel, played to its end with a client of these answers; return its server."""
    kernel, bench.log = watched()
    kernel.join(Direct(Silent()))
    bench.server = Server([Bus(listener, kernel)], ("a",), bench.on_wait, observers=observers)
    bench.introduce("a", True, *answers)
    bench.server.start()
    bench.server.run(END_NS)
    return bench.server


def test_observer_stays_with_its_filters_for_the_next_session(bench):
    """It is welcomed once; what it hears is a stream of whole messages."""
    bench = bench(("a",))
    eye, _, _ = bench.introduce("eye")
    speaker, _, _ = bench.introduce("speaker")
    eye.stream.sendall(configure(**FILTERS))
    sending = (protocol.LEAVE, (0, None, [(0, 0x100, b""), (0, 0x101, b"")]))
    bench.introduce("a", True, sending)
    bench.start()
    bench.server.run(END_NS)
    observers = bench.server.end("the run is over", keep_observers=True)
    second = session(bench, bench.listener, observers, (protocol.YIELD, (0, 5_000_000, [])), sending)
    assert second.deterministic
    assert second.lost_frames == 0
    observers = second.end("the run is over", keep_observers=True)
    speaker.send(protocol.SEND, protocol.encode_frames([(0, 0x100, b"new")]))
    third = session(bench, bench.listener, observers, (protocol.YIELD, (0, None, [])))
    assert not third.deterministic
    assert [(identifier, data, sender) for _, identifier, data, sender in bench.log] == [(0x100, b"new", "speaker")]
    third.end("enough")
    heard = messages(eye)
    assert [(identifier, data) for _, identifier, data in frames_in(heard)] == [
        (0x100, b""),
        (0x100, b""),
        (0x100, b"new"),
    ]
    assert [kind for kind, _ in heard] == [protocol.FRAMES] * 3 + [protocol.END]


def test_slow_observer_gets_the_rest_in_the_next_session(slow, monkeypatch):
    bench, client = slow
    monkeypatch.setattr(observer_module, "OBSERVER_BYTES", 1 << 20)
    bench.start()
    bench.server.run(1_000_000_000)
    seconds = iter(range(1000))
    with monkeypatch.context() as patch:
        patch.setattr(server_module, "time", SimpleNamespace(monotonic=lambda: float(next(seconds))))
        observers = bench.server.end("", keep_observers=True)
    first, heard = bench.log, []
    assert observers[0][1].unsent
    assert bench.server.lost_frames == 0
    second = session(bench, bench.listener, observers, (protocol.LEAVE, (0, None, [(0, 0x100, b"new")])))
    reader = threading.Thread(target=lambda: heard.extend(messages(client)))
    reader.start()
    second.end("enough")
    reader.join()
    assert frames_in(heard) == [frame[:3] for frame in first + bench.log]


# -- clients that leave --


def test_frame_that_waits_for_one_who_leaves_is_nobodys(bench):
    """Frames 2 and 3 end while a computes; it leaves at 2, computing for a while more."""
    bench = bench(("a", "b"), inline=[Chatter(3)])
    answers = [(protocol.YIELD, (1_000_000, None, [])), (protocol.LEAVE, (500_000, None, []))]
    bench.introduce("a", True, *answers, wakes_on=[0x100])
    bench.introduce("b", True, (protocol.YIELD, (0, 5_000_000, [])), (protocol.YIELD, (0, None, [])))
    bench.start()
    bench.server.run(END_NS)
    assert [sender for *_, sender in bench.log] == ["chatter"] * 3
    assert list(bench.server.timed) == ["b"]


@pytest.mark.parametrize("delay_ns", [0, 1, 10_000_000])
def test_last_words_may_take_a_while(bench, delay_ns):
    bench = bench(("a", "b"))
    bench.introduce("a", True, (protocol.LEAVE, (0, None, [(delay_ns, 0x100, b"bye")])))
    bench.introduce("b", True, (protocol.YIELD, (0, None, [])))
    bench.start()
    bench.server.run(END_NS)
    assert [(identifier, data, sender) for _, identifier, data, sender in bench.log] == [(0x100, b"bye", "a")]
    assert "a" not in control.status(bench.server)["nodes"]


@pytest.mark.parametrize("trouble", ["a task without end", "a frame that nobody acknowledges"])
def test_what_goes_on_without_end_keeps_no_session_from_ending(bench, trouble):
    bench = bench(("a",))
    bench.inline[0].controller.listen_only = trouble == "a frame that nobody acknowledges"
    drummer, _, _ = bench.introduce("drummer")
    bench.introduce("a", True, (protocol.YIELD, (0, 5_000_000, [])), (protocol.LEAVE, (0, None, [(0, 0x100, b"bye")])))
    bench.start()
    if trouble == "a task without end":
        task = {"task": 1, "frames": [{"identifier": 0x123, "data": ""}], "period_ns": 1_000_000}
        drummer.stream.sendall(configure(periodic=task))
    else:
        drummer.send(protocol.SEND, protocol.encode_frames([(0, 0x123, b"")] * 10))
    bench.server.poll(0.1)
    bench.server.run(protocol.FAR_NS)
    assert bench.server.deserted
    assert [data for _, identifier, data, _ in bench.log if identifier == 0x100] == [b"bye"]
    assert bench.kernel.now_ns < END_NS


def test_client_that_dies_is_removed_and_counted_where_the_others_go_on(bench):
    bench = bench(("ping", "pong", "a"), go_on=True)
    bench.spawn("ping", "SIGKILL")
    bench.spawn("pong")
    ticks = [(protocol.YIELD, (0, 1_000_000 * k, [(0, 0x600, b"")])) for k in range(1, 40)]
    bench.introduce("a", True, *ticks, (protocol.LEAVE, (0, None, [])))
    bench.gather()
    bench.start()
    bench.server.run(END_NS)
    status = control.status(bench.server)
    assert list(bench.server.died) == status["died"] == ["ping is gone: its connection to the bus broke"]
    assert sorted(status["nodes"]) == ["pong", "silent"]
    assert [sender for *_, sender in bench.log].count("a") == 39
    mine = [frame for frame in bench.log if frame[3] != "a"]
    assert len(mine) > 9
    bench.server.end("")


@pytest.mark.parametrize("breach", BREACHES)
def test_client_that_breaks_the_protocol_is_removed_where_the_others_go_on(bench, breach):
    bench = bench(("a", "b"), go_on=True, inline=[Chatter(20)])
    client, _, _ = bench.introduce("a", True, (protocol.YIELD, (0, 1_000_000, [])))
    client.stream.sendall(BREACHES[breach])
    bench.introduce("b", True, (protocol.YIELD, (0, None, [])))
    bench.start()
    bench.server.run(END_NS)
    assert [reason.partition(" ")[0].rstrip(":") for reason in bench.server.died] == ["a"]
    assert len(bench.log) == 20


# -- several channels --


def test_buses_of_one_server_share_their_time(bench):
    """The same frames at the same instants on both; nobody hears the other bus."""
    agenda = Agenda()
    listeners = [Listener("left"), Listener("right")]
    kernels = [Kernel(BIT_NS, agenda=agenda), Kernel(2 * BIT_NS, agenda=agenda)]
    buses = [Bus(listener, kernel) for listener, kernel in zip(listeners, kernels, strict=True)]
    server = Server(buses, ("a", "b", "c", "d"), bench().on_wait)
    log = []
    for name, kernel in server.buses.items():
        kernel.watchers.append(lambda *frame, name=name: log.append((name, *frame)))
    clients = {}
    for name, where in [("a", "left"), ("b", "right"), ("c", "left"), ("d", "right")]:
        clients[name] = client = Connection(channel.connect(where))
        sends = [(0, 0x100, b"")] if name in "ab" else []
        hello = {"name": name, "role": "timed", "wakes_on": None}
        client.send(protocol.HELLO, protocol.encode_json(hello))
        for _ in range(2):
            client.send(protocol.YIELD, protocol.encode_yield((0, None, sends)))
            sends = []
    while server.missing():
        server.poll(0.1)
    server.start()
    server.run(1_000_000)
    bits = frame_bits(0x100, b"")
    assert log == [("left", bits * 1000, 0x100, b"", "a"), ("right", bits * 2000, 0x100, b"", "b")]
    assert {name: node["channel"] for name, node in control.status(server)["nodes"].items()} == {
        "a": "left", "b": "right", "c": "left", "d": "right",
    }  # fmt: skip
    server.end("")
    for name in "cd":
        assert [kind for kind, _ in messages(clients[name])] == [
            protocol.WELCOME, protocol.START, protocol.GRANT, protocol.END,
        ]  # fmt: skip
    for each in (*clients.values(), *listeners):
        each.close()


# -- the clock --


def command(bench, client, **words):
    """Give the clock a command; return its answer, or the text of the refusal."""
    client.send(protocol.CONTROL, protocol.encode_json(words))
    kind, body = bench.answer(client)
    return protocol.decode_json(body) if kind == protocol.STATUS else body.decode()


@pytest.fixture
def clock(bench):
    """A bench whose chatter sends every 200 us, and a client that controls its clock."""
    bench = bench(inline=[Chatter(1000)])
    client = bench.connect()
    client.send(protocol.HELLO, protocol.encode_json({"name": "clock", "role": "control"}))
    bench.server.poll(0.1)
    bench.start()
    return bench, client


def run_for_a_while(bench):
    """Let the server do what it may; a paused one never gets to the end, so it is ended from within."""
    polls = iter(range(5))
    poll = bench.server.poll

    def poll_at_most(_timeout_s):
        poll(0.0)
        if next(polls, None) is None:
            raise TimeoutError

    bench.server.poll = poll_at_most
    with suppress(TimeoutError):
        bench.server.run(bench.kernel.now_ns + 3_000_000)
    bench.server.poll = poll


def test_paused_bus_stands_still_and_steps_exactly(clock):
    bench, client = clock
    bench.server.run(1_000_000)
    status = command(bench, client, command="pause")
    assert (status["now_ns"], status["paused"]) == (1_000_000, True)
    run_for_a_while(bench)
    assert bench.kernel.now_ns == 1_000_000
    assert command(bench, client, command="step", step_ns=123_456)["paused"]
    run_for_a_while(bench)
    assert bench.kernel.now_ns == 1_123_456
    for _ in range(2):
        command(bench, client, command="step", step_ns=1_000_000)
    run_for_a_while(bench)
    assert bench.kernel.now_ns == 3_123_456
    assert not command(bench, client, command="continue")["paused"]
    bench.server.run(8_000_000)
    assert bench.kernel.now_ns == 8_000_000
    assert [end_ns // 200_000 for end_ns, *_ in bench.log] == list(range(1, 40))


def test_pace_is_set_and_taken_back(clock):
    bench, client = clock
    assert command(bench, client, command="status")["pace"] is None
    assert command(bench, client, command="pace", pace=2.5)["pace"] == 2.5
    assert command(bench, client, command="pace")["pace"] is None


def test_status_tells_what_every_controller_counted(clock):
    bench, client = clock
    bench.server.run(1_000_000)
    status = command(bench, client, command="status")
    assert status["nodes"]["chatter"] == {
        "sent": 4, "received": 0, "repeated": 0, "lost": {}, "errors": {}, "tec": 0, "rec": 0,
        "state": "error-active", "channel": "arm",
    }  # fmt: skip
    assert status["waiting_for"] is None
    assert (status["missing"], status["died"]) == ([], [])


@pytest.mark.parametrize(
    ("words", "culprit"),
    [
        ({}, "command"),
        ({"command": "stop"}, "command"),
        ({"command": "step", "step_ns": 0}, "step_ns"),
        ({"command": "step", "step_ns": 1.5}, "step_ns"),
        ({"command": "step", "step_ns": (1 << 62) + 1}, "step_ns"),
        ({"command": "pace", "pace": 0}, "pace"),
        ({"command": "pace", "pace": -1.0}, "pace"),
        ({"command": "pace", "pace": 1e7}, "pace"),
        ({"command": "pace", "pace": "fast"}, "pace"),
        ({"command": "status", "verbose": True}, "verbose"),
    ],
)
def test_command_that_is_none_is_refused_and_changes_nothing(clock, words, culprit):
    bench, client = clock
    assert command(bench, client, **words).startswith(f"Command: {culprit}")
    assert messages(client) == []
    assert (bench.server.pace.paused, bench.server.pace.unlimited) == (False, True)


def test_other_message_of_who_controls_the_clock_is_refused(clock):
    bench, client = clock
    client.send(protocol.SEND, protocol.encode_frames([(0, 0x100, b"")]))
    assert bench.answer(client)[0] == protocol.REFUSED
    assert messages(client) == []


def test_who_controls_the_clock_is_told_whom_the_bus_waits_for(bench, monkeypatch):
    """While the bus waits, it answers: before the start of those who are missing, later of the one that is silent."""
    monkeypatch.setattr(participants_module, "WAIT_S", 0.02)
    bench, answers = bench(("slow",)), []
    client = bench.connect()
    client.send(protocol.HELLO, protocol.encode_json({"name": "clock", "role": "control"}))
    assert command(bench, client, command="status")["missing"] == ["slow"]
    bench.introduce("slow", True)

    def ask(name, waited_s):
        if waited_s > 0.05:
            answers.append(protocol.decode_json(client.receive()[1]))
            raise NodeError(f"{name} hangs")

    bench.server.timed["slow"]._on_wait = lambda name, waited_s: (
        bench.server._wait(name, waited_s),
        ask(name, waited_s),
    )
    client.send(protocol.CONTROL, protocol.encode_json({"command": "status"}))
    monkeypatch.setattr(bench.server, "_on_wait", lambda _name, _waited_s: None)
    with pytest.raises(NodeError, match="slow hangs"):
        bench.start()
    assert answers[0]["waiting_for"]["name"] == "slow"
    assert answers[0]["waiting_for"]["seconds"] >= 0.02
    assert answers[0]["missing"] == []


def test_paced_run_goes_no_further_than_it_was_told_though_somebody_speaks(bench, monkeypatch):
    """The wall clock is far ahead as an observer's frame is read: it is stamped at the end of the run, not later."""
    seconds = iter(range(1000))
    monkeypatch.setattr(pace_module, "time", SimpleNamespace(monotonic=lambda: float(next(seconds))))
    bench = bench(inline=[Chatter(1000)], pace=Pace(1.0))
    speaker, _, _ = bench.introduce("speaker")
    bench.start()
    speaker.send(protocol.SEND, protocol.encode_frames([(0, 0x123, b"")]))
    bench.server.run(1_000_000)
    assert bench.kernel.now_ns == 1_000_000
    assert len(bench.log) == 4


def test_bus_that_does_not_answer_a_command_is_an_error_after_a_while(monkeypatch):
    monkeypatch.setattr(client_module, "CONTROL_S", 0.05)
    listener = Listener("arm")
    with pytest.raises(ChannelError, match="'arm': the bus does not answer within"):
        client_module.control("arm", command="status")
    listener.close()
