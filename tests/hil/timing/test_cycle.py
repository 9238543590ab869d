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
    assert (found["B"].end_ns, found["B"].response_ns) == (110 + 200 + 47, 250)
    assert (found["C"].end_ns, found["C"].response_ns) == (307, 200)


def test_an_answer_that_may_come_early_overtakes_nobody_that_is_on_the_bus() -> None:
    """B answers A, 40 to 97 long: released 50 to 107, so it may go before C (at 60) or behind it."""
    slots = [slot("A", 1, 97, shortest=40), slot("B", 3, 47, after="A", delay_ns=10), slot("C", 2, 97, delay_ns=60)]
    found = bounds(slots, TIMING)
    assert (found["B"].earliest_ns, found["B"].latest_ns) == (50, 107)
    assert found["B"].end_ns == 100 + 100 + 47  # behind A and C
    assert found["C"].end_ns == 60 + 50 + 100 - REST  # B is under way, if A was short


def test_an_answer_is_never_held_up_by_one_of_lower_priority_that_comes_with_it_or_behind_it() -> None:
    """B and C answer A after the same time, whenever A ends."""
    slots = [
        slot("A", 1, 97, shortest=40),
        slot("B", 2, 47, after="A", delay_ns=10),
        slot("C", 3, 197, after="A", delay_ns=10),
    ]
    found = bounds(slots, TIMING)
    assert found["B"].end_ns == 97 + 10 + 47
    assert found["C"].end_ns == 97 + 10 + 50 + 197


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
@settings(max_examples=200, deadline=None)
def test_no_cycle_goes_beyond_its_bounds(seed: int) -> None:
    drawn = random.Random(seed)
    slots = _slots(drawn)
    try:
        found = bounds(slots, TIMING)
    except Late:
        return
    phases = {each.name: drawn.randint(0, 999) for each in slots if each.free}
    for name, cycle, released, ended in _cycles(slots, drawn, phases, cycles=30):
        bound = found[name]
        assert ended - released + REST <= bound.response_ns, name
        if not bound.slot.free:
            assert bound.earliest_ns <= released - 1000 * cycle <= bound.latest_ns
            assert ended - 1000 * cycle <= bound.end_ns


def test_frames_by_clocks_of_their_own_may_meet_the_next_cycle() -> None:
    """Released late, both wait for the last of one cycle; then the second for the first of the next."""
    slots = [
        slot("a", 0, 36),
        slot("m", 23, 34, delay_ns=912),
        slot("f", 33, 48, free=True),
        slot("g", 37, 45, free=True),
    ]
    found = bounds(slots, TIMING)
    ((_, _, released, ended),) = [
        each for each in _cycles(slots, random.Random(1), {"f": 913, "g": 913}, 2) if each[0] == "g" and each[1] == 0
    ]
    assert ended - released + REST == 36 + 51 + 39 + 48 <= found["g"].response_ns


def test_a_frame_by_its_own_clock_that_takes_longer_than_a_period_is_late() -> None:
    with pytest.raises(Late, match="f"):  # a and f, behind g: 1100
        bounds([slot("a", 1, 297), slot("f", 2, 397, free=True), slot("g", 3, 397, free=True)], TIMING)


def test_random_cycles_do_reach_their_bounds() -> None:
    """A bound that is never met proves little: of simple cycles, most are met to the ns."""
    drawn = random.Random(1)
    shares = []
    for _ in range(60):
        slots = [slot(f"m{k}", k, drawn.randint(40, 120), delay_ns=drawn.randint(0, 300)) for k in range(4)]
        found = bounds(slots, TIMING)
        played = _cycles(slots, drawn, {}, 1)
        shares += [(ended - released + REST) / found[name].response_ns for name, _, released, ended in played]
    assert sum(share == 1 for share in shares) > len(shares) / 2
    assert min(shares) > 0.3


def _slots(drawn: random.Random) -> list[Slot]:
    slots: list[Slot] = []
    ranks = drawn.sample(range(20), 20)
    for k in range(drawn.randint(2, 8)):
        shortest = drawn.randint(5, 60)
        longest = shortest + drawn.choice([0, drawn.randint(0, 40)])
        after = drawn.choice(slots).name if slots and drawn.random() < 0.5 else None
        delay = drawn.randint(0, 60) if after else drawn.choice([0, drawn.randint(0, 500), drawn.randint(800, 950)])
        sooner = drawn.choice([0, drawn.randint(0, delay)])
        slots.append(Slot(f"m{k}", ranks[k], shortest, longest, delay, after, sooner_ns=sooner))
    for k in range(drawn.choice([0, 0, 1, 2, 3])):
        slots.append(Slot(f"free{k}", ranks[10 + k], 5, drawn.randint(5, 90), free=True))
    return slots


def _cycles(slots, drawn, phases, cycles):
    """Play cycles on a bus in its barest form; return (name, cycle, released, ended) of every frame."""
    by_name = {each.name: each for each in slots}

    def delayed(each):
        if each.free:
            return phases[each.name]
        return each.delay_ns - (each.sooner_ns and drawn.choice([0, each.sooner_ns, drawn.randint(0, each.sooner_ns)]))

    first = [each for each in slots if not each.after]
    coming = [(1000 * cycle + delayed(each), each.name, cycle) for cycle in range(cycles) for each in first]
    coming.sort()
    waiting: list[tuple[int, int, str, int]] = []
    found = []
    now = 0
    while coming or waiting:
        if not waiting:
            now = max(now, coming[0][0])
        while coming and coming[0][0] <= now:
            released, name, cycle = heappop(coming)
            heappush(waiting, (by_name[name].identifier, released, name, cycle))
        _, released, name, cycle = heappop(waiting)
        ended = now + drawn.choice([by_name[name].shortest_ns, by_name[name].longest_ns])
        found.append((name, cycle, released, ended))
        now = ended + REST
        for each in slots:
            if each.after == name:
                heappush(coming, (ended + delayed(each), each.name, cycle))
    return found
