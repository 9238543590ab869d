"""How fast virtual time may go: limits and waits, on a clock of the test's own."""

import itertools
import time
from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil import pace as pace_module
from hil.pace import Pace
from hil.wire.protocol import FAR_NS

SECOND_NS = 1_000_000_000


class Wall:
    """A wall clock that goes when told."""

    def __init__(self):
        self.now_s = 1000.0

    def monotonic(self):
        return self.now_s


@pytest.fixture
def wall(monkeypatch):
    wall = Wall()
    monkeypatch.setattr(pace_module, "time", wall)
    return wall


def test_without_a_limit_time_may_go_anywhere_at_once():
    pace = Pace()
    assert pace.unlimited
    assert not pace.paused
    assert pace.limit_ns(0) == FAR_NS
    assert pace.wait_s(0, FAR_NS) == 0.0


@pytest.mark.parametrize("rate", [0.25, 1.0, 3.0, 1e-6, 1e6])
@pytest.mark.parametrize("start_ns", [0, -200_000_000, 12_345])
def test_time_goes_at_its_rate_from_where_it_was_when_first_asked(wall, rate, start_ns):
    pace = Pace(rate)
    assert not pace.unlimited
    assert pace.limit_ns(start_ns) == start_ns
    for wall_s in (0.5, 1.0, 7.25):
        wall.now_s = 1000.0 + wall_s
        assert pace.limit_ns(start_ns + 1) == start_ns + round(wall_s * rate * SECOND_NS)


@pytest.mark.parametrize(("rate", "wait_s"), [(1.0, 0.5), (2.0, 0.25), (0.5, 1.0)])
def test_wait_is_in_wall_time(wall, rate, wait_s):
    pace = Pace(rate)
    pace.limit_ns(0)
    assert pace.wait_s(0, SECOND_NS // 2) == pytest.approx(wait_s)
    wall.now_s += wait_s / 2
    assert pace.wait_s(0, SECOND_NS // 2) == pytest.approx(wait_s / 2)
    wall.now_s += wait_s
    assert pace.wait_s(0, SECOND_NS // 2) == 0.0


@given(st.floats(1e-3, 1e3), st.lists(st.floats(0.0, 10.0), min_size=1, max_size=20))
def test_after_the_wait_the_instant_may_come_and_limits_never_go_back(rate, waits):
    """A nanosecond of rounding apart."""
    with pytest.MonkeyPatch.context() as patch:
        wall = Wall()
        patch.setattr(pace_module, "time", wall)
        pace, limits = Pace(rate), []
        for wait_s in waits:
            wall.now_s += wait_s
            limits.append(pace.limit_ns(0))
            due_ns = limits[-1] + SECOND_NS
            wall.now_s += pace.wait_s(limits[-1], due_ns)
            assert pace.limit_ns(0) >= due_ns - 1 - rate
        assert limits == sorted(limits)


def test_who_was_behind_catches_up_to_the_rate(wall):
    """The machine was too slow for a while: the anchor stays where it was."""
    pace = Pace(1.0)
    pace.limit_ns(0)
    wall.now_s += 3.0
    assert pace.limit_ns(SECOND_NS) == 3 * SECOND_NS


def test_another_rate_goes_on_from_here(wall):
    pace = Pace(1.0)
    pace.limit_ns(0)
    wall.now_s += 2.0
    pace.set(10.0)
    assert pace.rate == 10.0
    assert pace.limit_ns(2 * SECOND_NS) == 2 * SECOND_NS
    wall.now_s += 1.0
    assert pace.limit_ns(2 * SECOND_NS) == 12 * SECOND_NS
    pace.set(inf)
    assert pace.unlimited
    assert pace.limit_ns(12 * SECOND_NS) == FAR_NS


@pytest.mark.parametrize("rate", [inf, 1.0])
def test_while_paused_nothing_passes_but_what_is_granted(wall, rate):
    pace = Pace(rate)
    pace.limit_ns(0)
    pace.pause(500)
    wall.now_s += 60.0
    assert pace.paused
    assert pace.limit_ns(500) == 500
    assert pace.wait_s(500, 501) == inf
    assert pace.wait_s(500, 500) == 0.0
    pace.step(500, 1000)
    assert pace.paused
    assert pace.limit_ns(500) == 1500
    assert pace.wait_s(500, 1500) == 0.0
    assert pace.wait_s(500, 1501) == inf


def test_steps_add_up_before_and_after_they_have_passed():
    pace = Pace()
    pace.pause(0)
    pace.step(0, 10)
    pace.step(0, 10)
    assert pace.limit_ns(0) == 20
    pace.step(20, 5)
    assert pace.limit_ns(20) == 25


def test_step_pauses_what_was_running():
    pace = Pace()
    pace.step(100, 7)
    assert pace.paused
    assert pace.limit_ns(100) == 107


def test_pause_takes_back_what_was_granted():
    pace = Pace()
    pace.step(0, 1000)
    pace.pause(300)
    assert pace.limit_ns(300) == 300


def test_time_that_passed_while_paused_is_not_made_up_for(wall):
    pace = Pace(1.0)
    pace.limit_ns(0)
    wall.now_s += 1.0
    pace.pause(SECOND_NS)
    wall.now_s += 3600.0
    pace.resume()
    assert not pace.paused
    assert pace.limit_ns(SECOND_NS) == SECOND_NS
    wall.now_s += 0.5
    assert pace.limit_ns(SECOND_NS) == SECOND_NS + SECOND_NS // 2


def test_rate_set_while_paused_holds_behind_it(wall):
    pace = Pace(1.0)
    pace.pause(100)
    pace.set(2.0)
    assert pace.paused
    assert pace.limit_ns(100) == 100
    pace.resume()
    assert pace.limit_ns(100) == 100
    wall.now_s += 1.0
    assert pace.limit_ns(100) == 100 + 2 * SECOND_NS


def test_on_the_real_clock_limits_do_not_run_ahead():
    pace = Pace(1.0)
    began_s = time.monotonic()
    limits = [pace.limit_ns(0) for _ in range(1000)]
    assert limits[0] >= 0
    assert all(one <= other for one, other in itertools.pairwise(limits))
    assert limits[-1] <= (time.monotonic() - began_s) * 1e9 + 1
