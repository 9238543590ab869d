"""Worst-case response times of CAN messages, from their lengths, periods, queuing jitter and transmit queues.

A message waits for one of lower priority that has just begun (blocking), then for all of higher priority. Since a frame
is not interrupted, the worst instance need not be the first of a busy period: all of them are looked at. Whole ns.

Transmit queues go by priority, or first-in-first-out. In a FIFO a message waits for those before it, and they for what
goes before the lowest of the queue, L, since any of them may be its head. The message is queued at t0 + x at the
latest, its jitter used up; t0 is the last instant before at which its queue holds no frame and none above L takes part
in arbitration. From t0 to the message's start, t0 + y, the bus never rests, and sends no more than
 * one frame below L, from elsewhere, that began before t0 (blocking);
 * what is queued here from t0 to t0 + x: of each message floor((x + jitter) / period) + 1, the message itself without
   the jitter, which the later ones lose, and without the frame that is asked about;
 * what is above L elsewhere: of each ceil((y + lateness + bit) / period), where lateness is how much behind its release
   it comes to take part: its jitter in a queue by priority, its own bound less its frame in a FIFO.
The least y as long as all that makes the response jitter + y - x + frame. It falls until one more is queued, so those
are the x to look at. A queue by priority is a FIFO of each message alone, and all this the analysis of 2007. Lateness
needs bounds, and bounds lateness: both grow from the jitter alone to the first that agree, or without end, which is
said. A message of several senders may be in the queue of any: there it counts as elsewhere as well.

Ref: R. Davis, A. Burns, R. Bril, J. Lukkien, "Controller Area Network (CAN) schedulability analysis: Refuted, revisited
and revised", Real-Time Systems 35 (2007), eqs. (4) to (12); errors: K. Tindell, A. Burns, H. Hansson (1995). FIFO
queues were first analysed by R. Davis, S. Kollmann, V. Pollex, F. Slomka, Real-Time Systems 49 (2013).
"""

from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain, count, pairwise

from hil.timing.staircase import FULL, Stair, Staircase

ERROR_BITS = 31
"""Of an error frame with its superposed flags, and of the intermission behind it."""
INSTANCES = 1_000
"""Of one busy period, at most: a bus that is loaded to the last bit never ends one."""
TURNS = 20
"""In which FIFO queues that delay each other must come to an end."""

OVERLOADED = "it and what goes before it fill the bus"
OUT_OF_REACH = "the bus is so full that no end of its busy period was found"
CIRCULAR = "first-in-first-out queues delay each other more and more"
BEHIND = "it waits for what comes from a first-in-first-out queue without a bound"


@dataclass(frozen=True)
class Message:
    """One periodic or sporadic message. time_ns: of its longest frame, intermission included.

    jitter_ns: how much later than its period says it may be queued. deadline_ns: from then on when it should have been.
    senders: nodes, where it matters. length: bytes of data, where it matters. data_bits: of the longest frame, at the
    data rate.
    """

    name: str
    identifier: int
    period_ns: int
    deadline_ns: int
    time_ns: int
    jitter_ns: int = 0
    extended: bool = False
    senders: frozenset[str] = frozenset()
    length: int | None = None
    data_bits: int = 0

    @property
    def priority(self) -> tuple[int, int, int]:
        """What arbitration compares, the smallest first: 11 bits, then IDE, then 18 more."""
        return (self.identifier >> 18, 1, self.identifier & 0x3FFFF) if self.extended else (self.identifier, 0, 0)


