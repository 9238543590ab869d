"""What a client can take from a bus: neither its time, nor its memory, nor its files, nor its status page's end.

Each of these once stopped a bus, ended it, or grew without bound.
"""

import os
import resource
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from hil.errors import ChannelError, ScenarioError
from hil.wire import admission, client, door, participants, protocol
from hil.wire.agenda import FEW, QUEUE, Agenda
from hil.wire.channel import Listener
from hil.wire.fault import Babble, check_faults
from hil.wire.identifier import FD
from hil.wire.kernel import LEAVE_NS, Kernel
from hil.wire.port import LATE_FRAMES
from hil.wire.server import DEATHS, Bus, Server
from tests.hil.raw import YIELD_NOTHING, Raw, descriptors, status, wait_for

pytestmark = pytest.mark.usefixtures("bounded", "runtime")

FAR_NS = protocol.FAR_NS
FRAME = [{"identifier": 0x100, "data": ""}]


class Rig:
    """A server of this process, polled by the test, on channel `arm`."""

    def __init__(self, expect: tuple[str, ...] = (), go_on: bool = False, functional: bool = False) -> None:
        self.listener = Listener("arm")
        self.kernel = Kernel(1000, functional)
        self.waits: list[str] = []
        self.server = Server(
            [Bus(self.listener, self.kernel)], expect, lambda name, _: self.waits.append(name), None, go_on
        )

    def join(self, name: str, role: str = "observer", **options: Any) -> Raw:
        """Let a client in."""
        raw = Raw()
        raw.hello(name, role, **options)
        while not raw.readable():
            self.server.poll(0.01)
        kind, body = raw.receive()
        assert kind == protocol.WELCOME, body
        return raw

    def join_timed(self, name: str, *answers: bytes) -> Raw:
        """Let a timed client in, whose answers wait in the stream."""
        raw = Raw()
        raw.hello(name, "timed")
        raw.stream.sendall(b"".join(answers))
        while not raw.readable():
            self.server.poll(0.01)
        return raw

    def heed(self, raw: Raw) -> None:
        """Let the server read all that a client has said."""
        raw.configure(listen_only=False)
        changes = self.observer(raw).changes
        while self.observer(raw).changes == changes:
            self.server.poll(0.01)

    def observer(self, raw: Raw) -> Any:
        """Return an observer as the server keeps it."""
        return next(observer for observer in self.server.observers if observer.name == raw.name)


@pytest.fixture
def rig() -> Iterator[Callable[..., Rig]]:
    made = []

    def make(*args: Any, **kwargs: Any) -> Rig:
        made.append(Rig(*args, **kwargs))
        return made[-1]

    yield make
    for each in made:
        each.listener.close()


def yields(timer_ns: int | None = None, *sends: tuple[int, int, bytes]) -> bytes:
    """A timed client's answer as bytes."""
    return protocol.message(protocol.YIELD, protocol.encode_yield((0, timer_ns, list(sends))))


LEAVES = protocol.message(protocol.LEAVE, YIELD_NOTHING)


# -- the status page --


def test_client_cannot_cut_off_its_status_page(hil: Any) -> None:
    """A bus that writes into a page that is no longer there would die of SIGBUS."""
    bus = hil.bus("arm")
    connection, welcome = client.join("arm", "cutter", timed=False, page=True)
    pages = [
        int(n) for n in os.listdir("/proc/self/fd") if alive(n) and "hil-status" in os.readlink(f"/proc/self/fd/{n}")
    ]
    assert pages
    for page in pages:
        with pytest.raises(PermissionError):
            os.ftruncate(page, 0)
    assert status()["nodes"].keys() == {"cutter"}
    assert bus.poll() is None
    welcome["page"].close()
    connection.close()


def alive(number: str) -> bool:
    """Whether this descriptor is still open."""
    return os.path.islink(f"/proc/self/fd/{number}")


# -- time --


class Nuisance(threading.Thread):
    """A client that does something again and again, until it is stopped or shown out."""

    def __init__(self, act: Callable[[], None]) -> None:
        super().__init__(daemon=True)
        self.act, self.over = act, threading.Event()
        self.start()

    def run(self) -> None:
        """Do it."""
        with suppress(OSError, protocol.Closed):
            while not self.over.is_set():
                self.act()


