"""Computing times by documented clocks: arithmetic that can be done by hand. No speed of the host is judged."""

import json
from io import StringIO

import pytest
from rich.console import Console

from hil import scenario_file
from hil.constants import worst_case_ends_ns
from hil.scenario import Scenario
from hil.timed import time_nodes
from hil.timing.computing import at_clock, computing, show_computing, with_clock

BY_HAND = {
    5e6: ((148.4, 175.4), 200.0, 0.2, (469, 584, 699)),
    8e6: ((92.75, 109.625), 125.0, 0.125, (462, 577, 692)),
    10e6: ((74.2, 87.7), 100.0, 0.1, (462, 577, 692)),
}
"""Of paper-joint. us: step of 742 to 877 clocks (joints 3, 1), interrupt of 1000, its share, ends of the Currents.

Encoders 1 to 3 end at 157, 252, 347 us, and the bus is free at 350 (65 bits Sync, 95 an Encoder, 3 of intermission in
each). At 5 MHz Current_1 is queued at 357; faster, before 350. It takes 112 bits, the next begin 3 later.
"""


@pytest.mark.parametrize("clock_hz", BY_HAND)
def test_times_shares_and_ends_are_those_by_hand(clock_hz: float) -> None:
    step_us, interrupt_us, share, ends_us = BY_HAND[clock_hz]
    found = at_clock(scenario_file.load("paper-joint"), clock_hz)
    assert [step_s * 1e6 for step_s in found["step_s"]] == pytest.approx(step_us)
    assert found["interrupt_s"] * 1e6 == pytest.approx(interrupt_us)
    assert found["share"] == pytest.approx(share)
    assert [end_s * 1e6 for end_s in found["current_end_s"].values()] == pytest.approx(ends_us)
    assert found["fits"]


def test_too_many_clocks_do_not_fit_and_one_joint_s_are_enough() -> None:
    """2000 clocks at 5 MHz: Current_3 is queued at 347 + 400, ends at 859, and State, behind it, by 994.

    With 2500 it ends at 959, and State by 1094.
    """
    slow = at_clock(scenario_file.load("paper-joint", ["joint3.clock_hz=8e6", "joint3.clocks=2000"]), 5e6)
    assert (slow["interrupt_s"], slow["fits"]) == (pytest.approx(400e-6), True)
    assert slow["current_end_s"]["joint3"] == pytest.approx(859e-6)
    slower = at_clock(scenario_file.load("paper-joint", ["joint3.clock_hz=10e6", "joint3.clocks=2500"]), 5e6)
    assert (slower["fits"], slower["current_end_s"]["joint3"]) == (False, None)
    own_timer = scenario_file.load("one-joint", ["joint.crystal_ppm=1", "joint.clock_hz=100e6", "joint.clocks=5001"])
    never = at_clock(own_timer, 5e6)
    assert (never["share"], never["fits"]) == (pytest.approx(1.0002), False)


def test_a_joint_of_machine_code_declares_the_most_while_nothing_saturates() -> None:
    """Joint 1, of shift 13: 1128 clocks (docs/cpu.md); joint 3, of shift 15, two rounds of 24 fewer."""
    alone = at_clock(
        scenario_file.load("paper-joint", ["joint3.cpu=i8086", "joint1.clocks=100", "joint2.clocks=100"]), 8e6
    )
    assert alone["interrupt_s"] * 8e6 == pytest.approx(1128 - 2 * 24)
    every = at_clock(scenario_file.load("paper-joint", ["joint.cpu=i8086"]), 8e6)
    assert every["interrupt_s"] * 8e6 == pytest.approx(1128)


def test_the_clock_is_that_of_the_scenario_s_keys() -> None:
    given = scenario_file.load("paper-joint", ["joint.compute_s=0.00003", "joint2.compute_s=0.00001"])
    asked = scenario_file.load("paper-joint", ["joint.clock_hz=5e6"])
    assert worst_case_ends_ns(with_clock(given, 5e6)) == worst_case_ends_ns(asked)


def test_no_end_is_promised_to_a_joint_by_its_own_timer() -> None:
    """Nor, in `drift`, to joint 3, which two of them may hold up."""
    found = at_clock(scenario_file.load("drift"), 8e6)
    assert found["current_end_s"] == {"joint1": None, "joint2": None, "joint3": None}
    assert not found["fits"]
    slow = scenario_file.load("two-joints", ["clock.period_s=0.002", "joint.g_rad_s=300", "joint1.crystal_ppm=100"])
    ends = at_clock(slow, 8e6)["current_end_s"]
    assert ends["joint1"] is None
    assert 0.001 > ends["joint2"] > 0.0005


def test_every_wake_up_is_timed(short: Scenario) -> None:
    """The plant and the joints wake once a cycle, the DSP for Sync and for the last Encoder; 60 cycles of set-up."""
    wakes_s, total_s = time_nodes(short)
    assert {name: len(each) for name, each in wakes_s.items()} == {
        "plant": 260,
        "dsp": 520,
        "joint1": 260,
        "joint2": 260,
        "joint3": 260,
    }
    assert sum(map(sum, wakes_s.values())) <= total_s


def test_the_tables_say_what_is_documented_and_what_is_measured(short: Scenario) -> None:
    found = computing(short)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert [row["clock_hz"] for row in found["clocks"]] == [5e6, 8e6, 10e6]
    out = StringIO()
    console = Console(width=80, file=out)
    show_computing(console, found)
    text = out.getvalue()
    assert "1000 clocks an interrupt; clocks are documented sums, IMUL's fitted to captures" in text
    for cells in (("5", "148.4 to 175.4", "200.0", "20.0%"), ("8", "462", "577", "692", "fits")):
        assert any([cell.strip() for cell in line.strip("│").split("│")] == list(cells) for line in text.splitlines())
    for name, wakes in found["host"].items():
        assert f"{wakes['max_s'] * 1e6:.1f}" in text
        assert name in text


def test_a_cycle_that_is_too_long_is_said() -> None:
    scenario = scenario_file.load("paper-joint", ["joint.clock_hz=20e6", "joint.clocks=3000", "duration_s=0.05"])
    out = StringIO()
    console = Console(width=80, file=out)
    show_computing(console, computing(scenario))
    assert "TOO LONG" in out.getvalue()
