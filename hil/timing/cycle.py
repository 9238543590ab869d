"""Response times of frames that come in every cycle, each at its offset or in answer to another: the rig's own.

The analysis of 2007 lets every message come at any time against every other, and so calls the rig's bus overloaded,
where State takes turns and AccelRef waits for an Encoder. Here a frame is released within a window: at a fixed instant
of the cycle, or when its sender has computed, between the earliest and the latest end of the frame that it answers.

With [A, B] the window of a frame, c and C its shortest and longest time on the bus, intermission included:

* Let s be when the bus last began to serve frames of this priority or higher, without a pause until the frame starts.
  One of them is released at s, and at most one of lower priority is under way. Those that go first were released at s
  or later, so B >= s, and by the start of the frame, so A <= start. Hence start <= s + blocking + sum of their C, to
  the fixed point from below. That sum changes with s only at the B's, so it is enough to try these;
  and what was under way at s is over by its own latest end.
* A frame starts no earlier than x + sum of c of those of higher priority with A >= x and B <= its own A, for any x.

Windows and bounds are iterated until they agree. All frames must end with their cycle, but those released by a clock of
their own, which must end within a period: so a cycle stands alone but for these, which may meet the next one's frames.

Ref: J. Palencia, M. Gonzalez Harbour, "Schedulability analysis for tasks with static and dynamic offsets", RTSS 1998
(releases in windows behind one another); R. Davis et al., Real-Time Systems 35 (2007) (blocking, busy period).
"""

from collections.abc import Sequence
from dataclasses import dataclass

from hil.timing.response_time import ERROR_BITS, Errors

REFINEMENTS = 3
"""Of the earliest releases; each is sound, and more change nothing for the rig."""
EVER = 1 << 62


@dataclass(frozen=True)
class Slot:
    """One frame of every cycle: how long it is, in ns without intermission, and when it is released.

    after: the frame that its sender answers, delay_ns behind its end; None: delay_ns behind the cycle's start. It may
    come up to sooner_ns before.
    free: by a clock of its own instead, at any time, once a period.
    """

    name: str
    identifier: int
    shortest_ns: int
    longest_ns: int
    delay_ns: int = 0
    after: str | None = None
    free: bool = False
    sooner_ns: int = 0


@dataclass(frozen=True)
class Timing:
    """What all slots share. errors: that the bus has to bear."""

    period_ns: int
    bit_ns: int
    intermission_ns: int
    errors: Errors | None = None


@dataclass
class Bound:
    """Of one slot, ns behind its cycle's start: released from .. to, starts at the earliest, ends at the latest.

    response_ns: from its release to the end of its intermission.
    """

    slot: Slot
    earliest_ns: int = 0
    starts_ns: int = 0
    latest_ns: int = EVER
    end_ns: int = EVER
    response_ns: int = 0

    def deadline_ns(self, period_ns: int) -> int:
        """Return how long it may take: what is left of the cycle when it is released at the latest; free: a period."""
        return period_ns if self.slot.free else period_ns - self.latest_ns


class Late(Exception):
    """A frame that may not end with its cycle; its name."""


def bounds(slots: Sequence[Slot], timing: Timing) -> dict[str, Bound]:
    """Return the bound of every slot by name; raise Late where one may not end with its cycle."""
    cycle = _Cycle(slots, timing)
    for _ in range(REFINEMENTS):
        cycle.settle_earliest()
        cycle.settle_latest()
    return {bound.slot.name: bound for bound in cycle.ranked}


