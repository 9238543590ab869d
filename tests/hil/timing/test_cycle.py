"""Bounds of frames that come in every cycle: a bus by hand, the rig's budget, and random cycles on a naive bus."""

import random
from heapq import heappop, heappush

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.timing.cycle import Late, Slot, Timing, bounds
from hil.timing.response_time import Errors

REST = 3
TIMING = Timing(1000, 1, REST)


def slot(name: str, rank: int, longest: int, **more) -> Slot:
    return Slot(name, rank, more.pop("shortest", longest), longest, **more)


def test_answers_by_hand() -> None:
    """A (100) at 0; B (50) 20 behind A's end; C, lowest, 200 long, at 110 sharp: it is under way when B comes."""
    found = bounds(
        [slot("A", 1, 97), slot("B", 2, 47, after="A", delay_ns=20), slot("C", 3, 197, delay_ns=110)], TIMING
    )
    assert (found["A"].end_ns, found["A"].response_ns) == (97, 100)
    assert (found["B"].earliest_ns, found["B"].latest_ns) == (117, 117)
    assert (found["B"].end_ns, found["B"].response_ns) == (117 + 200 + 47, 250)  # 7 too many: all of C counts
    assert (found["C"].end_ns, found["C"].response_ns) == (307, 200)


def test_an_answer_that_may_come_early_overtakes_nobody_that_is_on_the_bus() -> None:
    """B answers A, 40 to 97 long: released 50 to 107, so it may go before C (at 60) or behind it."""
    slots = [slot("A", 1, 97, shortest=40), slot("B", 3, 47, after="A", delay_ns=10), slot("C", 2, 97, delay_ns=60)]
    found = bounds(slots, TIMING)
    assert (found["B"].earliest_ns, found["B"].latest_ns) == (50, 107)
    assert found["B"].end_ns == 100 + 100 + 47  # behind A and C
    assert found["C"].end_ns == 60 + 50 + 100 - REST  # B is under way, if A was short


def test_a_frame_with_a_clock_of_its_own_delays_every_other_once() -> None:
    slots = [slot("A", 1, 97), slot("B", 2, 97), slot("F", 3, 197, free=True)]
    found = bounds(slots, TIMING)
    assert (found["A"].response_ns, found["B"].response_ns) == (300, 400)
    assert found["F"].response_ns == 400
    found = bounds([slot("A", 1, 97), slot("F", 0, 197, free=True)], TIMING)
    assert found["A"].response_ns == 300


def test_what_does_not_end_with_its_cycle_is_named() -> None:
    with pytest.raises(Late, match="B"):
        bounds([slot("A", 1, 497), slot("B", 2, 498)], TIMING)
    assert bounds([slot("A", 1, 497), slot("B", 2, 497)], TIMING)["B"].end_ns == 997
    with pytest.raises(Late, match="B"):
        bounds([slot("A", 1, 397), slot("B", 2, 397), slot("F", 3, 297, free=True)], TIMING)


def test_errors_cost_an_error_frame_and_the_longest_frame_again() -> None:
    timing = Timing(1000, 1, REST, Errors(burst=1, interval_ns=10**9))
    found = bounds([slot("A", 1, 97), slot("B", 2, 47)], timing)
    assert found["A"].response_ns == 100 + 31 + 100
    assert found["B"].response_ns == 150 + 31 + 100


# -- random cycles --


@given(st.integers(0, 2**32))
@settings(max_examples=150, deadline=None)
def test_no_cycle_goes_beyond_its_bounds(seed: int) -> None:
    drawn = random.Random(seed)
    slots = _slots(drawn)
    try:
        found = bounds(slots, TIMING)
    except Late:
        return
    free_at, phase = 0, drawn.randint(0, 999)
    for _ in range(40):
        lengths = {each.name: drawn.choice([each.shortest_ns, each.longest_ns]) for each in slots}
        released, ended, free_at = _one_cycle(slots, lengths, phase, max(0, free_at - 1000))
        for each in slots:
            bound = found[each.name]
            assert bound.earliest_ns <= released[each.name] <= bound.latest_ns
            assert ended[each.name] - released[each.name] + REST <= bound.response_ns
            assert ended[each.name] <= bound.end_ns or each.free


def test_random_cycles_do_reach_their_bounds() -> None:
    """A bound that is never met proves little: of simple cycles, most are met to the ns."""
    drawn = random.Random(1)
    shares = []
    for _ in range(60):
        slots = [slot(f"m{k}", k, drawn.randint(40, 120), delay_ns=drawn.randint(0, 300)) for k in range(4)]
        found = bounds(slots, TIMING)
        released, ended, _ = _one_cycle(slots, {each.name: each.longest_ns for each in slots}, 0, 0)
        shares += [(ended[each.name] - released[each.name] + REST) / found[each.name].response_ns for each in slots]
    assert sum(share == 1 for share in shares) > len(shares) / 2
    assert min(shares) > 0.3


def _slots(drawn: random.Random) -> list[Slot]:
    slots: list[Slot] = []
    ranks = drawn.sample(range(20), 20)
    for k in range(drawn.randint(2, 8)):
        shortest = drawn.randint(5, 60)
        longest = shortest + drawn.choice([0, drawn.randint(0, 40)])
        after = drawn.choice(slots).name if slots and drawn.random() < 0.5 else None
        delay = drawn.randint(0, 60) if after else drawn.choice([0, drawn.randint(0, 500)])
        slots.append(Slot(f"m{k}", ranks[k], shortest, longest, delay, after))
    if drawn.random() < 0.3:
        slots.append(Slot("free", ranks[10], 5, drawn.randint(5, 90), free=True))
    return slots


def _one_cycle(slots, lengths, phase, free_at):
    """Play one cycle on a bus in its barest form; return releases, ends, and when the bus is free."""
    by_name = {each.name: each for each in slots}
    coming = [(phase if each.free else each.delay_ns, each.name) for each in slots if not each.after]
    coming.sort()
    waiting: list[tuple[int, str]] = []
    released = dict(map(reversed, coming))
    ended: dict[str, int] = {}
    now = free_at
    while coming or waiting:
        if not waiting:
            now = max(now, coming[0][0])
        while coming and coming[0][0] <= now:
            _, name = heappop(coming)
            heappush(waiting, (by_name[name].identifier, name))
        _, name = heappop(waiting)
        ended[name] = now + lengths[name]
        now = ended[name] + REST
        for each in slots:
            if each.after == name:
                released[each.name] = ended[name] + each.delay_ns
                heappush(coming, (released[each.name], each.name))
    return released, ended, now
