"""The virtual-time kernel of one CAN bus: who wakes when, which frame goes next, when it ends.

Everything that happens is an entry of one agenda, ordered by (time, phase, node order, sequence). The phases of an
instant, in this order: a frame ends and is delivered; nodes that are due wake; what they send is queued; the bus, if it
is idle, starts the frame that wins arbitration. So all wake-ups due at t are handled before the bus starts a frame at
t, and a frame queued after a start of frame waits.

Ref: ISO 11898-1:2015, 10.4 (frames), 10.4.6 (intermission), 10.8 (arbitration); linux/can.h.
Not implemented: CAN FD, errors on the wire and their confinement, bounded transmit queues.
"""

from collections import deque
from collections.abc import Callable
from heapq import heappop, heappush
from typing import Any, Protocol

from hil.errors import NodeError
from hil.node import Client, Reaction
from hil.wire.bits import INTERMISSION_BITS, LONGEST_DATA, frame_bits
from hil.wire.identifier import STANDARD_MASK, arbitration_key, is_identifier, split_identifier

DELIVER, WAKE, QUEUE, ARBITRATE = range(4)

Arrival = tuple[int, int, bytes]
"""(end of frame in ns, identifier, data)"""

Watcher = Callable[[int, int, bytes, str], None]
"""Called with (end of frame in ns, identifier, data, sender) for every frame on the bus."""


class Participant(Client, Protocol):
    """What the kernel needs of a node, wherever it runs."""

    def start(self, now_ns: int) -> Reaction:
        """Return the reaction to the start of time."""

    def wake(self, now_ns: int, stored: list[Arrival], cause: Arrival | None) -> Reaction:
        """Hand over the frames stored since the last wake-up, then the frame that wakes (None: the timer)."""


class Port:
    """One participant as the kernel keeps it."""

    __slots__ = ("busy_until_ns", "inbox", "order", "participant", "timer_ns")

    def __init__(self, participant: Participant) -> None:
        self.participant = participant
        self.order = 0
        self.timer_ns: int | None = None
        self.busy_until_ns = -(1 << 63)
        self.inbox: deque[tuple[Arrival, bool]] = deque()

    def take(self) -> list[Arrival]:
        """Take the stored frames that lie before the next waking one."""
        inbox, stored = self.inbox, []
        while inbox and not inbox[0][1]:
            stored.append(inbox.popleft()[0])
        return stored


