"""The wire as python-can sees it, through its entry point: virtual time in `recv` and in every timestamp."""

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor

import can
import pytest

from hil.drive import Direct
from hil.errors import NodeError
from hil.wire import protocol
from hil.wire.bits import frame_bits
from hil.wire.channel import Listener
from hil.wire.kernel import Kernel
from hil.wire.server import Server

pytestmark = pytest.mark.usefixtures("bounded", "runtime")

BIT_NS = 1000
SECOND_NS = 1_000_000_000
END_NS = 100 * SECOND_NS
GUARD_S = 15


class Metronome:
    """Sends `count` frames with their number, one every 200 us."""

    name, wakes_on, stores, finished = "metronome", (), (), False
    period_ns = 200_000

    def __init__(self, count, identifiers=(0x100,)):
        self.count, self.identifiers, self.sent = count, identifiers, 0

    def on_start(self, now_ns):
        return 0, now_ns + self.period_ns, []

    def on_timer(self, now_ns):
        identifier = self.identifiers[self.sent % len(self.identifiers)]
        self.sent += 1
        timer_ns = now_ns + self.period_ns if self.sent < self.count else None
        return 0, timer_ns, [(0, identifier, self.sent.to_bytes(4, "big"))]


class Wire:
    """The channel `arm`, served by a thread: it waits for its clients, runs, shows all frames, and ends
    when told, or where a timed client would wait for more."""

    def __init__(self, expect=(), observers=0, inline=(), end_ns=END_NS):
        self.kernel = Kernel(BIT_NS)
        self.log = []
        self.kernel.watchers.append(lambda *frame: self.log.append(frame))
        for node in inline:
            self.kernel.join(Direct(node))
        self.listener = Listener("arm")
        self.server = Server(self.listener, self.kernel, expect, self.on_wait)
        self.observers, self.end_ns = observers, end_ns
        self.shown, self.over, self.error = threading.Event(), threading.Event(), None
        self.thread = threading.Thread(target=self.serve, daemon=True)
        self.thread.start()

    def on_wait(self, name, waited_s):
        if self.over.is_set() or waited_s > GUARD_S:
            raise NodeError(f"{name} does not answer")

    def serve(self):
        server = self.server
        try:
            while not self.over.is_set() and (server.missing() or len(server.observers) < self.observers):
                server.poll(0.02)
            if not server.missing():
                server.start()
                server.run(self.end_ns)
            while any(observer.frames or observer.unsent for observer in server.observers):
                server.poll(0.02)
            self.shown.set()
            while not self.over.is_set() and not any(not client.left for client in server.timed.values()):
                server.poll(0.02)
        except Exception as error:
            self.error = error
        finally:
            self.shown.set()
            server.end("the run is over")

    def end(self):
        """Wait for the run's last frame to be shown, then end the session; return the frames."""
        assert self.shown.wait(GUARD_S)
        return self.close()

    def close(self):
        self.over.set()
        self.thread.join(GUARD_S)
        if self.error is not None:
            error, self.error = self.error, None
            raise error
        return self.log


@pytest.fixture
def wire():
    made = []

    def make(*args, **kwargs):
        made.append(Wire(*args, **kwargs))
        return made[-1]

    yield make
    for each in made:
        each.over.set()
        each.thread.join(GUARD_S)
        each.listener.close()


@pytest.fixture
def join():
    """Open buses through python-can's own door; they are shut down behind the test."""
    made = []

    def make(name, timed=False, **kwargs):
        bus = can.Bus(interface="hil", channel="arm", name=name, timed=timed, **kwargs)
        made.append(bus)
        return bus

    yield make
    for bus in made:
        bus.shutdown()


def standard(identifier, data=b""):
    return can.Message(arbitration_id=identifier, data=data, is_extended_id=False)


def duration_ns(identifier, data=b""):
    return BIT_NS * frame_bits(identifier, data)


def ns(message):
    return round(message.timestamp * 1e9)


def received(bus):
    """All messages until the bus ends."""
    found = []
    with pytest.raises(can.CanOperationError, match="the run is over"):
        found.extend(iter(lambda: bus.recv(GUARD_S), "never"))
    return found


# -- timed clients --


