"""What `make bench` measures is the same everywhere: it would compare nothing otherwise. No speed is judged here."""

from pathlib import Path

import pytest

from hil.bench import scaling, timing
from hil.bench.clients import Case
from hil.bench.nodes import ACCELREF, ANSWERS, CURRENTS, ENCODERS, FRAMES_A_CYCLE, SYNC
from hil.bench.plot import write_plot
from hil.bench.wire import BUSES
from hil.timing.response_time import response_times, utilisation

CYCLES = 20
CYCLE = [SYNC, *ENCODERS, *CURRENTS, ACCELREF]


@pytest.mark.parametrize("name", [name for name in BUSES if name != "virtual, threads"])
def test_a_bus_that_arbitrates_carries_cycle_after_cycle(name: str) -> None:
    assert BUSES[name](CYCLES)[1] == CYCLE * CYCLES


def test_without_arbitration_the_phases_follow_each_other_all_the_same() -> None:
    order = BUSES["virtual, threads"](CYCLES)[1]
    cycles = [order[first : first + FRAMES_A_CYCLE] for first in range(0, len(order), FRAMES_A_CYCLE)]
    assert [sorted(cycle) for cycle in cycles] == [CYCLE] * CYCLES
    for cycle in cycles:
        assert (cycle[0], cycle[-1]) == (SYNC, ACCELREF)
        assert all(cycle.index(ENCODERS[n]) < cycle.index(CURRENTS[n]) for n in range(3))


def test_every_frame_is_sent_by_one_node() -> None:
    sent = [identifier for answers in ANSWERS.values() for each in answers.values() for identifier in each]
    assert sorted([*sent, SYNC]) == sorted(CYCLE)


@pytest.mark.parametrize("everyone", [False, True])
@pytest.mark.parametrize("kind", scaling.BATCHES)
def test_every_kind_of_client_can_be_measured(kind: str, everyone: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(scaling.BATCHES, kind, 5)
    assert scaling.cost_us(Case(kind, 3, everyone, 1.0)) > 0.0


def test_a_cost_in_proportion_to_those_that_accept_is_no_excess() -> None:
    costs = {case: 7.0 * case.acceptors for case in scaling.cases()}
    assert set(scaling.excesses(costs).values()) == {1.0}
    worst = Case("timed", scaling.CLIENTS[-1], True, scaling.USUAL_LOAD)
    assert scaling.excesses(costs | {worst: 3.0 * costs[worst]})[worst] == 3.0


def test_the_plot_is_a_png(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    write_plot({case: 7.0 * case.acceptors for case in scaling.cases()}, tmp_path / "new" / "scaling.png")
    assert (tmp_path / "new" / "scaling.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("load", timing.LOADS)
def test_the_analysis_is_measured_on_as_many_messages_as_it_says_at_the_load_that_it_says(load: float) -> None:
    """Bits of whole ns: within 1 % of the load. All have bounds, so that nothing was cut short."""
    messages, bit_ns = timing.drawn(load)
    assert len(messages) == 100
    assert float(utilisation(messages)) == pytest.approx(load, rel=0.01)
    assert all(each.bound_ns is not None for each in response_times(messages, bit_ns))
