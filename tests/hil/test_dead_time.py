"""Dead time in the rig: both fidelities, every way to run, the same frames; nothing changes without it."""

from typing import Any

import numpy as np
import pytest

from hil import scenario_file
from hil.evaluate import recorded_truth
from hil.paper.frequency_response import action_instants, mean_delays
from hil.processes import run_processes
from hil.rig import run_inline
from hil.scenario import Scenario
from tests.hil.clockwork import Clockwork
from tests.hil.test_sync_drive import Ether, payloads
from tests.hil.test_wall_drive import data_of

DEAD = ("drive.dead_time_s=[0.0002, 0.0, 0.0015]", "drive.dead_time_jitter_s=[0.0001, 0.0002, 0.0]")


def load(*settings: str) -> Scenario:
    return scenario_file.load("paper-joint", ["duration_s=0.3", "trajectory.time_s=0.2", *settings])


def frames(scenario: Scenario) -> Any:
    return run_inline(scenario).log.frames


@pytest.mark.parametrize("fidelity", ["bits", "functional"])
def test_it_changes_what_the_arm_does_and_a_dead_time_of_zero_does_not(fidelity: str) -> None:
    plain = frames(load(f"bus.fidelity={fidelity}"))
    assert frames(load(f"bus.fidelity={fidelity}", "drive.dead_time_s=[0.0, 0.0, 0.0]", "drive.seed=5")) == plain
    assert frames(load(f"bus.fidelity={fidelity}", *DEAD)) != plain


def test_under_functional_it_is_a_longer_action_delay() -> None:
    """To the byte: 400 us and 100 us of dead time is an action delay of 500 us."""
    both = load("bus.fidelity=functional", "bus.action_delay_s=[4e-4,4e-4,4e-4]", "drive.dead_time_s=[1e-4,2e-4,0.0]")
    alone = load("bus.fidelity=functional", "bus.action_delay_s=[5e-4,6e-4,4e-4]")
    assert frames(both) == frames(alone)
    assert mean_delays(run_inline(both)) == pytest.approx([5e-4, 6e-4, 4e-4], abs=1e-12)


def test_the_seed_chooses_the_jitter() -> None:
    first, same, other = (frames(load(*DEAD, f"drive.seed={seed}")) for seed in (1, 1, 2))
    assert first == same
    assert first != other


@pytest.mark.parametrize("fidelity", ["bits", "functional"])
def test_processes_make_the_same_frames(fidelity: str) -> None:
    scenario = load(f"bus.fidelity={fidelity}", *DEAD)
    assert run_processes(scenario, "arm").log.frames == frames(scenario)


def test_by_sync_and_by_the_clock_the_payloads_are_those_of_functional() -> None:
    scenario = load("bus.fidelity=functional", *DEAD)
    expected = frames(scenario)
    assert Ether(scenario).run() == payloads(expected)
    machine = Clockwork(load("bus.fidelity=functional", "clock.kind=wall", *DEAD))
    machine.run(60.0)
    assert data_of(machine.witness.log.frames) == data_of(expected)


def test_no_dead_time_is_lateness() -> None:
    reports = run_inline(load("drive.dead_time_s=[0.003, 0.003, 0.003]", "joint.g_rad_s=100")).reports
    plant = reports["plant"]
    assert (plant["late_currents"], plant["overdue_currents"], set(plant["missed_currents"].values())) == (0, 0, {0})


def test_the_plant_applies_each_current_at_its_action_instant() -> None:
    """What the amplifier holds at kT is the last reference whose instant is past: by the frames, and by the truth."""
    outcome = run_inline(load(*DEAD))
    instants, current_A = action_instants(outcome), recorded_truth(outcome)["current_A"]
    references = {
        (n, end_ns // 1_000_000): int.from_bytes(data[:2], "little", signed=True) / 2048
        for end_ns, identifier, data, _ in outcome.log.frames
        if end_ns >= 0 and 1 <= (n := identifier - 0x120) <= 3
    }
    for n in (1, 2, 3):
        for k in range(5, 300):
            acted = int(np.flatnonzero(instants[:, n - 1] <= k * 1e-3)[-1])
            assert current_A[k, n - 1] == references[n, acted]
