"""Worst-case response times of CAN messages, from their lengths, periods and queuing jitter.

A message waits for one of lower priority that has just begun (blocking), then for all of higher priority. Since a frame
is not interrupted, the worst instance need not be the first of a busy period: all of them are looked at. Transmit
queues are by priority. Whole ns throughout.

Ref: R. Davis, A. Burns, R. Bril, J. Lukkien, "Controller Area Network (CAN) schedulability analysis: Refuted, revisited
and revised", Real-Time Systems 35 (2007), eqs. (4) to (12); errors: K. Tindell, A. Burns, H. Hansson (1995).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

ERROR_BITS = 31
"""Of an error frame with its superposed flags, and of the intermission behind it."""
INSTANCES = 100_000
"""Of one busy period, at most: a bus that is loaded to the last bit never ends one."""


@dataclass(frozen=True)
class Message:
    """One periodic or sporadic message. time_ns: of its longest frame, intermission included.

    jitter_ns: how much later than its period says it may be queued. deadline_ns: from then on when it should have been.
    """

    name: str
    identifier: int
    period_ns: int
    deadline_ns: int
    time_ns: int
    jitter_ns: int = 0
    extended: bool = False

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
        return max(0, self.burst + _ceil(span_ns, self.interval_ns) - 1)


@dataclass(frozen=True)
class Response:
    """The bound of a message. bound_ns: None where it may wait for ever. instance: the worst one, from 0."""

    message: Message
    bound_ns: int | None
    instance: int = 0
    busy_ns: int = 0

    @property
    def meets_deadline(self) -> bool:
        """Whether every instance arrives in time."""
        return self.bound_ns is not None and self.bound_ns <= self.message.deadline_ns


def utilisation(messages: Sequence[Message]) -> Fraction:
    """Return the share of time that the bus needs."""
    return sum((Fraction(each.time_ns, each.period_ns) for each in messages), Fraction(0))


def response_times(messages: Sequence[Message], bit_ns: int, errors: Errors | None = None) -> list[Response]:
    """Return the bound of every message, by priority. Raises ValueError for two of the same identifier."""
    ranked = sorted(messages, key=lambda each: each.priority)
    for one, other in pairwise(ranked):
        if one.priority == other.priority:
            raise ValueError(f"{one.name} and {other.name} share identifier {one.identifier:#x}: renumber one")
    return [_bound(ranked[: rank + 1], ranked[rank + 1 :], bit_ns, errors) for rank in range(len(ranked))]


def _bound(before: Sequence[Message], behind: Sequence[Message], bit_ns: int, errors: Errors | None) -> Response:
    """Return the bound of the last message of `before`; all others of it go first, those of `behind` block."""
    *higher, message = before
    longest_ns = max(each.time_ns for each in before)
    blocking_ns = max((each.time_ns for each in behind), default=0)

    def disturbed_ns(span_ns: int) -> int:
        return 0 if errors is None else errors.within(span_ns) * (ERROR_BITS * bit_ns + longest_ns)

    load = utilisation(before)
    if errors is not None:
        load += Fraction(ERROR_BITS * bit_ns + longest_ns, errors.interval_ns)
    if load >= 1:
        return Response(message, None)
    busy_ns = _busy_period(before, blocking_ns, disturbed_ns)
    instances = _ceil(busy_ns + message.jitter_ns, message.period_ns)
    if instances > INSTANCES:
        return Response(message, None)
    worst_ns, worst, wait_ns = -1, 0, blocking_ns
    for instance in range(instances):
        least_ns = blocking_ns + instance * message.time_ns
        wait_ns = max(wait_ns, least_ns)
        while True:
            ahead = sum(_ceil(wait_ns + each.jitter_ns + bit_ns, each.period_ns) * each.time_ns for each in higher)
            longer_ns = least_ns + ahead + disturbed_ns(wait_ns + message.time_ns)
            if longer_ns == wait_ns:
                break
            wait_ns = longer_ns
        response_ns = message.jitter_ns + wait_ns - instance * message.period_ns + message.time_ns
        if response_ns > worst_ns:
            worst_ns, worst = response_ns, instance
    return Response(message, worst_ns, worst, busy_ns)


def _busy_period(before: Sequence[Message], blocking_ns: int, disturbed_ns: Callable[[int], int]) -> int:
    """Return how long the bus may be taken by these messages, without a pause."""
    busy_ns = before[-1].time_ns
    while True:
        taken = sum(_ceil(busy_ns + each.jitter_ns, each.period_ns) * each.time_ns for each in before)
        longer_ns = blocking_ns + taken + disturbed_ns(busy_ns)
        if longer_ns == busy_ns:
            return busy_ns
        busy_ns = longer_ns


def _ceil(number: int, divisor: int) -> int:
    return -(-number // divisor)
