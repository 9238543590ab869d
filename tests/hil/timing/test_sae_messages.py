"""The 17 messages that Tindell and Burns made of the SAE benchmark, against the recurrence that they are known by.

Ref: K. Tindell, A. Burns, "Guaranteeing message latencies on Control Area Network (CAN)", 1st ICC (1994). The set is as
an exercise hands it on, without jitter (National Taiwan University, CSIE5452, homework 1, input.dat, kept in
github.com/youxin1231/NTU-IV22-Fall): 17 messages by priority, transmission time and period in ms, at 125 kbit/s.
"""

import math

import pytest

from hil.timing.response_time import Message, response_times, utilisation
from hil.wire.bits import INTERMISSION_BITS, worst_case_bits
from tests.hil.timing.naive_bus import longest_responses

MS = 1_000_000
BIT_NS = 8_000
SET = [
    *[(0.52, 50), (0.60, 5), (0.52, 5), (0.60, 5), (0.52, 5), (0.60, 5), (0.92, 10), (0.52, 10), (0.60, 10)],
    *[(0.68, 10), (0.52, 50), (0.76, 100), (0.52, 100), (0.52, 100), (0.68, 1000), (0.52, 1000), (0.52, 1000)],
]
LENGTHS = {0.52: 1, 0.60: 2, 0.68: 3, 0.76: 4, 0.92: 6}


def messages() -> list[Message]:
    found = []
    for k, (time_ms, period_ms) in enumerate(SET):
        bits = worst_case_bits(LENGTHS[time_ms]) + INTERMISSION_BITS
        found.append(Message(f"m{k}", 0x100 + k, period_ms * MS, period_ms * MS, bits * BIT_NS))
    return found


def recurrence_of_1994(rank: int) -> float:
    """Return the response time in ms of the first instance, by floats: w = B + sum of ceil((w + bit) / T) C."""
    blocking = max((time for time, _ in SET[rank + 1 :]), default=0.0)
    wait = 0.0
    while True:
        longer = blocking + sum(math.ceil((wait + BIT_NS / MS) / period) * time for time, period in SET[:rank])
        if longer == wait:
            return wait + SET[rank][0]
        wait = longer


def test_lengths_are_those_of_the_set() -> None:
    """8 n + 47 bits and one more behind every fourth of 34 + 8 n - 1, of 8 us each, intermission included."""
    for message, (time_ms, _) in zip(messages(), SET, strict=True):
        length = LENGTHS[time_ms]
        assert message.time_ns == round(time_ms * MS) == (8 * length + 47 + (34 + 8 * length - 1) // 4) * BIT_NS
    assert float(utilisation(messages())) == pytest.approx(sum(time / period for time, period in SET))


@pytest.mark.parametrize("rank", range(len(SET)))
def test_bounds_are_those_of_the_recurrence(rank: int) -> None:
    """No second instance of these is worse than the first, so what was said in 1994 is right of them.

    Floats of ms: 1e-9 ms is far below a bit. The critical instant on a naive bus comes to the same, less 1 ns.
    """
    response = response_times(messages(), BIT_NS)[rank]
    assert response.bound_ns is not None
    assert response.bound_ns / MS == pytest.approx(recurrence_of_1994(rank), abs=1e-9)
    times = [each.time_ns for each in messages()]
    releases = [(at, at, k) for k in range(rank + 1) for at in range(1, 200 * MS, SET[k][1] * MS)]
    below = range(rank + 1, len(SET))
    if below:
        releases.append((0, 0, max(below, key=times.__getitem__)))
    assert longest_responses(releases, times)[rank] == response.bound_ns - bool(below)
