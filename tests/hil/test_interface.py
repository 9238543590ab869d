"""The wire as python-can sees it, through its entry point: virtual time in `recv` and in every timestamp."""

import asyncio
import errno
import threading
from concurrent.futures import ThreadPoolExecutor

import can
import pytest

from hil.drive import Direct
from hil.errors import NodeError
from hil.wire import control, duration, protocol
from hil.wire.bits import frame_bits
from hil.wire.channel import Listener
from hil.wire.identifier import BRS, FD
from hil.wire.interface import HilBus
from hil.wire.kernel import Kernel
from hil.wire.rates import Rates
from hil.wire.server import Bus, Server

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


class Silent:
    """Does nothing but acknowledge."""

    name, wakes_on, stores, finished = "silent", (), (), False

    def on_start(self, _now_ns):
        return 0, None, []


class Wire:
    """The channel `arm`, served by a thread: it waits for its clients, runs, shows all frames, and ends
    when told, or where a timed client would wait for more."""

    def __init__(self, expect=(), observers=0, inline=(), end_ns=END_NS, data_bit_ns=None):
        self.kernel = Kernel(BIT_NS, data_bit_ns=data_bit_ns)
        self.log = []
        self.kernel.watchers.append(lambda *frame: self.log.append(frame))
        self.inline = [self.kernel.join(Direct(node)) for node in (*inline, Silent())]
        self.listener = Listener("arm")
        self.server = Server([Bus(self.listener, self.kernel)], expect, self.on_wait)
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
                for port in self.inline:
                    port.begin()
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
    """Three frames sent one after the other enter the same arbitration, unless the queue is first-in-first-out."""
    wire = wire(("a",))
    a = join("a", True, fifo=False)
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


def test_filters_select_at_the_bus(wire, join):
    """Those given at the start, and those that are set before somebody comes for whom time waits."""
    wire = wire(observers=3, inline=[Metronome(90, (0x100, 0x101, 0x200))], end_ns=SECOND_NS)
    eye = join("eye", can_filters=[{"can_id": 0x100, "can_mask": 0x7FE, "extended": False}])
    late = join("late")
    late.set_filters([{"can_id": 0x200, "can_mask": 0x7FF}])
    join("third", can_filters=[{"can_id": 0x700, "can_mask": 0x7FF}])
    wire.end()
    received_by_bus = {name: node["received"] for name, node in control.status(wire.server)["nodes"].items()}
    assert received_by_bus == {"metronome": 0, "silent": 0, "eye": 60, "late": 30, "third": 0}
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


def test_fd_where_the_bus_is_classic_is_an_initialization_error_with_the_cure(wire, join):
    wire(observers=2)
    with pytest.raises(can.CanInitializationError, match="--data-bitrate"):
        join("eye", fd=True)


@pytest.mark.parametrize(
    ("rates", "text"),
    [
        ({"bitrate": 500_000}, "bitrate = 500000 bit/s, but the bus runs at 1000000 bit/s: give the same"),
        ({"fd": True, "bitrate": 1_000_000, "data_bitrate": 4_000_000}, "data_bitrate = 4000000 .* runs at 2000000"),
        ({"bitrate": 300_000}, "a bit lasts 3333.333 ns, which is no whole number; take 1000000"),
        ({"bitrate": 0}, "it must be above 0"),
    ],
)
def test_bit_rate_that_is_not_the_bus_s_is_an_initialization_error_with_both(wire, join, rates, text):
    wire(observers=2, data_bit_ns=500)
    with pytest.raises(can.CanInitializationError, match=text):
        join("eye", **rates)
    join("eye", fd=True, bitrate=1_000_000, data_bitrate=2_000_000)


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("own", [True, "true", False])
def test_own_messages_come_back_at_their_end_if_wanted(wire, join, own, timed):
    """As sent ones, not received; to whoever sent them alone."""
    wire = wire(("a",), observers=1)
    a, eye = join("a", True, receive_own_messages=own and timed), join("eye", receive_own_messages=own and not timed)
    (a if timed else eye).send(standard(0x123, b"own"))
    by_a = []
    while not wire.log:
        by_a.append(a.recv(timeout=0.01))
    a.shutdown()
    ((end_ns, *_),) = wire.end()
    by_a = [message for message in by_a if message is not None]
    mine, others = (by_a, received(eye)) if timed else (received(eye), by_a)
    assert [(ns(message), message.is_rx) for message in others] == [(end_ns, True)]
    assert [(ns(message), message.is_rx) for message in mine] == ([(end_ns, False)] if own else [])


@pytest.mark.parametrize("fast", [True, False])
@pytest.mark.parametrize("length", [0, 8, 12, 64])
def test_fd_frame_arrives_as_it_was_sent_when_its_bits_are_over(wire, join, fast, length):
    message = can.Message(
        arbitration_id=0x123, is_extended_id=False, is_fd=True, bitrate_switch=fast, data=bytes(range(length))
    )
    wire = wire(("a",), observers=1, end_ns=SECOND_NS, data_bit_ns=125)
    a, eye = join("a", True, fd=True), join("eye", fd=True)
    a.send(message)
    assert a.recv(timeout=0.5) is None
    a.shutdown()
    heard = eye.recv(GUARD_S)
    assert heard.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)
    identifier = 0x123 | FD | (BRS if fast else 0)
    assert ns(heard) == wire.end()[0][0] == duration.duration_ns(identifier, bytes(range(length)), Rates(BIT_NS, 125))