def answers_while(act: Callable[[], None]) -> dict[str, Any]:
    """Return how the bus stands while somebody does this."""
    nuisance = Nuisance(act)
    try:
        return wait_for(lambda: (found := status())["waiting_for"] and found)
    finally:
        nuisance.over.set()
        nuisance.join()


def test_client_that_configures_for_ever_in_its_turn_is_waited_for_and_named(hil: Any) -> None:
    hil.bus("arm", "--go-on")
    raw = Raw.joined("busy", "timed")
    assert answers_while(lambda: raw.configure(flush=True))["waiting_for"]["name"] == "busy"


def test_client_whose_answer_comes_byte_by_byte_is_waited_for_and_named(hil: Any) -> None:
    hil.bus("arm", "--go-on")
    raw = Raw.joined("slow", "timed")
    raw.stream.sendall(struct.pack("<IB", 1 << 20, protocol.YIELD))

    def act() -> None:
        raw.stream.sendall(b"\0")
        time.sleep(0.01)

    assert answers_while(act)["waiting_for"]["name"] == "slow"


def test_client_that_answers_without_reading_is_waited_for_and_named(hil: Any) -> None:
    hil.bus("arm", "--go-on")
    raw = Raw.joined("deaf", "timed", wakes_on=[])
    answers = b"".join(yields(millisecond * 1_000_000) for millisecond in range(1_000, 20_000))
    Nuisance(lambda: raw.stream.sendall(answers))
    assert wait_for(lambda: status()["waiting_for"])["name"] == "deaf"
    raw.stream.shutdown(socket.SHUT_RDWR)
    wait_for(lambda: status()["nodes"] == {})


def test_clock_answers_though_a_client_lets_time_pass_by_single_nanoseconds(hil: Any) -> None:
    hil.bus("arm", "--go-on")
    raw = Raw.joined("tiny", "timed")

    def act() -> None:
        raw.yields(protocol.decode_time(raw.receive()[1][:8]) + 1)

    nuisance = Nuisance(act)
    one, other = (wait_for(lambda: status()["now_ns"]) for _ in range(2))
    nuisance.over.set()
    nuisance.join()
    assert other > one


def test_clock_answers_though_tasks_are_due_every_microsecond(hil: Any) -> None:
    hil.bus("arm")
    raw = Raw.joined("eager")
    for task in range(participants.TASKS):
        raw.configure(periodic={"task": task, "frames": FRAME, "period_ns": 1000})
    assert wait_for(lambda: status()["nodes"]["eager"]["lost"])


def test_session_ends_though_an_observer_sends_for_ever(hil: Any) -> None:
    hil.bus("arm", "--expect", "a")
    eager = Raw.joined("eager")
    timed = Raw.joined("a", "timed", wakes_on=[])
    assert timed.receive()[0] == protocol.START
    eager.configure(periodic={"task": 1, "frames": FRAME, "period_ns": 1_000_000})
    timed.yields(100_000_000)
    timed.receive()
    timed.say(protocol.LEAVE, YIELD_NOTHING)
    wait_for(lambda: status()["missing"] == ["a"])


def test_who_leaves_goes_though_others_let_none_of_its_frames_through(rig: Callable[..., Rig]) -> None:
    rig = rig()
    last_words = protocol.message(protocol.LEAVE, protocol.encode_yield((0, None, [(0, 0x7FF, b"")] * 10)))
    eager, _other = rig.join("eager"), rig.join("other")
    rig.server.start()
    rig.join_timed("leaves", last_words)
    eager.configure(periodic={"task": 1, "frames": FRAME, "period_ns": 10_000})
    rig.heed(eager)
    rig.server.run(LEAVE_NS + 10_000_000)
    assert "leaves" not in {port.name for port in rig.kernel.ports}


def test_babbling_where_frames_take_no_time_is_refused() -> None:
    babble = Babble(node="a", from_s=0.0)
    with pytest.raises(ScenarioError, match=r"fault 1 \(babble\): it needs fidelity 'bits'"):
        check_faults([babble], [], functional=True, fd=False)


# -- files --


