"""Points: grids against nested loops, strata of the hypercube, quantiles against scipy's distributions, the seed."""

from math import ceil, floor, log

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from hil.errors import ScenarioError
from hil.sweep import sampling
from hil.sweep.sampling import points, quantile
from hil.sweep.sweep_file import Normal, Range, SweepFile

G, E = "joint.g_rad_s", "encoder.counts_per_turn"


def sweep(method, vary, name="a", **keys):
    return {"name": name, "method": method, "vary": vary, **keys}


def points_of(*sweeps, seed=1):
    return points(SweepFile.model_validate({"seed": seed, "scenario": {}, "sweep": sweeps}))


def column(found, path):
    return [point.values[path] for point in found]


def test_a_grid_is_a_nested_loop_whose_last_path_runs_fastest():
    found = points_of(sweep("grid", {G: [1, 2, 3], "joint.observer": [True, False]}))
    expected = []
    for g in (1, 2, 3):
        for observer in (True, False):
            expected.append({G: g, "joint.observer": observer})
    assert [point.values for point in found] == expected
    assert [point.index for point in found] == list(range(6))


def test_a_list_goes_through_its_columns_together():
    found = points_of(sweep("list", {G: [1, 2, 3], "drive.lag_s": {"from": 0.1, "to": 0.3, "steps": 3}}))
    assert [tuple(point.values.values()) for point in found] == [(1, 0.1), (2, pytest.approx(0.2)), (3, 0.3)]


@given(st.floats(1e-3, 1e3), st.floats(1e-3, 1e3), st.integers(2, 40), st.booleans())
def test_a_range_has_both_ends_and_equal_steps(low, high, steps, in_log):
    """Against numpy's own; 1e-12: a handful of roundings."""
    found = column(points_of(sweep("grid", {G: {"from": low, "to": high, "steps": steps, "log": in_log}})), G)
    assert (found[0], found[-1], len(found)) == (low, high, steps)
    assert found == pytest.approx((np.geomspace if in_log else np.linspace)(low, high, steps), rel=1e-12)


@given(st.integers(1, 300), st.integers(0, 2**63 - 1))
def test_a_latin_hypercube_has_one_sample_in_each_stratum_of_every_path(samples, seed):
    vary = {G: {"from": 0.0, "to": 1.0}, "drive.lag_s": {"from": 0.0, "to": 1.0}}
    found = points_of(sweep("latin-hypercube", vary, samples=samples), seed=seed)
    for path in vary:
        # the strata by their edges, not by a product, which may round up
        edges = np.arange(samples + 1) / samples
        assert sorted(np.searchsorted(edges, column(found, path), "right") - 1) == list(range(samples))


def test_the_paths_of_a_hypercube_are_in_orders_of_their_own():
    """Spearman's correlation of 400 random orders is within 5 / sqrt(400) of none; in one order it would be 1."""
    vary = {G: {"from": 0.0, "to": 1.0}, "drive.lag_s": {"from": 0.0, "to": 1.0}}
    found = points_of(sweep("latin-hypercube", vary, samples=400))
    assert abs(stats.spearmanr(column(found, G), column(found, "drive.lag_s")).statistic) < 0.25


@pytest.mark.parametrize("method", ["latin-hypercube", "monte-carlo"])
@pytest.mark.parametrize(
    ("values", "distribution"),
    [
        ({"from": 2.0, "to": 5.0}, stats.uniform(2.0, 3.0)),
        ({"from": 1.0, "to": 100.0, "log": True}, stats.loguniform(1.0, 100.0)),
        ({"normal": [3.0, 0.5]}, stats.norm(3.0, 0.5)),
    ],
)
def test_samples_have_the_distribution_that_is_asked_for(method, values, distribution):
    """Kolmogorov and Smirnov: a fixed seed, p far from 0; another distribution of these gives 1e-10 or less."""
    found = column(points_of(sweep(method, {G: values}, samples=1000)), G)
    assert stats.kstest(found, distribution.cdf).pvalue > 0.05


