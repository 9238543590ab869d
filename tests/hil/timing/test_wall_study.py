"""What a run by the clock says of responses and misses, on a machine that is repeatable."""

from typing import Any

import pytest

from hil.rig import Outcome
from hil.timing.wall_study import wall_study
from tests.hil.clockwork import BUS_NS, WORK_NS, Clockwork
from tests.hil.test_wall_drive import MS, load, ran

CYCLES = 200


def studied(machine: Clockwork) -> dict[str, Any]:
    scenario, witness = machine.scenario, machine.witness
    outcome = Outcome(scenario, "wall", witness.log, {}, 0, 0.0, 0.0, {}, clock=witness.figures())
    return wall_study(outcome, data_bit_ns=250)


def misses(machine: Clockwork) -> list[dict[str, int]]:
    return [chain["misses"] for chain in studied(machine)["chains"][:3]]


def test_an_answer_takes_what_its_process_and_the_bus_take() -> None:
    """The machine's DSP sends what joints answer to Encoders one behind the other; joint 1 has work, then the bus."""
    rows = {row["name"]: row for row in studied(ran(load()))["messages"]}
    current = rows["Current_1"]
    assert current["response"]["count"] == CYCLES
    assert current["response"]["p50_s"] == pytest.approx((WORK_NS["joint1"] + BUS_NS) * 1e-9)
    assert current["response_bound_s"] == pytest.approx(125e-6 + 209e-6)
    assert current["max_to_bound"] == pytest.approx(current["response_max_s"] / current["response_bound_s"])
    assert rows["State_0"]["response_bound_s"] == pytest.approx(135e-6)  # it answers nothing, and is not measured
    assert (rows["State_0"]["response"], rows["State_0"]["response_max_s"]) == (None, None)


def test_on_time_nothing_is_missed() -> None:
    assert misses(ran(load())) == [{"bus": 0, "computing": 0, "drive": 0, "host": 0}] * 3


def test_a_process_that_freezes_is_the_host_s_and_a_board_that_does_its_own() -> None:
    frozen = {"joint2": [(50 * MS, 50 * MS + 1_500_000)]}
    nothing = {"bus": 0, "computing": 0, "drive": 0, "host": 0}
    assert misses(ran(load(), frozen=frozen)) == [nothing, nothing | {"host": 1}, nothing]
    assert misses(ran(load(), frozen=frozen, external=("joint2",))) == [nothing, nothing | {"computing": 1}, nothing]


def test_a_frame_that_an_error_has_cost_is_the_bus_s() -> None:
    lost: list[int] = []

    def lose(identifier: int, data: bytes) -> bool:
        hit = identifier == 0x123 and data[4] == 100 and not lost and machine.began_ns is not None
        lost.extend([1] * hit)
        return hit

    machine = Clockwork(load(), lose=lose, errors=lambda: len(lost))
    machine.run(60.0)
    assert misses(machine) == [{"bus": 0, "computing": 0, "drive": 0, "host": 0}] * 2 + [
        {"bus": 1, "computing": 0, "drive": 0, "host": 0}
    ]


def test_cycles_that_are_skipped_are_the_host_s() -> None:
    """Sync 61 would be more than a period late when the DSP wakes, and is left out; Sync 62 is half of one late."""
    found = misses(ran(load(), frozen={"dsp": [(60 * MS, 62 * MS + 500_000)]}))
    assert found == [{"bus": 0, "computing": 0, "drive": 0, "host": 1}] * 3