def test_timed_clients_that_come_and_go_leave_no_descriptor(hil: Any) -> None:
    bus = hil.bus("arm")
    stays = Raw.joined("stays", "timed", wakes_on=[])
    stays.receive()
    stays.yields()

    def comes_and_goes(number: int) -> None:
        connection, welcome = client.join("arm", f"guest{number}", timed=True, page=True)
        assert connection.receive()[0] == protocol.START
        connection.send(protocol.LEAVE, YIELD_NOTHING)
        welcome["page"].close()
        connection.close()

    comes_and_goes(0)
    wait_for(lambda: status()["nodes"].keys() == {"stays"})
    before = descriptors(bus.pid)
    for number in range(50):
        comes_and_goes(number)
    wait_for(lambda: status()["nodes"].keys() == {"stays"})
    wait_for(lambda: descriptors(bus.pid) == before, f"{before} descriptors")


def test_bus_without_descriptors_refuses_and_goes_on(hil: Any) -> None:
    words = [sys.executable, "-m", "hil", "bus", "arm"]
    limit = lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (48, 48))  # noqa: E731
    bus = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=limit)
    hil.started.append(bus)
    wait_for(lambda: Path(os.environ["XDG_RUNTIME_DIR"], "hil", "arm.sock").exists())
    joined = []

    def fill() -> None:
        while True:
            joined.append(client.join("arm", f"guest{len(joined)}", timed=False, page=True))

    with pytest.raises(ChannelError, match=r"the bus can take nobody more: Too many open files; raise its `ulimit -n`"):
        fill()
    for connection, welcome in joined:
        connection.close()
        welcome["page"].close()
    wait_for(lambda: status()["nodes"] == {})
    bus.send_signal(signal.SIGINT)
    assert bus.communicate()[1] == ""


def test_clients_are_bounded_and_so_are_those_who_control(rig: Callable[..., Rig], monkeypatch: Any) -> None:
    monkeypatch.setattr(admission, "CLIENTS", 3)
    monkeypatch.setattr(door, "CONTROLS", 2)
    rig = rig()
    rig.server.start()
    for number in range(3):
        rig.join(f"guest{number}")
    fourth = Raw()
    fourth.hello("fourth")
    controls = [Raw() for _ in range(3)]
    for number, control in enumerate(controls):
        control.hello(f"control{number}", "control")
    while not (fourth.readable() and controls[2].readable()):
        rig.server.poll(0.01)
    assert fourth.reason() == "3 clients are there already"
    assert controls[2].reason() == "2 others control the clock: try again"


def test_who_has_waited_too_long_at_the_door_makes_room_for_who_comes(
    rig: Callable[..., Rig], monkeypatch: Any
) -> None:
    monkeypatch.setattr(door, "STRANGERS", 2)
    rig = rig()
    strangers = [Raw() for _ in range(2)]
    for _ in strangers:
        rig.server.poll(0.1)
    real = time.monotonic
    monkeypatch.setattr(door.time, "monotonic", lambda: real() + door.PATIENCE_S)
    rig.join("comes")
    assert all(stranger.reason() == "no HELLO within 5 s" for stranger in strangers)


# -- memory --


def test_entries_called_off_do_not_pile_up() -> None:
    agenda, came = Agenda(), []
    kept = agenda.at(7, QUEUE, 1, came.append, "kept")
    for number in range(10 * FEW):
        agenda.call_off(agenda.at(FAR_NS - number, QUEUE, 1, came.append, "called off"))
    assert len(agenda._entries) <= FEW + 2
    agenda.call_off(agenda.at(8, QUEUE, 1, came.append, "called off"))
    agenda.run(9)
    assert (came, kept) == (["kept"], 1)


def test_run_of_few_entries_stops_there() -> None:
    agenda, came = Agenda(), []
    for number in range(3):
        agenda.at(number, QUEUE, 1, came.append, number)
    agenda.run(10, most=2)
    assert (came, agenda.now_ns, agenda.has_due(10)) == ([0, 1], 1, True)
    agenda.run(10)
    assert (came, agenda.now_ns, agenda.has_due(10)) == ([0, 1, 2], 10, False)