class Kernel:
    """One bus. Fidelity `bits`: frames take their exact time. `functional`: frames and computing take none."""

    def __init__(self, bit_ns: int, functional: bool = False, start_ns: int = 0) -> None:
        self.now_ns = start_ns
        self.bit_ns = 0 if functional else bit_ns
        self.functional = functional
        self.ports: list[Port] = []
        self.watchers: list[Watcher] = []
        self.stopped = False
        self.bits_on_wire = 0
        self.waking = ""
        self._agenda: list[tuple[int, int, int, int, int, Callable[[Any], None], Any]] = []
        self._pending: list[tuple[int, int, int, int, int, bytes]] = []
        self._sequence = 0
        self._idle = True
        self._free_from_ns = -(1 << 63)
        self._routes: dict[int, list[tuple[Port, bool]]] = {}

    def join(self, participant: Participant) -> Port:
        """Add a participant; the order of joining breaks ties."""
        port = Port(participant)
        self.adopt(port)
        return port

    def adopt(self, port: Port) -> None:
        """Add a port that was made elsewhere."""
        port.order = len(self.ports)
        self.ports.append(port)
        self._routes.clear()

    def start(self) -> None:
        """Tell every participant that time begins."""
        for port in self.ports:
            self.begin(port)

    def begin(self, port: Port) -> None:
        """Tell one participant that its time begins now."""
        self.waking = port.participant.name
        reaction = port.participant.start(self.now_ns)
        self._check_timer(port, reaction, self.now_ns)
        self._react(port, reaction)

    def run(self, until_ns: int) -> None:
        """Carry out everything due up to and at until_ns, or until stopped."""
        agenda = self._agenda
        while agenda and not self.stopped and agenda[0][0] <= until_ns:
            self.now_ns, _, _, _, _, action, argument = heappop(agenda)
            action(argument)
        if not self.stopped:
            self.now_ns = max(self.now_ns, until_ns)

    @property
    def next_ns(self) -> int | None:
        """When something is due next."""
        return self._agenda[0][0] if self._agenda else None

    def send(self, port: Port, identifier: int, data: bytes) -> None:
        """Queue a frame from outside of the kernel's own time, now."""
        self._sequence += 1
        self._at(self.now_ns, QUEUE, port, self._queue, (port, self._sequence, identifier, data))

    # -- the agenda --

    def _at(
        self,
        t_ns: int,
        phase: int,
        port: Port | None,
        action: Callable[[Any], None],
        argument: Any,
        due_ns: int | None = None,
    ) -> None:
        """Put an action on the agenda. due_ns: since when it is due, for what had to wait for a node that computed."""
        self._sequence += 1
        order = -1 if port is None else port.order
        due_ns = t_ns if due_ns is None else due_ns
        heappush(self._agenda, (t_ns, phase, order, due_ns, self._sequence, action, argument))

    # -- the nodes --

    def _react(self, port: Port, reaction: Reaction) -> None:
        busy_ns, timer_ns, sends = reaction
        now_ns = self.now_ns
        functional = self.functional
        if busy_ns < 0:
            raise NodeError(f"{self.waking}: computing for {busy_ns} ns: ask for 0 ns or more")
        if not functional:
            port.busy_until_ns = now_ns + busy_ns
        for delay_ns, identifier, data in sends:
            self._sequence += 1
            if delay_ns < 0 or len(data) > LONGEST_DATA or not is_identifier(identifier):
                raise NodeError(
                    f"{self.waking}: frame 0x{identifier:X} of {len(data)} bytes in {delay_ns} ns cannot be sent: "
                    "11 or 29 bits of identifier, 0 to 8 bytes, 0 ns or more"
                )
            if delay_ns == 0 or functional:
                self._queue((port, self._sequence, identifier, data))
            else:
                self._at(now_ns + delay_ns, QUEUE, port, self._queue, (port, self._sequence, identifier, data))
        if timer_ns != port.timer_ns:
            port.timer_ns = timer_ns
            if timer_ns is not None:
                self._at(timer_ns, WAKE, port, self._timer, (port, timer_ns))

    def _timer(self, entry: tuple[Port, int]) -> None:
        port, timer_ns = entry
        if port.timer_ns != timer_ns:
            return
        if port.busy_until_ns > self.now_ns:
            self._at(port.busy_until_ns, WAKE, port, self._timer, entry, timer_ns)
            return
        port.timer_ns = None
        self._wake(port, by_frame=False)

    def _frame_due(self, port: Port) -> None:
        if port.busy_until_ns > self.now_ns:
            end_ns = next(arrival[0] for arrival, wakes in port.inbox if wakes)
            self._at(port.busy_until_ns, WAKE, port, self._frame_due, port, end_ns)
            return
        self._wake(port, by_frame=True)

    def _wake(self, port: Port, by_frame: bool) -> None:
        self.waking = port.participant.name
        stored = port.take()
        cause = port.inbox.popleft()[0] if by_frame else None
        reaction = port.participant.wake(self.now_ns, stored, cause)
        self._check_timer(port, reaction, self.now_ns + 1)
        self._react(port, reaction)

    def _check_timer(self, port: Port, reaction: Reaction, earliest_ns: int) -> None:
        """Refuse a timer that would never move time on; one that fell due while the node computed may be kept."""
        timer_ns = reaction[1]
        if timer_ns is not None and timer_ns < earliest_ns and timer_ns != port.timer_ns:
            raise NodeError(
                f"{self.waking}: timer asked for at {timer_ns} ns, but it is already {self.now_ns} ns: "
                "ask for a later instant"
            )

    # -- the bus --

    def _queue(self, entry: tuple[Port, int, int, bytes]) -> None:
        """Let a frame enter arbitration, at the earliest when all of this instant are queued."""
        port, sequence, identifier, data = entry
        heappush(self._pending, (arbitration_key(identifier), port.order, self.now_ns, sequence, identifier, data))
        if self._idle:
            self._idle = False
            self._at(max(self.now_ns, self._free_from_ns), ARBITRATE, None, self._arbitrate, None)

    def _arbitrate(self, _: None) -> None:
        """Start the frame that wins."""
        _key, order, _queued_ns, _sequence, identifier, data = heappop(self._pending)
        end_ns = self.now_ns
        if not self.functional:
            bits = self._bits(identifier, data)
            self.bits_on_wire += bits + INTERMISSION_BITS
            end_ns += bits * self.bit_ns
        port = self.ports[order]
        self._at(end_ns, DELIVER, port, self._deliver, (port, identifier, data))

    @staticmethod
    def _bits(identifier: int, data: bytes) -> int:
        if identifier <= STANDARD_MASK:
            return frame_bits(identifier, data)
        number, extended, remote = split_identifier(identifier)
        if remote:
            return frame_bits(number, b"", extended, True, len(data))
        return frame_bits(number, data, extended)

    def _deliver(self, frame: tuple[Port, int, bytes]) -> None:
        sender, identifier, data = frame
        now_ns = self.now_ns
        for port, wakes in self._routes.get(identifier) or self._route(identifier):
            if port is not sender:
                port.inbox.append(((now_ns, identifier, data), wakes))
                if wakes:
                    self._at(now_ns, WAKE, port, self._frame_due, port)
        for watcher in self.watchers:
            watcher(now_ns, identifier, data, sender.participant.name)
        self._free_from_ns = now_ns + INTERMISSION_BITS * self.bit_ns
        if self._pending:
            self._at(self._free_from_ns, ARBITRATE, None, self._arbitrate, None)
        else:
            self._idle = True

    def _route(self, identifier: int) -> list[tuple[Port, bool]]:
        """Find who accepts an identifier, and whether it wakes them; found once, kept."""
        route = [
            (port, identifier in port.participant.wakes_on)
            for port in self.ports
            if identifier in port.participant.wakes_on or identifier in port.participant.stores
        ]
        self._routes[identifier] = route
        return route