@dataclass(frozen=True)
class Errors:
    """Errors that the bus has to bear: a burst, then one every so often."""

    burst: int = 0
    interval_ns: int = 10_000_000

    def within(self, span_ns: int) -> int:
        """Return how many errors there may be in so much time."""
        return max(0, self.burst - 1 - -span_ns // self.interval_ns)

    def stair(self, span_ns: int, cost_ns: int) -> Stair:
        """Return what they cost within t and span_ns."""
        return Stair(span_ns + (self.burst - 1) * self.interval_ns, self.interval_ns, cost_ns)


@dataclass(frozen=True)
class Response:
    """The bound of a message. bound_ns: None where there is none, for a reason. instance: the worst one, from 0."""

    message: Message
    bound_ns: int | None
    instance: int = 0
    busy_ns: int = 0
    reason: str = ""

    @property
    def meets_deadline(self) -> bool:
        """Whether every instance arrives in time."""
        return self.bound_ns is not None and self.bound_ns <= self.message.deadline_ns


def utilisation(messages: Sequence[Message]) -> Fraction:
    """Return the share of time that the bus needs."""
    return sum((Fraction(each.time_ns, each.period_ns) for each in messages), Fraction(0))


Late = Mapping[int, int | None]
"""How much behind its release a message of a FIFO may come to take part in arbitration, by rank; None: no bound."""


def response_times(
    messages: Sequence[Message], bit_ns: int, errors: Errors | None = None, fifo: Collection[str] = ()
) -> list[Response]:
    """Return the bound of every message, by priority; fifo: nodes whose transmit queue is first-in-first-out.

    Raises ValueError for two of the same identifier.
    """
    return list(deque(_growing(messages, bit_ns, errors, fifo), len(messages)))[::-1]


def meet_deadlines(
    messages: Sequence[Message], bit_ns: int, errors: Errors | None = None, fifo: Collection[str] = ()
) -> bool:
    """Return whether all bounds are within their deadlines; sooner than all bounds are known, where one is not."""
    return all(each.meets_deadline for each in _growing(messages, bit_ns, errors, fifo))


def _growing(
    messages: Sequence[Message], bit_ns: int, errors: Errors | None, fifo: Collection[str]
) -> Iterator[Response]:
    """Yield what no bound is below, again and again until nothing grows: the last of each message is its bound.

    By priority, the lowest first: it is the first to be late.
    """
    ranked = _ranked(messages)
    ways = [_ways(rank, ranked, frozenset(fifo)) for rank in range(len(ranked))]
    late: dict[int, int | None] = {}
    for turn in count(1):
        moved: dict[int, int | None] = {}
        for rank, each in reversed(list(enumerate(ways))):
            found = _worst([way.bound(ranked, late, bit_ns, errors) for way in each])
            yield found
            late_ns = _lateness(found)
            if late.get(rank, 0) != late_ns and any(len(way.queue) > 1 for way in each):
                moved[rank] = late_ns
        if not moved:
            return
        late |= dict.fromkeys(moved) if turn % TURNS == 0 else moved


def _ranked(messages: Sequence[Message]) -> list[Message]:
    ranked = sorted(messages, key=lambda each: each.priority)
    for one, other in pairwise(ranked):
        if one.priority == other.priority:
            raise ValueError(f"{one.name} and {other.name} share identifier {one.identifier:#x}: renumber one")
    return ranked


def _lateness(response: Response) -> int | None:
    return None if response.bound_ns is None else response.bound_ns - response.message.time_ns


def _worst(responses: Sequence[Response]) -> Response:
    return max(responses, key=lambda each: (each.bound_ns is None, each.bound_ns or 0))


@dataclass(frozen=True)
class _Way:
    """A queue through which a message comes to the bus. own: who is in no other; rivals: who else goes before L."""

    rank: int
    queue: Sequence[int]
    own: Sequence[int]
    rivals: Sequence[int]
    blocking_ns: int

    def bound(self, ranked: Sequence[Message], late: Late, bit_ns: int, errors: Errors | None) -> Response:
        """Return the bound of the message on this way."""
        message = ranked[self.rank]
        own = [ranked[rank] for rank in self.own]
        rivals = [(late.get(rank, ranked[rank].jitter_ns), ranked[rank]) for rank in self.rivals]
        cost_ns = ERROR_BITS * bit_ns + max(each.time_ns for each in chain(own, (rival for _, rival in rivals)))
        before = [Stair((late_ns or 0) + bit_ns, each.period_ns, each.time_ns) for late_ns, each in rivals]
        busy = [Stair(late_ns or 0, each.period_ns, each.time_ns) for late_ns, each in rivals]
        busy += [Stair(each.jitter_ns, each.period_ns, each.time_ns) for each in own]
        if errors is not None:
            before.append(errors.stair(message.time_ns, cost_ns))
            busy.append(errors.stair(0, cost_ns))
        staircase = Staircase(busy)
        if staircase.load > FULL:
            return Response(message, None, reason=OVERLOADED)
        if late.get(self.rank, 0) is None:
            return Response(message, None, reason=CIRCULAR)
        if any(late_ns is None for late_ns, _ in rivals):
            return Response(message, None, reason=BEHIND)
        return _search(message, own, self.blocking_ns, Staircase(before), staircase)


def _ways(rank: int, ranked: Sequence[Message], fifo: frozenset[str]) -> list[_Way]:
    """Return every way of a message to the bus: a FIFO each, and one by priority if it has a sender of that kind."""
    message = ranked[rank]
    queues = [[k for k, each in enumerate(ranked) if node in each.senders] for node in sorted(message.senders & fifo)]
    if not message.senders or message.senders - fifo:
        queues.append([rank])
    ways = []
    for queue in queues:
        own = {k for k in queue if k == rank or len(ranked[k].senders) == 1}
        rivals = [k for k in range(queue[-1] + 1) if k not in own] + [rank] * (len(queues) > 1)
        blocking_ns = max((each.time_ns for each in ranked[queue[-1] + 1 :]), default=0)
        ways.append(_Way(rank, queue, sorted(own), rivals, blocking_ns))
    return ways


def _search(message: Message, own: Sequence[Message], blocking_ns: int, before: Staircase, busy: Staircase) -> Response:
    """Return the worst of all instants in a busy period at which the message may be queued."""
    busy_ns = busy.meets(blocking_ns, message.time_ns)
    if busy_ns is None:
        return Response(message, None, reason=OUT_OF_REACH)
    until_ns = busy_ns + message.jitter_ns
    before_it = [(0 if each is message else each.jitter_ns, each.period_ns, each.time_ns) for each in own]
    steps = [range(-jitter % period, until_ns, period) for jitter, period, _ in before_it]
    if sum(map(len, steps)) > INSTANCES:
        return Response(message, None, busy_ns=busy_ns, reason=OUT_OF_REACH)
    worst_ns, worst, y_ns = -1, 0, 0
    for x_ns in sorted({0}.union(*steps)):
        if busy_ns > x_ns >= busy_ns - message.time_ns - worst_ns:
            continue  # it ends within the busy period, too soon to be the worst
        here_ns = sum(((x_ns + jitter) // period + 1) * time for jitter, period, time in before_it)
        found_ns = before.meets(blocking_ns + here_ns - message.time_ns, y_ns)
        if found_ns is None:
            return Response(message, None, busy_ns=busy_ns, reason=OUT_OF_REACH)
        y_ns = found_ns
        if y_ns - x_ns > worst_ns:
            worst_ns, worst = y_ns - x_ns, x_ns // message.period_ns
    return Response(message, message.jitter_ns + worst_ns + message.time_ns, worst, busy_ns)