def test_tasks_begun_again_and_again_do_not_pile_up(rig: Callable[..., Rig]) -> None:
    rig = rig()
    raw = rig.join("restless")
    rig.server.start()
    for _ in range(1000):
        raw.configure(periodic={"task": 1, "frames": FRAME, "period_ns": FAR_NS})
        rig.server.poll(0.0)
    rig.heed(raw)
    rig.server.run(1_000_000)
    assert len(rig.server.agenda._entries) < 10 * FEW


def test_tasks_that_have_ended_make_room_for_others(rig: Callable[..., Rig], monkeypatch: Any) -> None:
    monkeypatch.setattr(participants, "TASKS", 2)
    rig = rig()
    raw = rig.join("works")
    rig.server.start()
    for task in range(5):
        raw.configure(periodic={"task": task, "frames": FRAME, "period_ns": 1_000_000, "duration_ns": 1_000_000})
        rig.heed(raw)
        rig.server.run(rig.server.agenda.now_ns + 10_000_000)
    for task in range(3):
        raw.configure(periodic={"task": task, "frames": FRAME, "period_ns": 1_000_000})
    while rig.server.observers:
        rig.server.poll(0.01)
    assert raw.reason() == "more than 2 periodic tasks: stop some"


def test_timers_set_ever_earlier_and_frames_of_a_far_future_do_not_pile_up(rig: Callable[..., Rig]) -> None:
    rig = rig(go_on=True)
    sender = rig.join("sender")
    rig.server.start()
    far = [(FAR_NS - 1, 0x100, b"")] * 1000
    answers = [yields(FAR_NS - number, *far) for number in range(8)]
    raw = rig.join_timed("restless", *answers)
    for _ in range(7):
        sender.send((0x200, b""))
        rig.heed(sender)
        rig.server.run(rig.server.agenda.now_ns + 1_000_000)
    (port,) = (port for port in rig.kernel.ports if port.name == "restless")
    assert port.delayed == LATE_FRAMES
    assert port.controller.lost["transmit queue full"] == 8 * 1000 - LATE_FRAMES
    assert len(rig.server.agenda._entries) < LATE_FRAMES + 2 * FEW
    raw.close()
    sender.send((0x200, b""))
    rig.heed(sender)
    rig.server.run(rig.server.agenda.now_ns + 2 * LEAVE_NS)
    assert len(rig.server.agenda._entries) < 2 * FEW


def test_only_the_last_deaths_are_told(rig: Callable[..., Rig]) -> None:
    rig = rig(go_on=True)
    rig.server.start()
    stays = rig.join_timed("stays", yields())
    for number in range(DEATHS + 3):
        rig.join_timed(f"dies{number}", protocol.message(protocol.SEND, b""))
        rig.server.run(rig.server.agenda.now_ns + 1_000_000)
    assert len(rig.server.died) == DEATHS
    assert rig.server.died[-1].startswith(f"dies{DEATHS + 2} does not keep to the protocol")
    assert rig.server.timed.keys() == {"stays"}
    assert len(rig.kernel.ports) == 1
    stays.stream.close()


def test_what_is_asked_for_before_time_begins_is_bounded(rig: Callable[..., Rig]) -> None:
    rig = rig(("never",))
    raw = rig.join("early")
    body = protocol.encode_frames([(0, 0x100 | FD, bytes(64))] * 4000)
    raw.stream.setblocking(False)
    data = protocol.message(protocol.SEND, body) * 5
    while rig.server.observers:
        with suppress(BlockingIOError, BrokenPipeError):
            data = data[raw.stream.send(data) :]
        rig.server.poll(0.01)
    raw.stream.setblocking(True)
    assert raw.reason() == "more than 256 messages, or too long ones, before time begins"


# -- the end --


def test_nobody_is_let_in_while_the_session_ends(rig: Callable[..., Rig], monkeypatch: Any) -> None:
    """It would be waited for, and what it does wrong would end the bus."""
    monkeypatch.setattr("hil.wire.server.LAST_FRAMES_S", 0.1)
    rig = rig()
    slow = rig.join("slow")
    rig.server.start()
    late = Raw()
    late.hello("late", "timed")
    rig.observer(slow).frames += [(0, 0x100, bytes(8))] * 100_000
    rig.server.end("the end")
    with pytest.raises(protocol.Closed):
        late.receive()
    assert rig.waits == []
