"""A bus for other processes: the kernel, and at its ports the clients of a channel.

Timed clients are waited for: each wake-up is one grant and one yield. Observers are not: they get every frame some time
after it ended, and what they send is queued when it is read (the run is then no longer deterministic).

Between slices of virtual time the server looks after the connections. A timed client that leaves without a word ends
the session with NodeError; one that keeps the bus waiting is reported to `on_wait`, again and again.
"""

import selectors
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from hil.wire import protocol
from hil.wire.channel import Listener
from hil.wire.kernel import Arrival, Kernel
from hil.wire.participants import FAR_NS, Observer, OnWait, TimedClient
from hil.wire.protocol import Closed, Connection, ProtocolError

SLICE_NS = 5_000_000
"""Virtual time between two looks at the connections."""
LAST_FRAMES_S = 5.0
"""Wall time that observers have at the end to take what is left for them."""


class Server:
    """One channel, and the session on it: from waiting for the expected clients to the end.

    expect: names of the timed clients that time waits for, in node order. Nobody else is timed then; with none
    expected, whoever comes is, from that instant on. observers: those that a session before left.
    """

    def __init__(
        self,
        listener: Listener,
        kernel: Kernel,
        expect: Sequence[str],
        on_wait: OnWait,
        observers: Sequence[Observer] = (),
    ) -> None:
        self.kernel = kernel
        self.expect = tuple(expect)
        self.on_wait = on_wait
        self.deterministic = True
        self.timed: dict[str, TimedClient] = {}
        self.observers: list[Observer] = []
        self._lost_by_departed = 0
        self._listener = listener
        self._started = False
        self._selector = selectors.DefaultSelector()
        self._selector.register(listener.socket, selectors.EVENT_READ, self._accept)
        kernel.watchers.append(self._show)
        for observer in observers:
            self._admit_observer(observer.name, observer.connection)

    # -- the session --

    def missing(self) -> list[str]:
        """Return the expected clients that are not there yet."""
        return [name for name in self.expect if name not in self.timed]

    def start(self) -> None:
        """Begin: those expected join the kernel in node order, and time starts where the earliest of them says."""
        clients = sorted(self.timed.values(), key=lambda client: self._order(client.name))
        starts = [client.start_ns for client in clients if client.start_ns is not None]
        self.kernel.now_ns = min(starts, default=self.kernel.now_ns)
        for client in clients:
            self.kernel.join(client)
        self._started = True
        for observer in self.observers:
            self.kernel.adopt(observer.port)
            self._queue(observer, observer.early)
        self.kernel.start()

    def _order(self, name: str) -> int:
        return self.expect.index(name) if name in self.expect else len(self.expect)

    def run(self, until_ns: int) -> None:
        """Carry virtual time to until_ns, or until the kernel is stopped or every timed client has left."""
        kernel = self.kernel
        while kernel.now_ns < until_ns and not kernel.stopped and not self.deserted:
            kernel.run(min(until_ns, kernel.now_ns + SLICE_NS))
            self.poll(0.0)
        while self.deserted and not kernel.stopped and kernel.next_ns is not None and kernel.next_ns <= until_ns:
            kernel.run(kernel.next_ns)

    @property
    def deserted(self) -> bool:
        """Every timed client that was there has left."""
        return bool(self.timed) and all(client.left for client in self.timed.values())

    def end(self, reason: str, keep_observers: bool = False) -> list[Observer]:
        """Tell everybody that the session is over, observers after all their frames; return those that are kept."""
        deadline = time.monotonic() + LAST_FRAMES_S
        while any(observer.unsent for observer in self.observers) and time.monotonic() < deadline:
            self.poll(0.01)
        for observer in self.observers:
            observer.lost += observer.unsent
        kept = self.observers if keep_observers else []
        leaving = [client.connection for client in self.timed.values()]
        leaving += [observer.connection for observer in self.observers if observer not in kept]
        for connection in leaving:
            with suppress(Closed):
                connection.send(protocol.END, reason.encode())
            connection.close()
        self._selector.close()
        return kept

    @property
    def lost_frames(self) -> int:
        """Frames that observers were too slow to take."""
        return self._lost_by_departed + sum(observer.lost for observer in self.observers)

    # -- connections --

    def poll(self, timeout_s: float) -> None:
        """Look after the connections, waiting at most timeout_s of wall time for something to do."""
        for key, _ in self._selector.select(timeout_s):
            key.data()
        if not self._started:
            self.timed = {name: client for name, client in self.timed.items() if not client.connection.is_closed()}
        for observer in list(self.observers):
            try:
                observer.flush()
            except Closed:
                self._dismiss(observer)

    def _accept(self) -> None:
        try:
            stream, _ = self._listener.socket.accept()
        except OSError:
            return
        stream.setblocking(False)
        connection = Connection(stream)
        self._selector.register(connection, selectors.EVENT_READ, lambda: self._greet(connection))

    def _greet(self, connection: Connection) -> None:
        """Take the client's HELLO; a stranger that says anything else is shown out."""
        try:
            connection.fill()
            message = connection.next_message()
            if message is not None:
                self._selector.unregister(connection)
                self._admit(check_hello(*message), connection)
        except (Closed, BlockingIOError):
            self._forget(connection)
        except ProtocolError as error:
            self._refuse(connection, str(error))

    def _admit(self, hello: dict[str, Any], connection: Connection) -> None:
        name = hello["name"]
        taken = {*(c.name for c in self.timed.values() if not c.left), *(observer.name for observer in self.observers)}
        if name in taken:
            self._refuse(connection, f"there is a client of the name {name!r} already: give it another")
        elif hello["timed"] and self.expect and name not in self.expect:
            expected = ", ".join(self.expect)
            self._refuse(connection, f"time waits for {expected} only: join with timed=False")
        elif self._started and hello["start_ns"] is not None and hello["start_ns"] < self.kernel.now_ns:
            now_s, wanted_s = self.kernel.now_ns * 1e-9, hello["start_ns"] * 1e-9
            self._refuse(
                connection,
                f"its time begins at {wanted_s:.3f} s, but here it is {now_s:.3f} s already: "
                "a bus that waits for its clients is started with --expect",
            )
        elif not hello["timed"] and name in self.expect:
            self._refuse(connection, f"time waits for a timed client of the name {name!r}: take another")
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
        observer = Observer(name, connection)
        if self._started:
            self.kernel.adopt(observer.port)
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
        self._lost_by_departed += observer.lost

    # -- observers --

    def _hear(self, observer: Observer) -> None:
        """Take what an observer sends; one that sends nonsense is shown out."""
        try:
            observer.connection.fill()
            while (message := observer.connection.next_message()) is not None:
                kind, body = message
                if kind == protocol.LEAVE:
                    raise Closed
                if kind != protocol.SEND:
                    raise ProtocolError(f"message {kind} from an observer")
                self.deterministic = False
                self._queue(observer, protocol.decode_frames(body))
        except BlockingIOError:
            return
        except (Closed, ProtocolError):
            self._dismiss(observer)

    def _queue(self, observer: Observer, frames: list[Arrival]) -> None:
        """Queue its frames now; before the start, at the start."""
        if not self._started:
            observer.early += frames
            return
        for _, identifier, data in frames:
            self.kernel.send(observer.port, identifier, data)

    def _show(self, end_ns: int, identifier: int, data: bytes, sender: str) -> None:
        """Keep a frame for every observer but the one that sent it."""
        for observer in self.observers:
            if observer.name != sender:
                observer.frames.append((end_ns, identifier, data))


def check_hello(kind: int, body: bytes) -> dict[str, Any]:
    """Return a HELLO's values, each of its type; raise ProtocolError."""
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
    if hello["start_ns"] is not None and abs(hello["start_ns"]) > FAR_NS:
        raise ProtocolError(f"HELLO: start_ns = {hello['start_ns']} is beyond +-{FAR_NS}")
    return hello
