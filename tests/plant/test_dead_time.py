"""Dead time: its length, the law of its jitter, the order of the currents."""

from math import sqrt

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from plant.dead_time import DeadTime

T_NS = 1_000_000


def delays(dead_time, index, cycles):
    """Return how long the current of each cycle waits that arrives as the cycle begins."""
    return [dead_time.applied_ns(index, k, k * T_NS) - k * T_NS for k in cycles]


def test_without_jitter_every_current_waits_as_long():
    dead_time = DeadTime((0, 2_345_678), (0, 0))
    assert delays(dead_time, 0, range(-3, 50)) == [0] * 53
    assert delays(dead_time, 1, range(-3, 50)) == [2_345_678] * 53


def test_jitter_is_uniform_from_the_dead_time_on():
    """Of 20000 draws: mean and standard deviation of a uniform law, within five standard errors of each."""
    dead_ns, width_ns, draws = 100_000, 400_000, 20_000
    found = np.array(delays(DeadTime((dead_ns,), (width_ns,), 7), 0, range(draws)))
    assert dead_ns <= found.min() < dead_ns + 0.001 * width_ns
    assert dead_ns + 0.999 * width_ns < found.max() <= dead_ns + width_ns
    spread = width_ns / sqrt(12)
    assert abs(found.mean() - dead_ns - width_ns / 2) < 5 * spread / sqrt(draws)
    assert abs(found.std() - spread) < 5 * spread * sqrt(0.2 / draws)  # kurtosis 1.8
    assert abs(np.corrcoef(found[1:], found[:-1])[0, 1]) < 5 / sqrt(draws)


def test_jitter_hangs_on_seed_joint_and_cycle_only():
    plain = delays(DeadTime((0, 0), (300_000, 300_000), 1), 0, range(40))
    other_joint_too = DeadTime((0, 0), (300_000, 300_000), 1)
    delays(other_joint_too, 1, range(20))
    assert delays(other_joint_too, 0, range(40)) == plain
    some_lost = [k for k in range(40) if k % 3]
    assert delays(DeadTime((0,), (300_000,), 1), 0, some_lost) == [plain[k] for k in some_lost]
    heard_twice = DeadTime((0,), (300_000,), 1)
    assert delays(heard_twice, 0, [k for k in range(40) for _ in (0, 1)]) == [delay for delay in plain for _ in (0, 1)]
    assert delays(DeadTime((0,), (300_000,), 2), 0, range(40)) != plain
    assert delays(DeadTime((0, 0), (300_000, 300_000), 1), 1, range(40)) != plain


def test_currents_that_come_close_behind_each_other_keep_their_order():
    """At the end of one cycle and the beginning of the next, 1 ns apart: half of the pairs would change places."""
    dead_time = DeadTime((100_000,), (500_000,), 3)
    came = [at_ns for k in range(0, 60, 2) for at_ns in ((k + 1) * T_NS - 1, (k + 1) * T_NS)]
    applied = [dead_time.applied_ns(0, k, at_ns) for k, at_ns in enumerate(came)]
    assert applied == sorted(applied)
    assert 5 < sum(one == other for one, other in zip(applied[::2], applied[1::2], strict=True)) < 25


@given(
    st.integers(0, 3 * T_NS),
    st.integers(0, T_NS),
    st.lists(st.integers(0, T_NS), min_size=1, max_size=20),
    st.integers(0, 2**32),
)
def test_no_current_overtakes_the_one_before(dead_ns, width_ns, arrivals, seed):
    """Whatever the instants within their cycles at which they come."""
    dead_time = DeadTime((dead_ns,), (width_ns,), seed)
    came = [k * T_NS + within_ns for k, within_ns in enumerate(arrivals)]
    applied = [dead_time.applied_ns(0, k, at_ns) for k, at_ns in enumerate(came)]
    assert applied == sorted(applied)
    assert all(at_ns + dead_ns <= acts_ns for at_ns, acts_ns in zip(came, applied, strict=True))
    assert all(
        acts_ns <= max(at_ns + dead_ns + width_ns, before_ns)
        for at_ns, acts_ns, before_ns in zip(came, applied, [0, *applied], strict=False)
    )
