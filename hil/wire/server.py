"""A bus for other processes: the kernel, and at its ports the clients of a channel.

Timed clients are waited for: each wake-up is one grant and one yield. Observers are not: they get every frame some time
after it ended, and what they send is queued when it is read (the run is then no longer deterministic).

Between slices of virtual time the server looks after the connections. A timed client that leaves without a word ends
the session with NodeError; one that keeps the bus waiting is reported to `on_wait`, again and again.
"""

import selectors
import socket
import struct
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from hil.errors import NodeError
from hil.node import SILENT, Reaction
from hil.wire import protocol
from hil.wire.channel import Listener
from hil.wire.kernel import Arrival, Kernel, Port
from hil.wire.protocol import Closed, Connection, ProtocolError

SLICE_NS = 5_000_000
"""Virtual time between two looks at the connections."""
WAIT_S = 0.25
"""Wall time after which a waiting bus says so, and looks whether it should go on."""
OBSERVER_BYTES = 64 << 20
"""What is kept for an observer that reads too slowly; more is lost, and counted."""
FRAMES_A_MESSAGE = 4096

OnWait = Callable[[str, float], None]
"""Called with (name of the timed client, wall seconds waited)."""


class TimedClient:
    """A timed client as the kernel's participant."""

    def __init__(self, hello: dict[str, Any], connection: Connection, on_wait: OnWait) -> None:
        self.name: str = hello["name"]
        self.start_ns: int | None = hello["start_ns"]
        self.wakes_on = everything if hello["wakes_on"] is None else frozenset(hello["wakes_on"])
        self.stores = frozenset(hello["stores"])
        self.connection = connection
        self.left = False
        self._on_wait = on_wait
        seconds, rest = divmod(WAIT_S, 1.0)
        limit = struct.pack("@ll", int(seconds), int(rest * 1e6))
        connection.stream.setblocking(True)
        # Not settimeout: that polls before every receive, one more system call a wake-up.
        connection.stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, limit)

    def start(self, now_ns: int) -> Reaction:
        """Start the client's time."""
        return self._exchange(protocol.START, protocol.encode_time(now_ns))

    def wake(self, now_ns: int, stored: list[Arrival], cause: Arrival | None) -> Reaction:
        """Grant an instant."""
        return self._exchange(protocol.GRANT, protocol.encode_grant(now_ns, stored, cause))

    def _exchange(self, kind: int, body: bytes) -> Reaction:
        if self.left:
            return SILENT
        try:
            self.connection.send(kind, body)
            kind, body = self._receive()
            reaction = protocol.decode_yield(body)
        except Closed:
            raise NodeError(f"{self.name} is gone: its connection to the bus broke") from None
        except ProtocolError as error:
            raise NodeError(f"{self.name} does not keep to the protocol: {error}") from None
        if kind == protocol.LEAVE:
            self.left = True
            return reaction[0], None, reaction[2]
        if kind != protocol.YIELD:
            raise NodeError(f"{self.name} does not keep to the protocol: message {kind} where a yield was due")
        return reaction

    def _receive(self) -> tuple[int, bytes]:
        since = None
        while True:
            try:
                return self.connection.receive()
            except BlockingIOError:
                since = time.monotonic() - WAIT_S if since is None else since
                self._on_wait(self.name, time.monotonic() - since)


class _Everything(frozenset[int]):
    """The identifiers of a client that is woken by every frame."""

    def __contains__(self, _: object) -> bool:
        return True


everything: frozenset[int] = _Everything()


@dataclass
class Observer:
    """A client that is never waited for."""

    name: str
    connection: Connection
    port: Port
    frames: list[Arrival] = field(default_factory=list)
    unsent: bytearray = field(default_factory=bytearray)
    lost: int = 0

    def flush(self) -> None:
        """Hand over what the socket takes without waiting."""
        for first in range(0, len(self.frames), FRAMES_A_MESSAGE):
            frames = self.frames[first : first + FRAMES_A_MESSAGE]
            if len(self.unsent) > OBSERVER_BYTES:
                self.lost += len(frames)
            else:
                self.unsent += protocol.message(protocol.FRAMES, protocol.encode_frames(frames))
        self.frames.clear()
        try:
            with suppress(BlockingIOError):
                while self.unsent:
                    del self.unsent[: self.connection.stream.send(self.unsent[: 1 << 18])]
        except OSError as error:
            raise Closed from error


