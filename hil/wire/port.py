"""One participant as the bus keeps it: when it wakes, which frames wait for it, what its answer sets in motion."""

from collections import deque
from collections.abc import Container
from typing import TYPE_CHECKING, Protocol

from hil.errors import NodeError
from hil.node import Reaction
from hil.wire.agenda import QUEUE, WAKE, Agenda
from hil.wire.controller import QUEUE_FULL, Controller
from hil.wire.identifier import BRS, ESI, FD, LONGEST_CLASSIC, STANDARD_MASK, refusal

if TYPE_CHECKING:
    from hil.wire.medium import Medium

Arrival = tuple[int, int, bytes]
"""(end of frame in ns, identifier, data)"""

LONG_AGO_NS = -(1 << 63)
LATE_FRAMES = 4096
"""Frames of one participant that it has asked to be queued later."""
ERROR_FRAMES = 16
"""Error frames that find room where frames no longer do."""

IGNORES, STORES, WAKES, WATCHES = range(4)
"""What a participant does with a frame: nothing; keep it; wake; take it without ever being waited for."""

NO_ERRORS, OWN_ERRORS, ALL_ERRORS = range(3)
"""Whose error frames a participant gets."""


class Participant(Protocol):
    """What the bus needs of a node, wherever it runs."""

    @property
    def name(self) -> str:
        """How the bus knows it."""

    @property
    def wakes_on(self) -> Container[int]:
        """Identifiers whose arrival wakes it."""

    @property
    def stores(self) -> Container[int]:
        """Identifiers that are kept for its next wake-up."""

    def start(self, now_ns: int) -> Reaction:
        """Return the reaction to the start of time."""

    def wake(self, now_ns: int, stored: list[Arrival], cause: Arrival | None) -> Reaction:
        """Hand over the frames stored since the last wake-up, then the frame that wakes (None: the timer)."""