@given(st.integers(0, 2**53 - 1).map(lambda drawn: drawn * 2.0**-53), st.floats(-10, 10), st.floats(1e-3, 10))
def test_quantiles_are_scipys(share, mean, deviation):
    """1e-9: NormalDist follows Wichura's AS241, of relative error 1e-16, and scipy Cephes."""
    if share:
        expected = stats.norm(mean, deviation).ppf(share)
        assert quantile(Normal(normal=(mean, deviation)), share) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert np.isfinite(quantile(Normal(normal=(mean, deviation)), share))
    high = mean + deviation
    assert quantile(Range(**{"from": mean, "to": high}), share) == pytest.approx(
        stats.uniform(mean, deviation).ppf(share), rel=1e-9, abs=1e-9
    )


def test_choices_come_equally_often_in_a_hypercube():
    found = column(points_of(sweep("latin-hypercube", {G: [1, 2, 3]}, samples=30)), G)
    assert [found.count(choice) for choice in (1, 2, 3)] == [10, 10, 10]


def test_whole_numbers_are_rounded_where_a_path_takes_no_others():
    found = points_of(
        sweep("latin-hypercube", {E: {"from": 1000, "to": 9000, "log": True}, G: {"from": 1, "to": 9}}, samples=20)
    )
    assert all(isinstance(value, int) for value in column(found, E))
    assert all(isinstance(value, float) for value in column(found, G))
    # one in each twentieth of the logarithm: log(9) / 20 apart at most twice
    assert max(np.diff(np.log(sorted(column(found, E))))) < 2.2 * log(9) / 20


def test_the_seed_the_name_and_the_path_draw_and_nothing_else():
    vary = {G: {"from": 0.0, "to": 1.0}}
    first = column(points_of(sweep("monte-carlo", vary, samples=20)), G)
    more = points_of(sweep("monte-carlo", {"drive.lag_s": {"from": 0, "to": 1}} | vary, samples=20))
    assert column(more, G) == first
    assert column(more, "drive.lag_s") != first
    assert column(points_of(sweep("monte-carlo", vary, samples=20), seed=2), G) != first
    assert column(points_of(sweep("monte-carlo", vary, samples=20, name="b")), G) != first


def test_the_drawn_numbers_are_these():
    """Of PCG64 by numpy's SeedSequence, so that a table of today can be made again: floor of 1000 u."""
    found = column(points_of(sweep("monte-carlo", {G: {"from": 0.0, "to": 1000.0}}, samples=4)), G)
    stream = np.random.Generator(np.random.PCG64([1, *f"a {G}".encode()]))
    assert [floor(value) for value in found] == [floor(1000 * stream.random()) for _ in range(4)]


def test_a_sum_that_rounds_up_stays_in_its_stratum():
    class Last:
        """Draws the numbers just below 1."""

        def random(self, count):
            return np.full(count, np.nextafter(1.0, 0.0))

    count = 100_000
    found = sampling.latin(Last(), count)
    edges = np.arange(count + 1) / count
    assert np.array_equal(np.searchsorted(edges, found, "right") - 1, np.arange(count))
    assert max(found) < 1.0
    assert ceil(max(found)) == 1


def test_too_many_points_are_refused_before_any_is_made(monkeypatch):
    with pytest.raises(ScenarioError, match=r"sweep a: a grid of 1000 x 1000 x 1000 points is beyond 1000000"):
        points_of(sweep("grid", {path: list(range(1000)) for path in (G, E, "drive.lag_s")}))
    monkeypatch.setattr(sampling, "MOST_POINTS", 10)
    with pytest.raises(ScenarioError, match=r"sweep b: beyond 10 points"):
        points_of(sweep("list", {G: list(range(10))}), sweep("list", {G: [1]}, name="b"))


def test_lists_of_different_lengths_are_refused():
    with pytest.raises(ScenarioError, match=rf"sweep a: lists of different lengths \({G}: 2, {E}: 3\)"):
        points_of(sweep("list", {G: [1, 2], E: [1, 2, 3]}))


@pytest.mark.parametrize("part", ["vary", "set"])
def test_an_unknown_path_suggests_the_nearest(part):
    keys = {"vary": {G: [1]}, "set": {}}
    keys[part] = {"joint.g_rads": [1]}
    with pytest.raises(ScenarioError, match=r"sweep a: unknown path 'joint.g_rads': did you mean joint.g_rad_s\?"):
        points_of({"name": "a", "method": "grid", **keys})