class _Bystander:
    """An observer's port: it sends, and is handed nothing by the kernel."""

    wakes_on: frozenset[int] = frozenset()
    stores: frozenset[int] = frozenset()

    def __init__(self, name: str) -> None:
        self.name = name

    def start(self, _now_ns: int) -> Reaction:
        """Do nothing."""
        return SILENT

    def wake(self, _now_ns: int, _stored: list[Arrival], _cause: Arrival | None) -> Reaction:
        """Do nothing."""
        return SILENT


class Server:
    """One channel, and the session on it: from waiting for the expected clients to the end.

    expect: names of the timed clients that time waits for, in node order. Nobody else is timed then; with none
    expected, whoever comes is, from that instant on.
    """

    def __init__(self, listener: Listener, kernel: Kernel, expect: Sequence[str], on_wait: OnWait) -> None:
        self.kernel = kernel
        self.expect = tuple(expect)
        self.on_wait = on_wait
        self.deterministic = True
        self.timed: dict[str, TimedClient] = {}
        self.observers: list[Observer] = []
        self.lost_by_departed = 0
        self._listener = listener
        self._started = False
        self._selector = selectors.DefaultSelector()
        self._selector.register(listener.socket, selectors.EVENT_READ, self._accept)
        kernel.watchers.append(self._show)

    # -- the session --

    def missing(self) -> list[str]:
        """Return the expected clients that are not there yet."""
        return [name for name in self.expect if name not in self.timed]

    def start(self) -> None:
        """Begin: those expected join the kernel in node order, and time starts where the earliest of them says."""
        clients = [self.timed[name] for name in self.expect]
        starts = [client.start_ns for client in clients if client.start_ns is not None]
        self.kernel.now_ns = min(starts, default=self.kernel.now_ns)
        for client in clients:
            self.kernel.join(client)
        for observer in self.observers:
            self.kernel.adopt(observer.port)
        self._started = True
        self.kernel.start()

    def run(self, until_ns: int) -> None:
        """Carry virtual time to until_ns, or until the kernel is stopped or every timed client has left."""
        kernel = self.kernel
        while kernel.now_ns < until_ns and not kernel.stopped and not self.deserted:
            kernel.run(min(until_ns, kernel.now_ns + SLICE_NS))
            self.poll(0.0)

    @property
    def deserted(self) -> bool:
        """Every timed client that was there has left."""
        return bool(self.timed) and all(client.left for client in self.timed.values())

    def end(self, reason: str) -> None:
        """Tell everybody that the session is over, observers after all their frames (within 5 s of wall time)."""
        deadline = time.monotonic() + 5.0
        while any(observer.frames or observer.unsent for observer in self.observers) and time.monotonic() < deadline:
            self.poll(0.01)
        timed = [client.connection for client in self.timed.values()]
        for connection in [*timed, *(observer.connection for observer in self.observers)]:
            try:
                connection.send(protocol.END, reason.encode())
            except Closed:
                continue
            finally:
                connection.close()
        self._selector.close()

    @property
    def lost_frames(self) -> int:
        """Frames that observers were too slow to take."""
        return self.lost_by_departed + sum(observer.lost for observer in self.observers)

    # -- connections --

    def poll(self, timeout_s: float) -> None:
        """Look after the connections, waiting at most timeout_s of wall time for something to do."""
        for key, _ in self._selector.select(timeout_s):
            key.data()
        for observer in list(self.observers):
            try:
                observer.flush()
            except Closed:
                self._dismiss(observer)

    def _accept(self) -> None:
        try:
            stream, _ = self._listener.socket.accept()
        except (BlockingIOError, OSError):
            return
        stream.setblocking(False)
        connection = Connection(stream)
        self._selector.register(connection, selectors.EVENT_READ, lambda: self._greet(connection))

    def _greet(self, connection: Connection) -> None:
        """Take the client's HELLO; a stranger that says anything else is shown out."""
        try:
            connection.fill()
            message = connection.next_message()
            if message is None:
                return
            self._selector.unregister(connection)
            hello = _check_hello(*message)
            self._admit(hello, connection)
        except (Closed, BlockingIOError):
            self._forget(connection)
        except ProtocolError as error:
            self._refuse(connection, str(error))

    def _admit(self, hello: dict[str, Any], connection: Connection) -> None:
        name = hello["name"]
        taken = {*self.timed, *(observer.name for observer in self.observers)}
        if name in taken:
            self._refuse(connection, f"there is a client of the name {name!r} already: give it another")
        elif hello["timed"] and self.expect and name not in self.expect:
            expected = ", ".join(self.expect)
            self._refuse(connection, f"time waits for {expected} only: join with timed=False")
        else:
            self._welcome(connection)
            if hello["timed"]:
                self._admit_timed(hello, connection)
            else:
                self._admit_observer(name, connection)

    def _admit_timed(self, hello: dict[str, Any], connection: Connection) -> None:
        client = self.timed[hello["name"]] = TimedClient(hello, connection, self.on_wait)
        if self._started:
            self.kernel.begin(self.kernel.join(client))

    def _admit_observer(self, name: str, connection: Connection) -> None:
        port = Port(_Bystander(name), 0)
        if self._started:
            self.kernel.adopt(port)
        observer = Observer(name, connection, port)
        self.observers.append(observer)
        self._selector.register(connection, selectors.EVENT_READ, lambda: self._hear(observer))

    def _welcome(self, connection: Connection) -> None:
        fidelity = "functional" if self.kernel.functional else "bits"
        welcome = {"bit_ns": self.kernel.bit_ns, "fidelity": fidelity}
        connection.send(protocol.WELCOME, protocol.encode_json(welcome))

    def _refuse(self, connection: Connection, reason: str) -> None:
        with suppress(Closed):
            connection.send(protocol.REFUSED, reason.encode())
        self._forget(connection)

    def _forget(self, connection: Connection) -> None:
        if connection.fileno() in self._selector.get_map():
            self._selector.unregister(connection)
        connection.close()

    def _dismiss(self, observer: Observer) -> None:
        self._forget(observer.connection)
        self.observers.remove(observer)
        self.lost_by_departed += observer.lost

    def _hear(self, observer: Observer) -> None:
        """Queue what an observer sends, now."""
        try:
            observer.connection.fill()
            while (message := observer.connection.next_message()) is not None:
                kind, body = message
                if kind == protocol.LEAVE:
                    raise Closed
                if kind != protocol.SEND:
                    raise ProtocolError(f"message {kind} from an observer")
                self._queue(observer, protocol.decode_frames(body))
        except BlockingIOError:
            return
        except (Closed, ProtocolError):
            self._dismiss(observer)

    def _queue(self, observer: Observer, frames: list[Arrival]) -> None:
        self.deterministic = False
        for _, identifier, data in frames:
            self.kernel.send(observer.port, identifier, data)

    def _show(self, end_ns: int, identifier: int, data: bytes, sender: str) -> None:
        """Keep a frame for every observer but the one that sent it."""
        for observer in self.observers:
            if observer.name != sender:
                observer.frames.append((end_ns, identifier, data))


def _check_hello(kind: int, body: bytes) -> dict[str, Any]:
    """Return a HELLO's values, each of its type."""
    if kind != protocol.HELLO:
        raise ProtocolError(f"message {kind} where HELLO was due")
    hello = protocol.decode_json(body)
    wanted: dict[str, Any] = {
        "name": str,
        "timed": bool,
        "start_ns": (int, type(None)),
        "wakes_on": (list, type(None)),
        "stores": list,
    }
    for key, kinds in wanted.items():
        if not isinstance(hello.get(key), kinds):
            raise ProtocolError(f"HELLO: {key} = {hello.get(key)!r} is not what it should be")
    for identifier in [*(hello["wakes_on"] or []), *hello["stores"]]:
        if not isinstance(identifier, int) or not 0 <= identifier < 1 << 32:
            raise ProtocolError(f"HELLO: identifier {identifier!r} is none")
    return hello