class _Cycle:
    """The bounds of all slots, on their way to agreement; ranked by priority."""

    def __init__(self, slots: Sequence[Slot], timing: Timing) -> None:
        self.timing = timing
        self.ranked = [Bound(slot) for slot in sorted(slots, key=lambda slot: slot.identifier)]
        self._by_name = {bound.slot.name: bound for bound in self.ranked}
        self._in_turn = sorted(self.ranked, key=self._answers)

    def _answers(self, bound: Bound) -> int:
        """Return how many frames lie between the cycle's start and this one."""
        after = bound.slot.after
        return 0 if after is None else 1 + self._answers(self._by_name[after])

    # -- the earliest --

    def settle_earliest(self) -> None:
        """Find when each is released, and starts, at the earliest; latest_ns is that of the round before."""
        for bound in self._in_turn:
            slot = bound.slot
            bound.earliest_ns = slot.delay_ns - slot.sooner_ns
            if slot.after is not None:
                before = self._by_name[slot.after]
                bound.earliest_ns += before.starts_ns + before.slot.shortest_ns
            bound.starts_ns = max(bound.earliest_ns, self._served_first(bound))

    def _served_first(self, bound: Bound) -> int:
        """Return until when the bus is taken by frames that are released by then and go first."""
        first = [
            each
            for each in self.ranked[: self.ranked.index(bound)]
            if each.latest_ns <= bound.earliest_ns and not each.slot.free
        ]
        first.sort(key=lambda each: each.earliest_ns, reverse=True)
        until_ns = taken_ns = 0
        for each in first:
            taken_ns += each.slot.shortest_ns + self.timing.intermission_ns
            until_ns = max(until_ns, each.earliest_ns + taken_ns)
        return until_ns

    # -- the latest --

    def settle_latest(self) -> None:
        """Find when each is released, and ends, at the latest: from below, until nothing changes."""
        for bound in self.ranked:
            bound.latest_ns = self.timing.period_ns if bound.slot.free else bound.earliest_ns + bound.slot.sooner_ns
            bound.end_ns = bound.starts_ns + bound.slot.shortest_ns
        changed = True
        while changed:
            changed = False
            for bound in self._in_turn:
                before = bound.latest_ns, bound.end_ns
                if bound.slot.after is not None:
                    bound.latest_ns = self._by_name[bound.slot.after].end_ns + bound.slot.delay_ns
                self._respond(bound)
                if bound.end_ns + self.timing.intermission_ns > self.timing.period_ns and not bound.slot.free:
                    raise Late(bound.slot.name)
                changed |= before != (bound.latest_ns, bound.end_ns)

    def _respond(self, bound: Bound) -> None:
        """Bound the response over all beginnings s of a busy period that may hold this frame."""
        rank, rest_ns = self.ranked.index(bound), self.timing.intermission_ns
        first = self.ranked[: rank + 1]
        behind = [each for each in self.ranked[rank + 1 :] if not _never_before(each.slot, bound.slot)]
        own_ns = bound.slot.longest_ns + rest_ns
        bound.response_ns = end_ns = 0
        previous_ns = -1
        for s_ns in sorted({each.latest_ns for each in first}):
            least_ns = max(previous_ns + 1, min(each.earliest_ns for each in first if each.latest_ns >= s_ns))
            previous_ns = s_ns
            if least_ns > min(s_ns, bound.latest_ns):
                continue
            under_way = [
                each
                for each in behind
                if each.slot.free or (each.earliest_ns < s_ns and each.end_ns + rest_ns > least_ns)
            ]
            blocking_ns = max((each.slot.longest_ns + rest_ns for each in under_way), default=0)
            wait_ns = self._wait(bound, first[:-1], s_ns, blocking_ns)
            if s_ns + wait_ns >= bound.earliest_ns:
                response_ns = wait_ns + own_ns - max(0, bound.earliest_ns - s_ns)
                bound.response_ns = max(bound.response_ns, response_ns)
                left_ns = max((each.end_ns + rest_ns - s_ns for each in under_way if not each.slot.free), default=0)
                if not any(each.slot.free for each in under_way):
                    wait_ns = self._wait(bound, first[:-1], s_ns, max(0, min(blocking_ns, left_ns)))
                end_ns = max(end_ns, s_ns + wait_ns + own_ns)
        bound.end_ns = min(end_ns, bound.latest_ns + bound.response_ns) - rest_ns

    def _wait(self, bound: Bound, higher: Sequence[Bound], s_ns: int, blocking_ns: int) -> int:
        """Return how long after s the frame starts at the latest, behind those that go first."""
        rest_ns, own_ns = self.timing.intermission_ns, bound.slot.longest_ns
        again_ns = max([own_ns, *(each.slot.longest_ns for each in higher)])
        wait_ns = blocking_ns
        while True:
            longer_ns = blocking_ns + self._disturbed(wait_ns + own_ns + rest_ns, again_ns + rest_ns)
            longer_ns += sum(
                (each.slot.longest_ns + rest_ns) * self._instances(each, bound, s_ns, s_ns + wait_ns) for each in higher
            )
            if longer_ns + (own_ns + rest_ns) * bound.slot.free > self.timing.period_ns:
                raise Late(bound.slot.name)
            if longer_ns == wait_ns:
                return wait_ns
            wait_ns = longer_ns

    def _instances(self, each: Bound, bound: Bound, s_ns: int, until_ns: int) -> int:
        """Return how often a frame of higher priority may be released from s until then."""
        period_ns = self.timing.period_ns
        if each.slot.free:
            return (until_ns - s_ns) // period_ns + 1
        now = each.latest_ns >= s_ns and each.earliest_ns <= until_ns
        return now + (bound.slot.free and each.earliest_ns + period_ns <= until_ns)

    def _disturbed(self, span_ns: int, again_ns: int) -> int:
        """Return how long errors may take the bus in so much time, each with a frame that is sent again."""
        errors = self.timing.errors
        return 0 if errors is None else errors.within(span_ns) * (ERROR_BITS * self.timing.bit_ns + again_ns)


def _never_before(slot: Slot, other: Slot) -> bool:
    """Return whether a frame is never released before another: it answers it, or the same one no sooner."""
    if slot.free or other.free or slot.after is None:
        return False
    return slot.after == other.name or (slot.after == other.after and slot.delay_ns - slot.sooner_ns >= other.delay_ns)
