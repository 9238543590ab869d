"""The same closed loop with the arm computed in two ways; arms that one of them cannot carry."""

from functools import cache

import numpy as np
import pytest

from hil import backends, scenario_file
from hil.assemble import build_nodes
from hil.backends import BackendComparison, compare_backends
from hil.errors import ScenarioError
from hil.processes import run_processes
from hil.rig import run_inline

PYMUNK = "plant.backend=pymunk"
SHORT = "duration_s=0.1"


@cache
def compared(*settings: str) -> BackendComparison:
    return compare_backends(scenario_file.load("direct-drive", settings))


def test_encoder_frames_of_direct_drive_differ_by_one_count_at_most() -> None:
    found = compared()
    assert found.cycles == 1500
    assert found.counts.size <= 1
    assert found.beyond is None
    assert found.angle.size <= 8e-6  # a count is 7.7e-6 rad


def test_an_open_loop_stays_closer_than_a_count_can_show() -> None:
    """Without currents the arm falls the same way in both, within pymunk's own error."""
    found = compared("duration_s=0.3", "drive.limit_A=1e-4", "joint.observer=false")
    assert found.counts.size <= 1
    assert found.angle.size <= 1e-6


REFUSED = {
    ("paper-joint", PYMUNK): r"plant.backend = 'pymunk': rotor inertia of joint 2: 0\.5 kg m\^2, but pymunk takes 0",
    ("direct-drive", "arm.coulomb_N_m=[0.0, 0.0, 0.4]"): r"Coulomb friction of joint 3: 0\.4 N m, .* take the backend",
    ("direct-drive", "drive.lag_s=0.001"): r"amplifier lag: 0\.001 s, but pymunk takes 0",
    ("direct-drive", "arm.viscosity_N_m_s=[0.0, 0.0, 5.0]"): r"viscosity of joint 3: 5 N m s, but pymunk takes at most",
    ("direct-drive", "plant.backend=bullet"): r"plant.backend = 'bullet': Input should be 'closed' or 'pymunk'",
    ("direct-drive", "plant.backed=pymunk"): r"unknown key plant.backed: did you mean plant.backend\?",
}


@pytest.mark.parametrize(("name", "setting"), REFUSED)
def test_an_arm_that_a_backend_cannot_carry_is_refused(name: str, setting: str) -> None:
    with pytest.raises(ScenarioError, match=REFUSED[name, setting]):
        build_nodes(scenario_file.load(name, [PYMUNK, setting]))


def test_a_comparison_of_what_pymunk_cannot_carry_is_refused() -> None:
    with pytest.raises(ScenarioError, match=r"plant.backend = 'pymunk': rotor inertia of joint 2"):
        compare_backends(scenario_file.load("paper-joint", [SHORT]))


def test_frames_are_the_same_inline_and_as_processes(runtime: object) -> None:
    scenario = scenario_file.load("direct-drive", [PYMUNK, SHORT])
    assert run_processes(scenario, "arm").log.sha256() == run_inline(scenario).log.sha256()


def test_a_comparison_says_where_and_why(monkeypatch: pytest.MonkeyPatch) -> None:
    found = compared(SHORT)
    assert str(found).startswith("direct-drive, 100 cycles: Encoder frames differ by at most ")
    counts = backends._encoder_counts

    def two_off_in_cycle_70(outcome):  # type: ignore[no-untyped-def]
        found = counts(outcome)
        if outcome.scenario.plant.backend == "pymunk":
            found[70, 1] += 2
            found[80, 2] += 3
            found[90] = np.nan
        return found

    monkeypatch.setattr(backends, "_encoder_counts", two_off_in_cycle_70)
    off = compare_backends(found.scenario)
    assert (off.counts.size, off.counts.cycle, off.counts.joint) == pytest.approx((3, 80, 3), abs=1)
    assert off.beyond is not None
    assert (off.beyond.cycle, off.beyond.joint) == (70, 2)
    assert "by more than 1 count first in cycle 70 at joint 2: until then angles were within " in str(off)


def test_counters_that_wrap_are_no_difference() -> None:
    assert backends._wrapped(np.array([[65535.0, -65535.0, np.nan, 32767.0]])).tolist() == [[-1.0, 1.0, 0.0, 32767.0]]
