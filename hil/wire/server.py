"""Buses for other processes: one kernel a channel, all in one virtual time, and at their ports the clients.

Timed clients are waited for: each wake-up is one grant and one yield. Observers are not: they get every frame some time
after it ended, and what they send is queued when it is read (the run is then no longer deterministic).

Between slices of virtual time the server looks after the connections. A timed client that dies ends the session with
NodeError, or is removed and counted while the others go on; one that keeps the bus waiting is reported to `on_wait`.
"""

import selectors
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

from hil import interrupts
from hil.errors import NodeError
from hil.pace import Pace
from hil.wire import control, protocol
from hil.wire.admission import objection
from hil.wire.audience import Audience
from hil.wire.channel import Listener
from hil.wire.door import Door, refuse
from hil.wire.events import show
from hil.wire.hello import Hello
from hil.wire.kernel import Kernel
from hil.wire.observer import Observer
from hil.wire.participants import Client, OnWait, TimedClient
from hil.wire.protocol import FAR_NS, Closed, Connection

SLICE_NS = 20_000_000
"""Virtual time between two looks at the connections."""
LAST_FRAMES_S = 5.0
"""Wall time that observers have at the end to take what is left for them."""
STEPS = 1000
"""Entries of the agenda between two looks at the connections, however many an instant has."""
DEATHS = 100
"""The last so many reasons are told."""
IDLE_S = 0.1
"""Wall time of one wait where nothing is due."""


class Bus(NamedTuple):
    """A channel and its bus."""

    listener: Listener
    kernel: Kernel