def test_timed_pair_exchanges_frames_in_virtual_time(wire, join):
    """b answers 1 ms after each question of a; the answers' timestamps are exact."""
    wire = wire(("a", "b"))
    a, b = join("a", True), join("b", True)

    def answer():
        for _ in range(3):
            question = b.recv()
            assert b.recv(timeout=0.001) is None
            b.send(standard(0x200, question.data))
        b.shutdown()

    with ThreadPoolExecutor() as pool:
        answering = pool.submit(answer)
        answers = []
        for number in range(3):
            a.send(standard(0x100, bytes([number])))
            answers.append(a.recv(timeout=None))
        a.shutdown()
        answering.result(GUARD_S)
    expected, now_ns = [], 0
    for number in range(3):
        data = bytes([number])
        asked_ns = now_ns + duration_ns(0x100, data)
        now_ns = asked_ns + 1_000_000 + duration_ns(0x200, data)
        expected += [(asked_ns, 0x100, data, "a"), (now_ns, 0x200, data, "b")]
        now_ns += 3 * BIT_NS
    assert wire.end() == expected
    assert [ns(message) for message in answers] == [end_ns for end_ns, *_ in expected[1::2]]


@pytest.mark.parametrize("timeout_s", [1.0, 0.001, 1e-9, 60.0])
def test_recv_on_a_silent_bus_takes_exactly_its_timeout_of_virtual_time(wire, join, timeout_s):
    """No wall time is measured here; but a minute of waiting is less than what this test may take."""
    wire = wire(("a",))
    a = join("a", True)
    assert a.recv(timeout=timeout_s) is None
    a.send(standard(0x100))
    a.recv(timeout=0.001)
    a.shutdown()
    assert wire.end() == [(round(timeout_s * 1e9) + duration_ns(0x100), 0x100, b"", "a")]


def test_timeouts_add_up(wire, join):
    wire = wire(("a",))
    a = join("a", True)
    assert [a.recv(timeout=0.01) for _ in range(10)] == [None] * 10
    a.send(standard(0x100))
    a.recv(timeout=0.001)
    a.shutdown()
    assert wire.end()[0][0] == 100_000_000 + duration_ns(0x100)


def test_timeout_is_virtual_though_filtered_frames_come_meanwhile(wire, join):
    wire = wire(("a",), inline=[Metronome(1000)])
    a = join("a", True, can_filters=[{"can_id": 0x700, "can_mask": 0x7FF, "extended": False}])
    assert a.recv(timeout=0.01) is None
    a.send(standard(0x050))
    a.recv(timeout=0.001)
    a.shutdown()
    wire.end()
    mine = [end_ns for end_ns, *_, sender in wire.log if sender == "a"]
    # Frame 50 of the metronome is queued in the same instant and ranks lower.
    assert mine == [10_000_000 + duration_ns(0x050)]


def test_send_takes_no_time(wire, join):
    """Three frames sent one after the other enter the same arbitration."""
    wire = wire(("a",))
    a = join("a", True)
    for identifier in (0x300, 0x100, 0x200):
        a.send(standard(identifier))
    assert a.recv(timeout=0.1) is None
    a.shutdown()
    assert [identifier for _, identifier, _, _ in wire.end()] == [0x100, 0x200, 0x300]
    assert wire.log[0][0] == duration_ns(0x100)


def test_recv_without_patience_takes_no_time(wire, join):
    wire = wire(("a",))
    a = join("a", True)
    assert [a.recv(timeout=0) for _ in range(100)] == [None] * 100
    a.send(standard(0x100))
    a.recv(timeout=1e-3)
    a.shutdown()
    assert wire.end()[0][0] == duration_ns(0x100)


def test_timed_client_receives_every_frame_at_its_end(wire, join):
    wire = wire(("a",), inline=[Metronome(5)])
    a = join("a", True)
    messages = [a.recv() for _ in range(5)]
    a.shutdown()
    log = wire.end()
    assert [(ns(m), m.arbitration_id, bytes(m.data)) for m in messages] == [entry[:3] for entry in log]


def test_timed_client_that_only_sends_is_heard(wire, join):
    """It never calls recv; its frames are queued at the start, and it leaves in order."""
    wire = wire(("a", "b"))
    a, b = join("a", True), join("b", True)
    a.send(standard(0x100))
    a.shutdown()
    heard = b.recv(timeout=1.0)
    b.shutdown()
    assert wire.end() == [(duration_ns(0x100), 0x100, b"", "a")]
    assert heard.arbitration_id == 0x100


@pytest.mark.parametrize("timed", ["true", "True", "1", "yes"])
def test_timed_may_come_as_text_from_a_configuration(wire, join, timed):
    wire(("a",))
    assert join("a", timed).timed


