"""The clients of a channel as the bus keeps them, and those of them that time waits for."""

import os
import socket
import struct
import time
from collections.abc import Callable, Container, Sequence

from hil.errors import NodeError
from hil.node import SILENT, Reaction
from hil.wire import protocol, status_page, wakeup
from hil.wire.acceptance import NOTHING, Acceptance
from hil.wire.hello import Change, Filter, Hello, check
from hil.wire.periodic import PeriodicTask
from hil.wire.port import ALL_ERRORS, NO_ERRORS, OWN_ERRORS, Arrival, Port
from hil.wire.protocol import Closed, Connection, ProtocolError
from hil.wire.status_page import Status, StatusPage

WAIT_S = 0.25
"""Wall time after which a waiting bus says so, and looks whether it should go on."""
TASKS = 256
"""Periodic tasks of one client."""

OnWait = Callable[[str, float], None]
"""Called with (name of the timed client, wall seconds waited)."""
OnEnd = Callable[["TimedClient", str | None], None]
"""Called with a timed client that leaves, and the reason if that is an accident; may raise NodeError."""


def acceptance(filters: Sequence[Filter] | None, fd: bool) -> Acceptance:
    """Return the frames that a client takes."""
    return Acceptance([(each.can_id, each.can_mask, each.extended) for each in filters or ()], fd)


class Client:
    """What timed clients and observers have in common: a connection, a controller, perhaps a status page.

    listen_only: what it asked for; None: it has not said.
    """

    stores: Container[int] = NOTHING

    def __init__(self, hello: Hello, connection: Connection) -> None:
        self.name = hello.name
        self.hello = hello
        self.connection = connection
        self.wakes_on: Container[int] = NOTHING
        self.heard = self.changes = 0
        self.listen_only: bool | None = hello.listen_only or None
        self.tasks: dict[int, PeriodicTask] = {}
        self.port = self._new_port()
        self.page: StatusPage | None = None

    def _new_port(self) -> Port:
        """Return a port with a controller as it asked for."""
        hello, port = self.hello, self._make_port()
        port.echo = hello.own
        port.hears = {"none": NO_ERRORS, "own": OWN_ERRORS, "all": ALL_ERRORS}[hello.errors]
        controller = port.controller
        controller.depth, controller.fifo = hello.depth, hello.fifo
        controller.one_shot, controller.discards = hello.one_shot, hello.discards
        controller.listen_only = bool(self.listen_only)
        return port

    def _make_port(self) -> Port:
        raise NotImplementedError

    def set_filters(self, acceptance: Acceptance) -> None:
        """Accept these frames from now on."""
        raise NotImplementedError

    def welcome(self, body: bytes) -> None:
        """Let it in; raise Closed if it has gone."""
        if not self.hello.page:
            self.connection.send(protocol.WELCOME, body)
            return
        descriptor = status_page.make_file()
        try:
            self.page = StatusPage(descriptor)
            self.connection.send_with_file(protocol.WELCOME, body, descriptor)
        finally:
            os.close(descriptor)

    def publish(self) -> None:
        """Write what its controller has come to into its status page."""
        if self.page is not None:
            controller = self.port.controller
            confinement = controller.confinement
            tec, rec = min(confinement.tec, 0xFFFF), min(confinement.rec, 0xFFFF)
            self.page.write(Status(self.heard, self.changes, controller.queued, confinement.state, tec, rec))

    def configure(self, body: bytes) -> Change:
        """Change its controller as it asks; ProtocolError for what is no change."""
        change = check(Change, body)
        self.changes += 1
        if change.set_filters:
            self.set_filters(acceptance(change.filters, self.hello.fd))
        if change.listen_only is not None:
            self.listen_only = change.listen_only
            self.port.medium.listen_only(self.port, change.listen_only)
        if change.flush:
            self.port.medium.flush(self.port)
        self._change_tasks(change)
        self.port.medium.assess()
        return change

    def _change_tasks(self, change: Change) -> None:
        fd = self.port.medium.rates.fd
        if change.periodic is not None:
            task = change.periodic
            frames = [frame.checked(fd) for frame in task.frames]
            self._stop(task.task)
            self.tasks = {number: each for number, each in self.tasks.items() if not each.stopped}
            if len(self.tasks) >= TASKS:
                raise ProtocolError(f"more than {TASKS} periodic tasks: stop some")
            self.tasks[task.task] = PeriodicTask(self.port, frames, task.period_ns, task.duration_ns)
        if change.modify is not None and change.modify.task in self.tasks:
            self.tasks[change.modify.task].frames = [frame.checked(fd) for frame in change.modify.frames]
        if change.stop is not None:
            self._stop(change.stop)

    def _stop(self, task: int) -> None:
        if task in self.tasks:
            self.tasks.pop(task).stop()

    def retire(self) -> None:
        """Take no more part than to see its frames out."""
        for task in self.tasks.values():
            task.stop()
        self.wakes_on = self.stores = NOTHING

    def close(self) -> None:
        """Close its connection."""
        self.connection.close()
        if self.page is not None:
            self.page.close()
            self.page = None


