"""What counted clocks come to: arithmetic by hand, and periods tried on both sides."""

import pytest

from hil.constants import check_budget
from hil.errors import ScenarioError
from hil.i8086.cost import beside_newton_euler, by_clock, newton_euler
from hil.scenario import Scenario
from hil.scenario_file import load
from hil.timing.computing import with_clock

MACHINE_CODE = "joint.cpu=i8086"


def with_period(scenario: Scenario, period_ns: int) -> Scenario:
    return scenario.model_copy(update={"clock": scenario.clock.model_copy(update={"period_s": period_ns / 1e9})})


@pytest.mark.parametrize("name", ["paper-joint", "one-joint", "five-joints"])
def test_the_shortest_period_is_the_least_that_is_accepted(name: str) -> None:
    scenario = load(name, [MACHINE_CODE])
    for row in by_clock(scenario):
        timed = with_clock(scenario, row["clock_hz"])
        shortest_ns = round(row["shortest_period_s"]["bus"] * 1e9)
        check_budget(with_period(timed, shortest_ns))
        with pytest.raises(ScenarioError, match="the frames of one cycle need"):
            check_budget(with_period(timed, shortest_ns - 1))


def test_a_slower_bus_asks_for_a_longer_period() -> None:
    """With five Encoders in a row the bus never waits for a joint, so all of the cycle is bits."""
    fast, slow = (load("five-joints", [MACHINE_CODE, *more]) for more in ([], ["bus.bitrate=800000"]))
    (fast_s, slow_s) = (by_clock(each)[2]["shortest_period_s"]["bus"] for each in (fast, slow))
    assert slow_s == pytest.approx(fast_s * 1.25, rel=1e-9)


def test_times_at_every_clock_are_those_by_hand() -> None:
    """Of paper-joint, joint 1: 1128 clocks straight, 877 of them the step; 1512 over all paths."""
    rows = by_clock(load("paper-joint", [MACHINE_CODE]))
    assert [row["clock_hz"] for row in rows] == [5e6, 8e6, 10e6]
    assert [row["interrupt_s"] * 1e6 for row in rows] == pytest.approx([225.6, 141.0, 112.8])
    assert [row["step_s"][1] * 1e6 for row in rows] == pytest.approx([175.4, 109.625, 87.7])
    assert [row["bound_s"] * 1e6 for row in rows] == pytest.approx([302.4, 189.0, 151.2])
    assert [row["shortest_period_s"]["cpu"] for row in rows] == [row["bound_s"] for row in rows]
    assert [row["share"] for row in rows] == pytest.approx([0.2256, 0.141, 0.1128])


def test_inverse_dynamics_by_hand() -> None:
    """n = 3: 396 products of 145 clocks, 329 sums of 6: 59394; the step's own operations: 3 x 145 + 6 x 6 = 471.

    A step of 942 takes twice those, so the dynamics as steps do, too. n = 6: 792 and 662.
    """
    found = newton_euler(3, 145.0, 942.0)
    assert found == {
        "joints": 3,
        "multiplications": 396,
        "additions": 329,
        "floor_clocks": 59394.0,
        "clocks_as_the_step": 118788.0,
    }
    beside = beside_newton_euler(3, 145.0, 942.0)
    assert beside["step"] == {"multiplications": 3, "additions": 6, "floor_clocks": 471.0, "clocks": 942.0}
    assert beside["newton_euler"][0] == found
    six = beside["newton_euler"][1]
    assert (six["joints"], six["multiplications"], six["additions"]) == (6, 792, 662)
    assert six["floor_clocks"] == 792 * 145 + 662 * 6
    assert len(beside_newton_euler(6, 145.0, 942.0)["newton_euler"]) == 1