def test_two_runs_give_the_same_log(wire, join):
    def play():
        session = wire(("a",), inline=[Metronome(50)])
        a = join("a", True)
        while (message := a.recv(timeout=0.001)) is not None:
            a.send(standard(0x200 + message.data[3], message.data))
        a.shutdown()
        log = session.end()
        session.listener.close()
        return log

    first, second = play(), play()
    assert len(first) == 100
    assert first == second


# -- frames --

MESSAGES = [
    standard(0),
    standard(0x7FF, bytes(range(8))),
    can.Message(arbitration_id=0, is_extended_id=True, data=b"\x01"),
    can.Message(arbitration_id=0x123, is_extended_id=True),
    can.Message(arbitration_id=0x1FFFFFFF, is_extended_id=True, data=bytes(8)),
    can.Message(arbitration_id=0x100, is_extended_id=False, is_remote_frame=True, dlc=0),
    can.Message(arbitration_id=0x100, is_extended_id=False, is_remote_frame=True, dlc=8),
    can.Message(arbitration_id=0x1ABCDEF0, is_extended_id=True, is_remote_frame=True, dlc=3),
]


@pytest.mark.parametrize("message", MESSAGES, ids=str)
def test_frame_arrives_as_it_was_sent(wire, join, message):
    """From a timed client to an observer, who hears it with its own timestamp, as received, on this channel."""
    wire = wire(("a",), observers=1, end_ns=SECOND_NS)
    a, eye = join("a", True), join("eye")
    a.send(message)
    assert a.recv(timeout=0.5) is None
    a.shutdown()
    heard = eye.recv(GUARD_S)
    assert heard.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)
    assert heard.is_rx
    assert heard.channel == "arm"
    assert ns(heard) == wire.end()[0][0]


@pytest.mark.parametrize("message", MESSAGES, ids=str)
def test_frame_of_an_observer_reaches_a_timed_client(wire, join, message):
    wire = wire(("a",), observers=1)
    a, b = join("a", True), join("b")
    b.send(message)
    while (heard := a.recv(timeout=0.01)) is None:
        pass
    a.shutdown()
    assert heard.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)
    assert [(end_ns, sender) for end_ns, _, _, sender in wire.end()] == [(ns(heard), "b")]
    assert not wire.server.deterministic


FD_MESSAGE = can.Message(arbitration_id=1, is_fd=True, data=bytes(12))
ERROR_MESSAGE = can.Message(arbitration_id=1, is_error_frame=True)


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize(("message", "text"), [(FD_MESSAGE, "CAN FD frame"), (ERROR_MESSAGE, "error frame")])
def test_frame_that_a_classic_bus_does_not_know_is_refused(wire, join, timed, message, text):
    wire(("a",), observers=1)
    bus = join("a" if timed else "b", timed)
    with pytest.raises(can.CanOperationError, match=text):
        bus.send(message)


# -- observers --


def test_observer_hears_every_frame_with_virtual_timestamps_then_the_end(wire, join):
    wire = wire(observers=1, inline=[Metronome(1000)], end_ns=SECOND_NS)
    eye = join("eye")
    log = wire.end()
    assert len(log) == 1000
    assert [(ns(m), m.arbitration_id, bytes(m.data)) for m in received(eye)] == [entry[:3] for entry in log]


def test_observer_by_a_notifier(wire, join):
    wire = wire(observers=1, inline=[Metronome(100)], end_ns=SECOND_NS)
    reader = can.BufferedReader()
    with can.Notifier(join("eye"), [reader], timeout=0.05):
        heard = [reader.get_message(timeout=GUARD_S) for _ in range(100)]
    assert [ns(message) for message in heard] == [end_ns for end_ns, *_ in wire.end()]


def test_observer_by_a_notifier_of_an_event_loop(wire, join):
    """All frames lie in the socket before the loop begins: some rounds later it has handed over what it ever will."""
    wire = wire(observers=1, inline=[Metronome(100)], end_ns=SECOND_NS)
    eye = join("eye")
    assert wire.shown.wait(GUARD_S)
    heard = []

    async def listen():
        notifier = can.Notifier(eye, [heard.append], timeout=0.05, loop=asyncio.get_running_loop())
        by_thread = any(isinstance(reader, threading.Thread) for reader in notifier._readers)
        for _ in range(1000):
            await asyncio.sleep(0.001 if by_thread and len(heard) < 100 else 0)
        notifier.stop()

    asyncio.run(listen())
    assert len(heard) == 100