class Server:
    """Channels, and the session on them: from waiting for the expected clients to the end.

    expect: names of the timed clients that time waits for, in node order. Nobody else is timed then; with none
    expected, whoever comes is, from that instant on. Observers listen only where clients are expected, until they send.
    go_on: a timed client that dies is removed and counted, instead of ending the session. observers: those that a
    session before left, each with its channel.
    """

    def __init__(
        self,
        buses: Sequence[Bus],
        expect: Sequence[str],
        on_wait: OnWait,
        pace: Pace | None = None,
        go_on: bool = False,
        observers: Sequence[tuple[str, Observer]] = (),
    ) -> None:
        self.buses = {bus.listener.channel: bus.kernel for bus in buses}
        self.agenda = buses[0].kernel.agenda
        self.expect = tuple(expect)
        self.pace = pace or Pace()
        self.timed: dict[str, TimedClient] = {}
        self.died: deque[str] = deque(maxlen=DEATHS)
        self.waiting: tuple[str, float] | None = None
        self._channels: dict[str, str] = {}
        self._on_wait = on_wait
        self._go_on = go_on
        self._started = False
        self._over = False
        self._waited = False
        self._until_ns: int | None = None
        self._guests: list[tuple[str, Hello, Connection]] = []
        listeners = [bus.listener for bus in buses]
        self._door = Door(listeners, self._receive_guest, lambda command: control.obey(self, command))
        self._selector = selectors.DefaultSelector()
        self._audience = Audience(self._selector, self.kernel_of, self._observer_gone, bool(expect))
        self._selector.register(self._door, selectors.EVENT_READ, self._door.attend)
        for bus in buses:
            bus.kernel.listeners.append(show)
        for channel, observer in observers:
            observer.renew()
            self._channels[observer.name] = channel
            self._audience.seat(observer)

    # -- the session --

    @property
    def started(self) -> bool:
        """Whether time has begun."""
        return self._started

    def missing(self) -> list[str]:
        """Return the expected clients that are not there yet."""
        return [name for name in self.expect if name not in self.timed]

    def start(self) -> None:
        """Begin: those expected join their bus in node order, and time starts where the earliest of them says."""
        clients = sorted(self.timed.values(), key=lambda client: self._order(client.name))
        starts = [client.start_ns for client in clients if client.start_ns is not None]
        self.agenda.now_ns = min(starts, default=self.agenda.now_ns)
        self._started = True
        for client in [*clients, *self.observers]:
            self.kernel_of(client).adopt(client.port)
        self._audience.start()
        self._waited = bool(clients)
        for client in clients:
            client.port.begin()

    def _order(self, name: str) -> int:
        return self.expect.index(name) if name in self.expect else len(self.expect)

    def kernel_of(self, client: Client) -> Kernel:
        """Return the bus that a client is on."""
        return self.buses[self._channels[client.name]]

    def run(self, until_ns: int) -> None:
        """Carry virtual time to until_ns, or until it is stopped or every timed client has left."""
        with interrupts.held_back():
            self._run(until_ns)

    def _run(self, until_ns: int) -> None:
        agenda = self.agenda
        self._until_ns = until_ns
        while (agenda.now_ns < until_ns or agenda.has_due(until_ns)) and not agenda.stopped and not self.deserted:
            self._advance(until_ns)
            self.poll(self._patience_s(until_ns))
        self._until_ns = None
        while self._lingers and not agenda.stopped and agenda.next_ns is not None and agenda.next_ns <= until_ns:
            agenda.run(agenda.next_ns, most=1)

    def _advance(self, until_ns: int) -> None:
        """Carry time on by a slice, as far as the pace allows; where nothing will happen any more, leave it."""
        agenda = self.agenda
        due_ns = agenda.next_ns
        if due_ns is None and self.pace.unlimited and until_ns >= FAR_NS:
            return
        slice_ns = max(agenda.now_ns + SLICE_NS, until_ns if due_ns is None else due_ns)
        target_ns = min(until_ns, slice_ns, self.pace.limit_ns(agenda.now_ns))
        if target_ns >= agenda.now_ns:
            agenda.run(target_ns, STEPS)

    def _patience_s(self, until_ns: int) -> float:
        """Return how long to wait for connections before time must go on."""
        agenda = self.agenda
        if agenda.stopped or self.deserted or agenda.now_ns >= until_ns:
            return 0.0
        due_ns = until_ns if agenda.next_ns is None else min(agenda.next_ns, until_ns)
        if due_ns >= FAR_NS:
            return IDLE_S
        return min(self.pace.wait_s(agenda.now_ns, due_ns), IDLE_S)

    @property
    def deserted(self) -> bool:
        """Every timed client that was there has left."""
        return self._waited and not self.timed

    def stay_open(self) -> None:
        """Go on though every timed client has left."""
        self._waited = bool(self.timed)

    @property
    def _lingers(self) -> bool:
        """All timed clients have left, but not all have sent their last words."""
        return self.deserted and any(port.controller.leaving for bus in self.buses.values() for port in bus.ports)

    def end(self, reason: str, keep_observers: bool = False) -> list[tuple[str, Observer]]:
        """Tell everybody that the session is over, observers after all their frames; return those that are kept."""
        self._over, self._until_ns = True, None
        deadline = time.monotonic() + LAST_FRAMES_S
        while self._audience.waits and time.monotonic() < deadline:
            self.poll(0.01)
        kept, left = (self.observers, []) if keep_observers else ([], self.observers)
        for observer in left:
            observer.lost += observer.unsent
        leaving: list[Client] = [*self.timed.values(), *left]
        for client in leaving:
            with suppress(Closed):
                client.connection.send(protocol.END, reason.encode())
            client.close()
        for _, _, connection in self._guests:
            connection.close()
        self._selector.close()
        self._door.close()
        return [(self._channels[observer.name], observer) for observer in kept]

    @property
    def observers(self) -> list[Observer]:
        """The observers that are there."""
        return self._audience.observers

    @property
    def deterministic(self) -> bool:
        """Whether no observer has done anything at an instant that the machine chose."""
        return self._audience.deterministic

    @property
    def lost_frames(self) -> int:
        """Frames that observers were too slow to take."""
        return self._audience.lost_frames

    # -- connections --

    def poll(self, timeout_s: float) -> None:
        """Look after the connections, waiting at most timeout_s of wall time for something to do."""
        self._audience.show(timeout_s > 0.0)
        with interrupts.let_through():
            ready = self._selector.select(timeout_s)
        if ready and self._until_ns is not None and not self.pace.unlimited:
            self._advance(self._until_ns)  # what arrives now is stamped now
        for key, _ in ready:
            key.data()
        while self._guests and not self._over:
            self._admit(*self._guests.pop(0))
        if not self._started:
            for client in [each for each in self.timed.values() if each.connection.is_closed()]:
                self._forget(client)
        elif not self._over:
            self._bury()

    def _receive_guest(self, channel: str, hello: Hello, connection: Connection) -> None:
        self._guests.append((channel, hello, connection))

    def _admit(self, channel: str, hello: Hello, connection: Connection) -> None:
        names = self.timed.keys() | {observer.name for observer in self.observers}
        reason = objection(hello, self.buses[channel], self.expect, names, self.agenda.now_ns, self._started)
        if reason is not None:
            refuse(connection, reason)
            connection.close()
        elif hello.role == "timed":
            self._admit_timed(channel, hello, connection)
        else:
            self._admit_observer(channel, Observer(hello, connection))

    def _welcome(self, client: Client) -> bool:
        kernel = self.kernel_of(client)
        fidelity = "functional" if kernel.functional else "bits"
        welcome = {"bit_ns": kernel.bit_ns, "data_bit_ns": kernel.rates.data_bit_ns, "fidelity": fidelity}
        try:
            client.welcome(protocol.encode_json(welcome))
        except (Closed, OSError) as error:
            if isinstance(error, OSError):
                refuse(client.connection, f"the bus can take nobody more: {error.strerror}; raise its `ulimit -n`")
            del self._channels[client.name]
            client.close()
            return False
        client.publish()
        return True

    def _admit_timed(self, channel: str, hello: Hello, connection: Connection) -> None:
        client = TimedClient(hello, connection, self._wait, self._departed)
        self._channels[client.name] = channel
        if not self._welcome(client):
            return
        self.timed[client.name] = client
        if self._started:
            self._waited = True
            self.kernel_of(client).adopt(client.port)
            client.port.begin()

    def _forget(self, client: TimedClient) -> None:
        """Give its place and its name back."""
        client.close()
        del self.timed[client.name], self._channels[client.name]

    def _departed(self, client: TimedClient, reason: str | None) -> None:
        """A timed client has left, or died: that ends the session, or it is removed and counted."""
        if reason is not None and not self._go_on:
            raise NodeError(reason)
        if reason is not None:
            self.died.append(reason)
        if self.timed.get(client.name) is client:
            client.retire()
            self.kernel_of(client).retire(client.port)
            self._forget(client)

    def _bury(self) -> None:
        """Remove timed clients that died while they waited for their turn."""
        for client in list(self.timed.values()):
            if not client.left and client.connection.is_hung_up():
                client.expel(f"{client.name} is gone: its connection to the bus broke")

    def _admit_observer(self, channel: str, observer: Observer) -> None:
        self._channels[observer.name] = channel
        if self._welcome(observer):
            self._audience.seat(observer)

    def _observer_gone(self, observer: Observer) -> None:
        del self._channels[observer.name]

    # -- waiting, and the clock --

    def _wait(self, name: str, waited_s: float) -> None:
        """Say whom the bus waits for; look after the door meanwhile."""
        self.waiting = name, waited_s
        try:
            with interrupts.let_through():
                self._door.attend()
            self._on_wait(name, waited_s)
        finally:
            self.waiting = None
