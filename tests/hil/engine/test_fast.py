"""The fast engine against the inline run: the same floats to the bit, the same integers, or a word why not."""

import sys
from dataclasses import fields
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from hil import scenario_file
from hil.engine import fast
from hil.engine.functional_run import FunctionalRun, functional, inline
from hil.errors import ScenarioError
from plant import compiled
from tests.hil.engine.drawn import drawn

SEEDS = range(50)
SHORT = ("duration_s=0.1", "trajectory.time_s=0.08", "trajectory.by_rad=[0.02, -0.02, 0.02]")
COMPUTED_TORQUE = ("dsp.law=computed-torque", "joint.observer=false")
IN_PYTHON = ("duration_s=0.02", "clock.setup_cycles=60", "bus.fidelity=functional")


@pytest.fixture(scope="module")
def numba() -> ModuleType:
    reason = "NOT TESTED: machine code of the fast engine; pip install -e '.[fast]'"
    module: ModuleType = pytest.importorskip("numba", reason=reason)
    return module


@pytest.fixture
def without_numba(monkeypatch: pytest.MonkeyPatch) -> Any:
    compiled.machine_code_of.cache_clear()
    compiled._compiled.cache_clear()
    monkeypatch.setitem(sys.modules, "numba", None)
    yield
    compiled.machine_code_of.cache_clear()
    compiled._compiled.cache_clear()


def differences(one: FunctionalRun, other: FunctionalRun) -> list[str]:
    """Names of what is not the same: values, types and shapes."""

    def content(value: Any) -> Any:
        return (value.shape, value.dtype, value.tobytes()) if isinstance(value, np.ndarray) else value

    names = [field.name for field in fields(one)]
    return [name for name in names if content(getattr(one, name)) != content(getattr(other, name))]


@pytest.mark.usefixtures("numba")
@pytest.mark.parametrize("seed", SEEDS)
def test_random_scenarios_run_as_they_do_inline(seed: int) -> None:
    scenario = drawn(seed)
    assert differences(fast.run(scenario), inline(scenario)) == []


@pytest.mark.usefixtures("numba")
@pytest.mark.parametrize("name", ["five-joints", "load-step", "paper-joint", "paper-task"])
def test_built_in_scenarios_run_as_they_do_inline(name: str) -> None:
    scenario = scenario_file.load(name)
    assert differences(fast.run(scenario), inline(scenario)) == []


@pytest.mark.usefixtures("numba")
def test_the_random_scenarios_are_of_every_kind() -> None:
    """What no scenario does, no comparison shows; so each kind is there, and quiet ones are."""
    scenarios = [drawn(seed) for seed in SEEDS]
    runs = [fast.run(scenario) for scenario in scenarios]
    overflows = np.sum([run.saturations.sum(axis=0) for run in runs], axis=0)
    kinds = {
        "joints": {scenario.joints for scenario in scenarios} == {1, 2, 3, 4, 5, 6},
        "most have three": sum(scenario.joints == 3 for scenario in scenarios) > len(scenarios) / 3,
        "task space": any(scenario.dsp.space == "task" for scenario in scenarios),
        "no friction": any(not any(scenario.arm.coulomb_N_m) for scenario in scenarios),
        "ripple": any(any(scenario.drive.ripple) for scenario in scenarios),
        "lag": any(scenario.drive.lag_s for scenario in scenarios),
        "dead time": any(any(scenario.drive.dead_time_s) for scenario in scenarios),
        "jitter": any(any(scenario.drive.dead_time_jitter_s) for scenario in scenarios),
        "loads": any(scenario.load for scenario in scenarios),
        "sines": any(torque.frequency_rad_s for scenario in scenarios for torque in scenario.torque),
        "no observer": any(not scenario.joint.observer for scenario in scenarios),
        "words": {scenario.joint.word.bits for scenario in scenarios} >= {8, 10, 16, 24, 32},
        "wraps": any(scenario.joint.word.overflow == "wrap" for scenario in scenarios),
        "overflows of KB dw, d and i": bool(np.all(overflows[[2, 3, 4]] > 0)),
        "amplifiers saturate": any(run.amplifier_saturations.any() for run in runs),
        "references saturate": any(run.reference_saturations.any() for run in runs),
        "nothing saturates": sum(not run.saturations.any() for run in runs) > 5,
        "brakes too weak": any(run.q[0].tolist() != list(s.start_rad) for run, s in zip(runs, scenarios, strict=True)),
    }
    assert [kind for kind, there in kinds.items() if not there] == []