def test_filters_of_the_base_class_select(wire, join):
    wire = wire(observers=2, inline=[Metronome(90, (0x100, 0x101, 0x200))], end_ns=SECOND_NS)
    eye = join("eye", can_filters=[{"can_id": 0x100, "can_mask": 0x7FE, "extended": False}])
    late = join("late")
    late.set_filters([{"can_id": 0x200, "can_mask": 0x7FF}])
    wire.end()
    assert [message.arbitration_id for message in received(eye)] == [0x100, 0x101] * 30
    assert [message.arbitration_id for message in received(late)] == [0x200] * 30


def test_observer_with_nothing_to_hear_is_not_held(wire, join):
    wire(observers=2)
    eye = join("eye")
    assert eye.recv(timeout=0) is None
    assert eye.recv(timeout=0.01) is None


# -- coming and going --


def test_shutdown_twice_is_once(wire, join):
    wire = wire(("a",), observers=1)
    a, eye = join("a", True), join("eye")
    assert a.recv(timeout=1e-3) is None
    for bus in (a, a, eye, eye):
        bus.shutdown()
    wire.end()


def test_bus_is_its_own_context(wire, join):
    wire = wire(("a",))
    with join("a", True) as a:
        a.recv(timeout=1e-3)
    assert wire.end() == []


@pytest.mark.parametrize("timed", [True, False])
def test_end_of_the_bus_is_an_error_with_the_reason(wire, join, timed):
    wire = wire(("a",) if timed else (), observers=0 if timed else 1, end_ns=SECOND_NS)
    bus = join("a", timed)
    if not timed:
        wire.end()
    with pytest.raises(can.CanOperationError, match="the run is over"):
        bus.recv(GUARD_S)
    bus.shutdown()


def test_channel_without_a_bus_is_an_initialization_error_with_the_cure():
    with pytest.raises(
        can.CanInitializationError, match=r"'leg': no bus is running there; start one with `hil bus leg`"
    ):
        can.Bus(interface="hil", channel="leg")


def test_impossible_channel_is_an_initialization_error():
    with pytest.raises(can.CanInitializationError, match=r"'../leg'"):
        can.Bus(interface="hil", channel="../leg")


def test_name_that_is_taken_is_an_initialization_error(wire, join):
    wire(observers=2)
    join("eye")
    with pytest.raises(can.CanInitializationError, match="'eye'"):
        join("eye")


def test_timed_client_that_nobody_expects_is_an_initialization_error(wire, join):
    wire(("a",))
    with pytest.raises(can.CanInitializationError, match="time waits for a only"):
        join("b", True)


@pytest.mark.parametrize("option", ["fd", "receive_own_messages"])
def test_option_that_is_not_supported_is_refused(wire, join, option):
    wire(observers=2)
    with pytest.raises((can.CanInitializationError, TypeError, ValueError), match=option):
        join("eye", **{option: True})


def test_client_may_come_before_the_bus(wire, join):
    with ThreadPoolExecutor() as pool:
        joining = pool.submit(join, "eye", wait_s=GUARD_S)
        session = wire(observers=1, inline=[Metronome(3)], end_ns=SECOND_NS)
        eye = joining.result(GUARD_S)
        session.end()
        assert len(received(eye)) == 3


def test_clients_without_a_name_get_different_ones(wire, join):
    wire = wire(observers=2, end_ns=SECOND_NS)
    join(None)
    join(None)
    assert wire.shown.wait(GUARD_S)
    assert len({observer.name for observer in wire.server.observers}) == 2


@pytest.mark.usefixtures("wire")
def test_running_buses_are_detected():
    assert list(can.detect_available_configs("hil")) == []
    first, second = Listener("arm"), Listener("leg")
    configs = list(can.detect_available_configs("hil"))
    assert configs == [{"interface": "hil", "channel": "arm"}, {"interface": "hil", "channel": "leg"}]
    first.close()
    second.close()


def test_bus_goes_by_its_channel(wire, join):
    wire(observers=2)
    assert str(join("eye")) == "hil channel arm"


def test_bus_that_says_nonsense_is_an_operation_error(wire, join):
    """A FRAMES message that does not decode."""
    wire = wire(observers=1, end_ns=SECOND_NS)
    eye = join("eye")
    assert wire.shown.wait(GUARD_S)
    wire.server.observers[0].connection.send(protocol.FRAMES, b"\x05\x00")
    with pytest.raises(can.CanOperationError):
        eye.recv(GUARD_S)
