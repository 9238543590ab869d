"""Response-time bounds: published examples, a naive bus, and what cannot be bounded."""

import random
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.timing.response_time import CIRCULAR, Errors, Message, meet_deadlines, response_times, utilisation
from tests.hil.timing.naive_bus import longest_responses

MS = 1_000_000
BIT_NS = 8_000
"""125 kbit/s: 125 bits are 1 ms, the frames of the 2007 paper's example."""


def made(rows, jitters=None) -> list[Message]:
    """Return messages from (period, time) in priority order, deadlines being the periods."""
    jitters = jitters or [0] * len(rows)
    return [
        Message(f"m{k}", 0x100 + k, period, period, time, jitter)
        for k, ((period, time), jitter) in enumerate(zip(rows, jitters, strict=True))
    ]


def test_the_example_that_refuted_the_first_analysis() -> None:
    """Davis et al. 2007, section 3.1: the second instance of C answers after 3.5 ms, its first after 3.0."""
    a, b, c = response_times(made([(2_500_000, MS), (3_500_000, MS), (3_500_000, MS)]), BIT_NS)
    assert (a.bound_ns, b.bound_ns, c.bound_ns) == (2 * MS, 3 * MS, 3_500_000)
    assert c.instance == 1
    assert c.busy_ns == 7 * MS
    first = response_times([*(each.message for each in (a, b)), Message("C", 0x200, 35 * MS, 35 * MS, MS)], BIT_NS)
    assert first[2].bound_ns == 3 * MS


@given(st.integers(0, 2**32))
@settings(max_examples=200, deadline=None)
def test_no_response_is_longer_than_its_bound(seed: int) -> None:
    drawn = random.Random(seed)
    rows, jitters = [], []
    for _ in range(drawn.randint(2, 8)):
        period = drawn.choice([1, 2, 2, 3, 5, 7, 10, 20]) * MS
        rows.append((period, drawn.randint(55, 135) * 2_000))
        jitters.append(drawn.choice([0, 0, drawn.randint(0, period)]))
    messages = made(rows, jitters)
    releases = []
    for k, ((period, _), jitter) in enumerate(zip(rows, jitters, strict=True)):
        offset = drawn.choice([0, drawn.randint(0, period)])
        for begins in range(offset, 300 * MS, period):
            releases.append((begins, begins + drawn.choice([0, jitter, drawn.randint(0, jitter)]), k))
    found = longest_responses(releases, [time for _, time in rows])
    for longest, response in zip(found, response_times(messages, 2_000), strict=True):
        assert response.bound_ns is None or longest <= response.bound_ns


@pytest.mark.parametrize("seed", range(40))
def test_the_critical_instant_reaches_the_bound(seed: int) -> None:
    """All queued at once, 1 ns behind the longest frame of those below."""
    drawn = random.Random(seed)
    rows = [(drawn.choice([5, 7, 10, 20]) * MS, drawn.randint(55, 135) * 2_000) for _ in range(6)]
    responses = response_times(made(rows), 2_000)
    for rank, response in enumerate(responses):
        releases = [(begins, begins, k) for k in range(rank + 1) for begins in range(1, 200 * MS, rows[k][0])]
        blocked = rank + 1 < len(rows)
        if blocked:
            blocking = max(range(rank + 1, len(rows)), key=lambda k: rows[k][1])
            releases.append((0, 0, blocking))
        longest = longest_responses(releases, [time for _, time in rows])[rank]
        assert response.bound_ns is not None
        assert longest == response.bound_ns - blocked


def test_overload_is_said_of_those_that_it_starves_and_ends() -> None:
    rows = [(2 * MS, MS), (2 * MS, MS), (10 * MS, MS)]
    first, second, third = response_times(made(rows), BIT_NS)
    assert first.bound_ns == 2 * MS
    assert (second.bound_ns, third.bound_ns) == (None, None)
    assert not third.meets_deadline
    assert utilisation([each.message for each in (first, second, third)]) > 1


def test_errors_cost_an_error_frame_and_the_longest_frame_again() -> None:
    (alone,) = response_times(made([(10 * MS, MS)]), BIT_NS, Errors(burst=1, interval_ns=100 * MS))
    assert alone.bound_ns == MS + (31 * BIT_NS + MS)
    (twice,) = response_times(made([(10 * MS, MS)]), BIT_NS, Errors(burst=2, interval_ns=100 * MS))
    assert twice.bound_ns == MS + 2 * (31 * BIT_NS + MS)