def test_fd_client_hears_both_kinds_and_a_classic_one_only_its_own(wire, join):
    wire = wire(("a",), observers=2, end_ns=SECOND_NS, data_bit_ns=500)
    a, modern, classic = join("a", True, fd=True), join("modern", fd=True), join("classic")
    a.send(can.Message(arbitration_id=0x100, is_extended_id=False, is_fd=True, data=bytes(16)))
    a.send(standard(0x101))
    assert a.recv(timeout=0.5) is None
    a.shutdown()
    wire.end()
    assert [message.arbitration_id for message in received(modern)] == [0x100, 0x101]
    assert [message.arbitration_id for message in received(classic)] == [0x101]
    with pytest.raises(can.CanOperationError, match="CAN FD"):
        classic.send(FD_MESSAGE)


def test_periodic_task_of_a_timed_client_is_exact_in_virtual_time(wire, join):
    """Short: tests/hil/test_periodic.py has the rest."""
    wire = wire(("a",))
    a = join("a", True)
    task = a.send_periodic(standard(0x100, b"\x01"), period=0.01)
    assert a.recv(timeout=0.025) is None
    task.modify_data(standard(0x100, b"\x02"))
    assert a.recv(timeout=0.02) is None
    task.stop()
    assert a.recv(timeout=0.05) is None
    a.shutdown()
    log = wire.end()
    lasts = {number: duration_ns(0x100, bytes([number])) for number in (1, 2)}
    assert [(end_ns - lasts[data[0]], data) for end_ns, _, data, _ in log] == [
        (number * 10_000_000, b"\x01" if number < 3 else b"\x02") for number in range(5)
    ]


def test_modifier_of_a_periodic_task_needs_wall_time(wire, join):
    wire(("a",))
    with pytest.raises(can.CanOperationError, match="use modify_data"):
        join("a", True).send_periodic(standard(0x100), 0.01, modifier_callback=print)


def test_flushed_frames_of_a_timed_client_are_not_sent(wire, join):
    wire = wire(("a",))
    a = join("a", True)
    for number in range(10):
        a.send(standard(0x100 + number))
    a.flush_tx_buffer()
    for number in range(10):
        a.send(standard(0x200 + number))
    assert a.recv(timeout=0.1) is None
    a.shutdown()
    assert [identifier for _, identifier, _, _ in wire.end()] == list(range(0x200, 0x20A))


@pytest.mark.parametrize("depth", [1, 10, 100])
def test_send_into_a_full_queue_is_an_operation_error_and_room_comes_with_time(wire, join, depth):
    wire = wire(("a",))
    a = join("a", True, queue_depth=depth)
    for _ in range(2):
        for _ in range(depth):
            a.send(standard(0x100))
        with pytest.raises(can.CanOperationError, match=f"the transmit queue of {depth} frames is full") as full:
            a.send(standard(0x000))
        assert full.value.error_code == errno.ENOBUFS
        assert a.recv(timeout=0.1) is None
    a.shutdown()
    assert len(wire.end()) == 2 * depth


def test_state_follows_the_error_counters(wire, join):
    """The other node on the bus listens only until 50 ms: nobody acknowledges."""
    wire = wire(("a",))
    wire.inline[0].controller.listen_only = True
    wire.kernel.medium.assess()
    a = join("a", True)
    assert a.state == can.BusState.ACTIVE
    a.send(standard(0x100))
    assert a.recv(timeout=0.001).is_error_frame
    while (message := a.recv(timeout=0.05)) is not None:
        assert message.is_error_frame
    assert a.state == can.BusState.PASSIVE
    a.shutdown()
    assert wire.end() == []


@pytest.mark.parametrize("how", ["option", "state"])
def test_who_listens_only_hears_and_does_not_send(wire, join, how):
    wire = wire(("a",), inline=[Metronome(1)])
    a = join("a", True, listen_only=how == "option")
    if how == "state":
        a.state = can.BusState.PASSIVE
    assert a.state == can.BusState.PASSIVE
    with pytest.raises(can.CanOperationError, match=r"state = can.BusState.ACTIVE"):
        a.send(standard(0x200))
    assert a.recv(timeout=0.01).arbitration_id == 0x100
    a.state = can.BusState.ACTIVE
    a.send(standard(0x200))
    assert a.recv(timeout=0.01) is None
    a.shutdown()
    assert [identifier for _, identifier, _, _ in wire.end()] == [0x100, 0x200]


def test_bus_cannot_be_put_into_error():
    with pytest.raises(ValueError, match="gets there by errors"):
        HilBus.state.fset(None, can.BusState.ERROR)


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