@pytest.mark.parametrize(
    "settings",
    [
        (),
        ("drive.lag_s=0.0005", "drive.ripple=[0.01, 0.0, 0.02]", "brake.torque_N_m=[0.5, 30, 8]"),
        ("clock.period_s=0.002", "joint.g_rad_s=300"),  # in steps of 1 ms at most
        ("joint.word.bits=12", "joint.word.overflow=wrap", "joint.word.round_d=convergent"),
    ],
)
def test_the_same_source_as_python_runs_as_inline(settings: tuple[str, ...]) -> None:
    scenario = scenario_file.load("paper-joint", (*IN_PYTHON, *settings))
    assert differences(fast.run(scenario, compiled=False), inline(scenario)) == []


def test_task_space_in_python() -> None:
    scenario = scenario_file.load("paper-task", IN_PYTHON)
    assert differences(fast.run(scenario, compiled=False), inline(scenario)) == []


@pytest.mark.parametrize(
    ("name", "settings", "named"),
    [
        ("wall", (), "a world"),
        ("direct-drive", ("plant.backend=pymunk",), "plant.backend = 'pymunk'"),
        ("paper-joint", COMPUTED_TORQUE, "dsp.law = 'computed-torque'"),
        ("paper-joint", ("clock.kind=sync",), "clock.kind = 'sync'"),
        ("paper-joint", ("joint.crystal_ppm=10",), "crystal"),
        ("paper-joint", ("joint2.cpu=examples.pd_joint:PDJoint",), "cpu"),
        ("paper-joint", ("clock.setup_cycles=40",), "clock.setup_cycles = 40"),
    ],
)
def test_what_it_does_not_cover_it_names(name: str, settings: tuple[str, ...], named: str) -> None:
    with pytest.raises(fast.Unsupported, match=named):
        fast.run(scenario_file.load(name, settings), compiled=False)


def test_what_is_not_covered_runs_inline_and_says_why() -> None:
    scenario = functional(scenario_file.load("paper-joint", (*SHORT, *COMPUTED_TORQUE)))
    found, reason = fast.quickest(scenario)
    assert differences(found, inline(scenario)) == []
    assert "dsp.law" in reason


@pytest.mark.usefixtures("without_numba")
def test_without_numba_it_runs_inline_and_says_so() -> None:
    scenario = scenario_file.load("paper-joint", SHORT)
    found, reason = fast.quickest(scenario)
    assert differences(found, inline(scenario)) == []
    assert "Numba" in reason
    assert "pip install" in reason


@pytest.mark.usefixtures("numba")
def test_what_is_covered_is_fast() -> None:
    assert fast.quickest(scenario_file.load("paper-joint", SHORT))[1] == ""


def test_a_singular_point_is_left_to_the_inline_run() -> None:
    """A brake that cannot hold lets the elbow fall through the stretched pose before the run begins."""
    settings = (
        *IN_PYTHON,
        "start_rad=[0.0, 0.052, -0.5]",
        "brake.torque_N_m=[60.0, 0.1, 8.0]",
        "arm.coulomb_N_m=[0,0,0]",
    )
    scenario = scenario_file.load("paper-task", (*settings, "trajectory={kind='line', by_m=[0, 0], time_s=1}"))
    with pytest.raises(fast.Unsupported, match="singular point"):
        fast.run(scenario, compiled=False)
    assert "dsp" in inline(scenario).stopped


def test_a_motion_that_is_not_finite_is_left_to_the_inline_run() -> None:
    torque = "torque=[{joint=1, amplitude_N_m=1e4, until_s=0.02}]"
    settings = (*IN_PYTHON, torque, "arm.rotor_inertia_kg_m2=[0, 0, 0]", "arm.viscosity_N_m_s=[1e4, 1e4, 1e4]")
    with pytest.raises(fast.Unsupported, match="finite"), np.errstate(all="ignore"):
        fast.run(scenario_file.load("paper-joint", settings), compiled=False)


@pytest.mark.parametrize("setting", ["joint.g_rad_s=2000", "joint.word.kb_fraction=8", "dsp.space=task"])
def test_a_scenario_that_cannot_be_built_is_refused_as_inline(setting: str) -> None:
    scenario = scenario_file.load("paper-joint", [setting])
    with pytest.raises(ScenarioError) as of_fast:
        fast.run(scenario, compiled=False)
    with pytest.raises(ScenarioError) as of_inline:
        inline(scenario)
    assert str(of_fast.value) == str(of_inline.value)


def test_an_arm_moves_whose_currents_act_exactly_where_a_period_begins():
    """Delay and dead time make a whole period: the sample looks at the arm at the instant of the jump.

    One joint at rest, 8 A on 10 N m/A, against gravity and friction: it must have moved by a t^2 / 2 within 0.1 s, a
    being at least half of what the free rotor would have.
    """
    settings = ["bus.action_delay_s=[0.0004]", "drive.dead_time_s=[0.0006]", "duration_s=0.1"]
    scenario = scenario_file.load("one-joint", ["bus.fidelity=functional", *settings])
    found = inline(scenario)
    assert differences(found, fast.run(scenario, compiled=False)) == []
    assert abs(found.q[-1, 0] - found.q[0, 0]) > 1e-4