def test_extended_identifiers_lose_against_the_same_eleven_bits() -> None:
    standard = Message("standard", 0x123, MS, MS, 1000)
    extended = Message("extended", 0x123 << 18, MS, MS, 1000, extended=True)
    lower = Message("lower", 0x124, MS, MS, 1000)
    assert [each.message.name for each in response_times([lower, extended, standard], 1)] == [
        *("standard", "extended", "lower")
    ]


def test_two_of_one_identifier_are_refused() -> None:
    with pytest.raises(ValueError, match="a and b share identifier 0x123"):
        response_times([Message("a", 0x123, MS, MS, 1), Message("b", 0x123, MS, MS, 1)], 1)


def sent_by(senders: str, rows) -> list[Message]:
    """Return messages from (period, time) in priority order, each with the sender of that letter."""
    return [replace(each, senders=frozenset({name})) for name, each in zip(senders, made(rows), strict=True)]


def test_a_fifo_lets_all_of_its_messages_wait_for_what_goes_before_the_lowest() -> None:
    """A is a FIFO of two, each 1 ms: both wait for the other and for the one of B between them; nothing is below."""
    messages = sent_by("ABA", [(20 * MS, MS)] * 3)
    assert [each.bound_ns for each in response_times(messages, BIT_NS)] == [2 * MS, 3 * MS, 3 * MS]
    assert [each.bound_ns for each in response_times(messages, BIT_NS, fifo={"A"})] == [3 * MS, 3 * MS, 3 * MS]


def test_a_fifo_of_one_message_is_a_queue_by_priority() -> None:
    messages = sent_by("ABC", [(2_500_000, MS), (3_500_000, MS), (3_500_000, MS)])
    assert response_times(messages, BIT_NS, fifo=set("ABC")) == response_times(messages, BIT_NS)


def test_errors_cost_as_much_in_a_fifo() -> None:
    """One error within the busy period: an error frame and the longest frame again, for every message."""
    messages = sent_by("ABA", [(20 * MS, MS)] * 3)
    found = response_times(messages, BIT_NS, Errors(burst=1, interval_ns=100 * MS), fifo={"A"})
    assert [each.bound_ns for each in found] == [3 * MS + 31 * BIT_NS + MS] * 3


@pytest.mark.usefixtures("bounded")
def test_fifo_queues_that_delay_each_other_without_end_are_said_so() -> None:
    """At 96 % load three FIFO of three have no bound; by priority all have."""
    messages = sent_by("ABCABCABC", [(each * MS, MS) for each in (8, 8, 9, 9, 9, 10, 10, 10, 11)])
    assert 0.95 < utilisation(messages) < 1
    assert all(each.bound_ns is not None for each in response_times(messages, BIT_NS))
    found = response_times(messages, BIT_NS, fifo=set("ABC"))
    assert {each.bound_ns for each in found} == {None}
    assert CIRCULAR in {each.reason for each in found}


def test_a_message_of_several_senders_is_bounded_in_the_queue_of_any() -> None:
    """Stop may wait behind the lowest of the FIFO A, or go ahead of all from B: the first is its bound.

    What waits for it counts it once, wherever it comes from.
    """
    low = Message("low", 0x300, 20 * MS, 20 * MS, MS, senders=frozenset("A"))
    stop = Message("stop", 0x010, 20 * MS, 20 * MS, MS, senders=frozenset("AB"))
    middle = Message("middle", 0x200, 20 * MS, 20 * MS, MS, senders=frozenset("C"))
    found = response_times([low, stop, middle], BIT_NS, fifo={"A"})
    assert [each.bound_ns for each in found[1:]] == [3 * MS, 3 * MS]
    assert found[0].bound_ns == 4 * MS  # its own like from B is counted as well


@pytest.mark.usefixtures("bounded")
@pytest.mark.parametrize("spare", [0, 1, 10, 1_000, 100_000])
def test_a_bus_that_is_all_but_full_has_an_answer_soon(spare: int) -> None:
    """From 100 % down to 99 %, periods without a common divisor: a bound or a reason, and no endless loop."""
    rows = [(10 * MS + 7 * k + spare, MS) for k in range(10)]
    for fifo in (set(), {"A", "B"}):
        for response in response_times(sent_by("ABABABABAB", rows), BIT_NS, fifo=fifo):
            assert (response.bound_ns is None) == bool(response.reason)


def test_deadlines_are_met_as_the_bounds_say() -> None:
    rows = [(2_500_000, MS), (3_500_000, MS), (3_500_000, MS)]
    assert meet_deadlines(made(rows), BIT_NS)
    late = [*made(rows)[:2], replace(made(rows)[2], deadline_ns=3_499_999)]
    assert not meet_deadlines(late, BIT_NS)
