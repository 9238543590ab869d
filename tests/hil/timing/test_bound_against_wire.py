"""Bounds against what the bus of the project does: 200 random message sets at 30 to 95 % load; critical instants."""

import pytest

from hil.timing.queues import queues
from hil.timing.response_time import Message, response_times
from hil.wire.bits import INTERMISSION_BITS, frame_bits
from tests.hil.timing.wire_sets import MS, QUEUES, Release, figures, longest_on_wire, within

BIT_NS = 1000
DATA = b"\x55" * 8


@pytest.mark.parametrize("kind", QUEUES)
def test_no_response_on_the_wire_is_longer_than_its_bound(kind: str) -> None:
    """Random offsets, jitter and data against bounds of the longest frames, in queues as deep as they may get.

    Then the critical instant of each message, all its frames alike, against bounds of their own length: what is missing
    there is the 1 ns by which the frame below comes first. Where three FIFO delay each other, the worst of all cannot
    come at once: half of the bound shows that it is none of another order.
    """
    found = figures(kind)
    assert found["bounds"] > 1500, found
    assert found["largest"] <= 1, found
    assert found["forced largest"] <= 1, found
    assert found["forced median"] >= (0.95 if kind != "three FIFO nodes" else 0.5), found


def test_neither_is_one_of_a_message_that_two_nodes_send() -> None:
    """Each instance by either of them, in a FIFO or by priority."""
    runs = [within(seed, 3, 2, shared=True) for seed in range(100)]
    ratios = [each for run, _ in runs for each in run]
    assert len(ratios) > 500
    assert max(ratios) <= 1


def time_ns(identifier: int) -> int:
    return (frame_bits(identifier, DATA) + INTERMISSION_BITS) * BIT_NS


def test_a_frame_that_waited_in_a_fifo_comes_closer_to_the_next_one_than_its_period() -> None:
    """High waits behind Low, which waits for three others; it goes to the bus as the next High is queued behind it.

    Between both there is no room for Middle, which counts one High in so short a time if it is told of no FIFO.
    """
    high, middle, others, low = 0x100, 0x200, (0x300, 0x301, 0x302), 0x400
    period_ns = sum(time_ns(each) for each in (*others, low))
    queued_ns = sum(time_ns(each) for each in others) + 1
    plan = {
        "fifo": [Release(0, 0, low, DATA), *(Release(at_ns, at_ns, high, DATA) for at_ns in (0, period_ns))],
        "other": [Release(0, 0, each, DATA) for each in others],
        "middle": [Release(queued_ns, queued_ns, middle, DATA)],
    }
    fifo = frozenset({"fifo"})
    senders = dict.fromkeys((high, low), "fifo") | dict.fromkeys(others, "other") | {middle: "middle"}
    periods = dict.fromkeys(senders, 100 * MS) | {high: period_ns}
    messages = [
        Message(hex(each), each, periods[each], 100 * MS, time_ns(each), senders=frozenset({sender}))
        for each, sender in senders.items()
    ]
    took_ns = longest_on_wire(plan, fifo, BIT_NS)[middle]
    by_priority, first_in_first_out = (response_times(messages, BIT_NS, fifo=nodes)[1] for nodes in ((), fifo))
    assert took_ns == time_ns(low) - 1 + 2 * time_ns(high) + time_ns(middle)
    assert by_priority.bound_ns == time_ns(low) + time_ns(high) + time_ns(middle)
    assert by_priority.bound_ns < took_ns <= (first_in_first_out.bound_ns or 0)


def test_a_queue_of_one_place_less_than_is_asked_for_overflows() -> None:
    """Three frames of a node are queued while another's is on the wire."""
    identifiers = (0x100, 0x101, 0x102)
    messages = [
        Message(hex(each), each, 100 * MS, 100 * MS, time_ns(each), senders=frozenset({"a"})) for each in identifiers
    ]
    last = Message("last", 0x700, 100 * MS, 100 * MS, time_ns(0x700), senders=frozenset({"b"}))
    found = queues(response_times([*messages, last], BIT_NS), 2)
    assert found == [
        {"node": "a", "frames_at_most": 3, "depth": 2, "holds": False},
        {"node": "b", "frames_at_most": 1, "depth": 2, "holds": True},
    ]
    plan = {"a": [Release(1, 1, each, DATA) for each in identifiers], "b": [Release(0, 0, 0x700, DATA)]}
    longest_on_wire(plan, frozenset(), BIT_NS, {"a": 3})
    with pytest.raises(AssertionError, match=r"lost: .*queue full"):
        longest_on_wire(plan, frozenset(), BIT_NS, {"a": 2})