class Port:
    """A participant and its controller on a medium.

    echo: its own frames come back to it. delayed: frames that it asked for and that are not yet in the queue.
    """

    __slots__ = (
        "agenda",
        "alarm",
        "alarm_ns",
        "busy_until_ns",
        "controller",
        "delayed",
        "echo",
        "hears",
        "inbox",
        "medium",
        "order",
        "participant",
        "timer_ns",
    )

    def __init__(self, participant: Participant) -> None:
        self.participant = participant
        self.controller = Controller()
        self.order = 0
        self.echo = False
        self.hears = NO_ERRORS
        self.timer_ns: int | None = None
        self.alarm_ns: int | None = None
        self.alarm = 0
        self.busy_until_ns = LONG_AGO_NS
        self.delayed = 0
        self.inbox: deque[tuple[Arrival, bool]] = deque()
        self.agenda: Agenda
        self.medium: Medium

    @property
    def name(self) -> str:
        """How the bus knows it."""
        return self.participant.name

    def accepts(self, identifier: int) -> int:
        """Return what it does with frames of this identifier."""
        participant = self.participant
        if identifier in participant.wakes_on:
            return WAKES
        return STORES if identifier in participant.stores else IGNORES

    def begin(self) -> None:
        """Tell it that its time begins now."""
        self.agenda.acting = self.name
        self._react(self.participant.start(self.agenda.now_ns), self.agenda.now_ns)

    def take(self, arrival: Arrival, how: int) -> None:
        """Take a frame, or lose it where there is no room for it."""
        controller = self.controller
        controller.received += 1
        if how == WATCHES:
            self.watch(arrival)
        elif len(self.inbox) >= controller.receive_depth or controller.overrun:
            self.medium.reporter.overrun(self)
        else:
            wakes = how == WAKES
            self.inbox.append((arrival, wakes))
            if wakes:
                self.agenda.at(self.agenda.now_ns, WAKE, self.order, self._frame_due, None)

    def hear(self, arrival: Arrival) -> None:
        """Take an error frame; where the frames of the bus fill the inbox, some room is left for these."""
        if len(self.inbox) < self.controller.receive_depth + ERROR_FRAMES:
            self.inbox.append((arrival, True))
            self.agenda.at(self.agenda.now_ns, WAKE, self.order, self._frame_due, None)

    def watch(self, arrival: Arrival) -> None:
        """Take a frame without being waited for."""
        raise NotImplementedError(f"{self.name} does not watch {arrival}")

    # -- waking --

    def _frame_due(self, _: None) -> None:
        agenda = self.agenda
        if not self.inbox:  # it has left meanwhile
            return
        if self.busy_until_ns > agenda.now_ns:
            end_ns = next(arrival[0] for arrival, wakes in self.inbox if wakes)
            agenda.at(self.busy_until_ns, WAKE, self.order, self._frame_due, None, end_ns)
            return
        inbox, stored = self.inbox, []
        arrival, wakes = inbox.popleft()
        while not wakes:
            stored.append(arrival)
            arrival, wakes = inbox.popleft()
        self._wake(stored, arrival)

    def _set_timer(self, timer_ns: int | None) -> None:
        """Set the timer. One entry of the agenda at a time: it is moved on when it comes, so that none pile up."""
        self.timer_ns = timer_ns
        if timer_ns is not None and (self.alarm_ns is None or timer_ns < self.alarm_ns):
            if self.alarm_ns is not None:
                self.agenda.call_off(self.alarm)
            self.alarm_ns = timer_ns
            self.alarm = self.agenda.at(timer_ns, WAKE, self.order, self._alarm, None)

    def _alarm(self, _: None) -> None:
        self.alarm_ns = None
        if self.timer_ns is not None and self.timer_ns > self.agenda.now_ns:
            self._set_timer(self.timer_ns)
        elif self.timer_ns is not None:
            self._timer_due(self.timer_ns)

    def _timer_due(self, timer_ns: int) -> None:
        if self.timer_ns != timer_ns:
            return
        if self.busy_until_ns > self.agenda.now_ns:
            self.agenda.at(self.busy_until_ns, WAKE, self.order, self._timer_due, timer_ns, timer_ns)
            return
        self.timer_ns = None
        inbox, stored = self.inbox, []
        while inbox and not inbox[0][1]:
            stored.append(inbox.popleft()[0])
        self._wake(stored, None)

    def _wake(self, stored: list[Arrival], cause: Arrival | None) -> None:
        agenda = self.agenda
        agenda.acting = self.participant.name
        self._react(self.participant.wake(agenda.now_ns, stored, cause), agenda.now_ns + 1)

    def _check_timer(self, timer_ns: int) -> None:
        """Refuse a timer that would never move time on; one that fell due while the node computed may be kept."""
        if timer_ns != self.timer_ns:
            raise NodeError(
                f"{self.name}: timer asked for at {timer_ns} ns, but it is already {self.agenda.now_ns} ns: "
                "ask for a later instant"
            )

    # -- its answer --

    def _react(self, reaction: Reaction, earliest_ns: int) -> None:
        """Carry out its answer; raise NodeError for what cannot be. earliest_ns: for its timer."""
        busy_ns, timer_ns, sends = reaction
        if timer_ns is not None and timer_ns < earliest_ns:
            self._check_timer(timer_ns)
        agenda, medium = self.agenda, self.medium
        if busy_ns:
            if busy_ns < 0:
                raise NodeError(f"{self.name}: computing for {busy_ns} ns: ask for 0 ns or more")
            if not medium.functional:
                self.busy_until_ns = agenda.now_ns + busy_ns
        for delay_ns, identifier, data in sends:
            if delay_ns < 0 or identifier > STANDARD_MASK or identifier < 0 or len(data) > LONGEST_CLASSIC:
                self._check_send(delay_ns, identifier, data)
            if (delay_ns == 0 or medium.functional) and not self.delayed:
                medium.queue(self, identifier, data)
            elif self.delayed >= LATE_FRAMES:
                self.controller.lost[QUEUE_FULL] += 1
            else:  # also behind one of this instant that was asked for before
                self.delayed += 1
                due_ns = agenda.now_ns + (0 if medium.functional else delay_ns)
                agenda.at(due_ns, QUEUE, self.order, self._queue_late, (identifier, data))
        if timer_ns != self.timer_ns:
            self._set_timer(timer_ns)

    def _queue_late(self, frame: tuple[int, bytes]) -> None:
        self.delayed -= 1
        self.queue(frame)

    def queue(self, frame: tuple[int, bytes]) -> None:
        """Queue a frame now."""
        self.medium.queue(self, *frame)

    def _check_send(self, delay_ns: int, identifier: int, data: bytes) -> None:
        """Raise NodeError for what cannot be sent on its bus."""
        reason = refusal(identifier, len(data), self.medium.rates.fd)
        if delay_ns < 0 or reason:
            raise NodeError(
                f"{self.name}: frame {identifier:#x} of {len(data)} bytes in {delay_ns} ns cannot be sent: "
                f"{reason or '0 ns or more'}"
            )


def route_key(identifier: int) -> int:
    """Return what acceptance goes by: whether the data phase was fast, or the sender passive, does not matter."""
    return identifier if identifier < FD else identifier & ~(BRS | ESI)
