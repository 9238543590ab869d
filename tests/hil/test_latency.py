"""Quantiles and histograms, against counting by hand."""

from bisect import bisect_right

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.latency import SMALLEST_S, distribution

values_s = st.lists(st.floats(1e-9, 1e3), min_size=1, max_size=300)


@settings(deadline=None)
@given(values_s)
def test_a_quantile_is_the_least_value_that_so_many_do_not_exceed(values: list[float]) -> None:
    found = distribution(values)
    assert found is not None
    for name, share in (("p50_s", 0.5), ("p99_s", 0.99), ("p99.9_s", 0.999)):
        ranked = sorted(values)
        assert found[name] in values
        assert sum(value <= found[name] for value in values) >= share * len(values) * (1 - 1e-12)
        below = bisect_right(ranked, found[name]) - ranked.count(found[name])
        assert below < share * len(values) * (1 + 1e-12)
    assert (found["min_s"], found["max_s"], found["count"]) == (min(values), max(values), len(values))


@settings(deadline=None)
@given(values_s)
def test_every_value_is_in_one_bin(values: list[float]) -> None:
    found = distribution(values)
    assert found is not None
    edges, counts = found["edges_s"], found["counts"]
    assert sum(counts) == len(values)
    assert len(edges) == len(counts) + 1
    for k, count in enumerate(counts):
        # a value on an edge may fall to either side of it by rounding
        inside = [v for v in values if edges[k] * (1 + 1e-9) < max(v, SMALLEST_S) < edges[k + 1] * (1 - 1e-9)]
        assert len(inside) <= count
    assert edges[-1] == pytest.approx(edges[0] * 10 ** (len(counts) / 10))


def test_nothing_was_measured() -> None:
    assert distribution([]) is None