class _Seat(Port):
    """The port of a timed client: one whose answer cannot be carried out has died, as one that breaks the protocol."""

    participant: "TimedClient"

    def _react(self, reaction: Reaction, earliest_ns: int) -> None:
        try:
            super()._react(reaction, earliest_ns)
        except NodeError as error:
            self.participant.expel(str(error))


class TimedClient(Client):
    """A timed client as the bus's participant."""

    def __init__(self, hello: Hello, connection: Connection, on_wait: OnWait, on_end: OnEnd) -> None:
        super().__init__(hello, connection)
        self.start_ns = hello.start_ns
        if hello.wakes_on is None:
            self.wakes_on = acceptance(hello.filters, hello.fd)
        else:
            self.wakes_on = frozenset(hello.wakes_on)
        self.stores = frozenset(hello.stores)
        self.left = False
        self._waited_s = 0.0
        self._on_wait = on_wait
        self._on_end = on_end
        seconds, rest = divmod(WAIT_S, 1.0)
        limit = struct.pack("@ll", int(seconds), int(rest * 1e6))
        connection.stream.setblocking(True)
        # Not settimeout: that polls before every receive, one more system call a wake-up.
        connection.stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, limit)
        connection.stream.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, limit)

    def _make_port(self) -> Port:
        return _Seat(self)

    def set_filters(self, acceptance: Acceptance) -> None:
        """Be woken by these frames from now on."""
        self.wakes_on = acceptance

    def start(self, now_ns: int) -> Reaction:
        """Start the client's time."""
        return self._exchange(protocol.message(protocol.START, protocol.encode_time(now_ns)))

    def wake(self, now_ns: int, stored: list[Arrival], cause: Arrival | None) -> Reaction:
        """Grant an instant."""
        return self._exchange(wakeup.encode_grant(now_ns, stored, cause))

    def _exchange(self, message: bytes) -> Reaction:
        """Grant, and return what it answers; one that dies in the middle of its turn answers nothing."""
        if self.left:
            return SILENT
        self._waited_s = 0.0
        if self.page is not None:
            self.publish()
        try:
            data = self.connection.exchange(message, self._unread)
            reaction = wakeup.decode_yield(data)
            if reaction is None:
                return self._answer(data)
        except Closed:
            return self._end(SILENT, f"{self.name} is gone: its connection to the bus broke")
        except ProtocolError as error:
            return self._end(SILENT, f"{self.name} does not keep to the protocol: {error}")
        self.heard += len(reaction[2])
        return reaction

    def _unread(self) -> None:
        """Tell that it does not read what it is granted."""
        self._waited_s += WAIT_S
        self._on_wait(self.name, self._waited_s)

    def _answer(self, data: bytes) -> Reaction:
        """Return its answer of which this much has come."""
        self.connection.give_back(data)
        kind, body = self._receive(0.0 if data else WAIT_S + self._waited_s)
        if kind not in (protocol.YIELD, protocol.LEAVE):
            raise ProtocolError(f"message {kind} where a yield was due")
        reaction = protocol.decode_yield(body)
        if kind == protocol.LEAVE:
            return self._end((reaction[0], None, reaction[2]), None)
        self.heard += len(reaction[2])
        return reaction

    def expel(self, reason: str) -> None:
        """Let it go in the middle of its answer."""
        self._end(SILENT, reason)

    def _end(self, last: Reaction, reason: str | None) -> Reaction:
        """Have its last words carried out, then let it go."""
        self.left = True
        self._on_end(self, reason)
        return last

    def _receive(self, waited_s: float) -> tuple[int, bytes]:
        """Return its answer; the wait, so long already, is told whatever else it sends meanwhile."""
        since_s = time.monotonic() - waited_s
        while True:
            if waited_s >= WAIT_S:
                self._on_wait(self.name, waited_s)
            try:
                message = self.connection.receive_once()
            except BlockingIOError:
                message = None
            if message is not None:
                if message[0] != protocol.CONFIGURE:
                    return message
                self.configure(message[1])
            waited_s = time.monotonic() - since_s
