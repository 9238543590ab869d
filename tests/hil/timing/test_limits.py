"""The limits of a loop: delay margin, g and Jn of a linear joint within a tenth of theory; what cannot be predicted."""

from collections.abc import Iterator
from concurrent.futures import Executor
from typing import Any

import numpy as np
import pytest

from hil import scenario_file
from hil.evaluate import Evaluation, evaluate
from hil.paper.stability import failed, grows
from hil.pool import pool
from hil.rig import run_inline
from hil.scenario import Scenario
from hil.timing import limits
from hil.timing.limits import Rig, delay_margin, examine, largest_g, largest_inertia
from hil.timing.search import Largest, largest

T = 0.001
SHORT = ("duration_s=0.6", "trajectory.time_s=0.4", "trajectory.by_rad=[0.1]")


@pytest.fixture(scope="module")
def executor() -> Iterator[Executor]:
    with pool(2) as processes:
        yield processes


def linear(*settings: str) -> Scenario:
    return scenario_file.load("linear-joint", [*SHORT, *settings])


def rig_of(scenario: Scenario) -> Rig:
    rig = examine(scenario)
    assert isinstance(rig, Rig)
    return rig


# -- measured beside predicted --


def naive_margin_s(g: float, delay_s: float, step_s: float = 2e-6) -> float:
    """Return the added delay at which a joint q" = u starts to grow: its law in floats, integrated piece by piece."""

    def is_stable(extra_s: float) -> bool:
        late, pieces = round((delay_s + extra_s) / step_s), round(T / step_s)
        K1, K2, q, v, before, w, d, a, following = 90.0, 2000.0, 1e-3, 0.0, 1e-3, 0.0, 0.0, 0.0, 0.0
        u: list[float] = []
        size = []
        for k in range(1200):
            speed = (q - before) / T
            d, before, a = d - g * (speed - w), q, following
            u.append(a + d)
            d, w, following = d + g * T * a, speed, -K1 * speed - K2 * q
            whole, rest = divmod(late, pieces)
            for back, span in ((whole + 1, rest), (whole, pieces - rest)):
                acting = u[k - back] if k >= back else 0.0
                q, v = q + v * span * step_s + 0.5 * acting * (span * step_s) ** 2, v + acting * span * step_s
            size.append(abs(u[-1]))
        return max(size[1000:]) < max(size[600:800])

    found = largest(is_stable, 0.0, 3 * T, 750, 0.0).value
    assert found is not None
    return found


@pytest.mark.parametrize("g", [400.0, 700.0, 900.0])
def test_the_delay_margin_of_a_linear_joint_is_the_predicted_one(executor: Executor, g: float) -> None:
    """Within a tenth, as the issue asks (measured: 2 %); and the prediction within 5 us of a simulation in floats.

    The step of the search is 12 us, 2 % of the smallest; an encoder's count and the integers are small beside that.
    """
    rig = rig_of(linear(f"joint.g_rad_s={g}"))
    found = executor.submit(delay_margin, rig, 1).result()
    assert found.predicted is not None
    assert found.predicted.value == pytest.approx(naive_margin_s(g, rig.delay_s[0]), abs=5e-6)
    assert found.measured.value == pytest.approx(found.predicted.value, rel=0.1)
    assert not found.measured.beyond


def test_each_joint_of_an_arm_has_a_margin_of_its_own(executor: Executor) -> None:
    """The others stay as they are. On an arm theory is not exact: friction holds, and the worst pose is passed soon."""
    settings = ["duration_s=0.4", "trajectory.time_s=0.3", "trajectory.by_rad=[0.1, 0.1]"]
    rig = rig_of(scenario_file.load("two-joints", settings))
    first, second = executor.map(delay_margin, [rig, rig], [1, 2])
    for found in (first, second):
        assert found.measured.value == pytest.approx(found.predicted.value, rel=0.2)
    assert first.predicted.value > 1.2 * second.predicted.value
    assert first.measured.value > 1.2 * second.measured.value


def test_with_jitter_the_mean_delay_counts(executor: Executor) -> None:
    """Beside the prediction of the mean one within a tenth; that of the largest is 100 us less, and too careful."""
    rig = rig_of(linear())
    plain, found = executor.map(delay_margin, [rig, rig], [1, 1], [0.0, 2e-4])
    assert plain.predicted is not None
    assert found.predicted is not None
    assert found.by_largest is not None
    assert found.predicted.value == pytest.approx(plain.predicted.value - 1e-4, abs=1e-6)
    assert found.by_largest.value == pytest.approx(plain.predicted.value - 2e-4, abs=1e-6)
    assert found.measured.value == pytest.approx(found.predicted.value, rel=0.1)
    assert found.measured.value > found.by_largest.value


def test_g_and_Jn_of_a_linear_joint_are_the_predicted_ones(executor: Executor) -> None:
    """Within 5 %; at the margin that was measured, what is borne is what the scenario has: one limit, three ways."""
    rig = rig_of(linear())
    tasks = [executor.submit(raise_it, rig, 5e-4) for raise_it in (largest_g, largest_inertia)]
    tasks += [executor.submit(raise_it, rig, 7.54e-4) for raise_it in (largest_g, largest_inertia)]
    g, inertia, own_g, own_inertia = (task.result() for task in tasks)
    for found in (g, inertia, own_g, own_inertia):
        assert found.measured.value == pytest.approx(found.predicted.value, rel=0.05)
    assert own_g.predicted.value == pytest.approx(700.0, rel=0.01)
    assert own_inertia.predicted.value == pytest.approx(1.0, rel=0.01)
    assert g.latency_s == pytest.approx(rig.delay_s[0] + 5e-4)


def test_a_torque_constant_that_is_wrong_is_a_wrong_Jn() -> None:
    """To the integers: 20 % more torque a current than the joint believes, or 20 % more Jn."""
    torque = linear("drive.torque_constant_N_m_A=[12.0]")
    inertia = linear(f"joint.inertia_kg_m2=[{1.2 * 1.29}]")
    margins = [limits._predicted(rig_of(each), _delay(each), 0.0, 0.0, 3 * T) for each in (torque, inertia)]
    assert margins[0] is not None
    assert margins[0] == margins[1]
    assert margins[0].value < 0.9 * naive_margin_s(700.0, 3.6e-4)


def _delay(scenario: Scenario) -> Any:
    return lambda extra_s: (scenario, np.array([3.6e-4 + extra_s]))


# -- what has failed --


def oscillating(amplitude_counts: float, growth: float) -> Evaluation:
    """Return a run whose deviation alternates from cycle to cycle, so many times larger in its last third."""
    evaluation = evaluate(run_inline(linear("duration_s=0.3", "trajectory.time_s=0.2", "trajectory.by_rad=[0.0]")))
    assert evaluation is not None
    third = len(evaluation.t_s) // 3
    amplitude = np.repeat([1.0, 1.0, growth], third) * amplitude_counts * 2 * np.pi / 819_200
    evaluation.q[: 3 * third, 0] += amplitude * (-1.0) ** np.arange(3 * third)
    return evaluation


@pytest.mark.parametrize(
    ("amplitude_counts", "growth", "expected"),
    [(0.1, 4.0, False), (2.0, 1.0, False), (2.0, 1.5, False), (2.0, 4.0, True), (0.4, 5.0, True)],
)
def test_an_oscillation_has_to_grow_and_to_be_seen(amplitude_counts: float, growth: float, expected: bool) -> None:
    assert grows(oscillating(amplitude_counts, growth)) is expected


def test_a_run_too_short_to_tell_does_not_grow() -> None:
    evaluation = evaluate(run_inline(linear("duration_s=0.004", "trajectory.by_rad=[0.0]")))
    assert evaluation is not None
    assert not grows(evaluation)


def test_a_joint_that_deviates_beyond_its_bound_has_failed() -> None:
    loaded = linear("torque=[{joint=1, amplitude_N_m=20.0, until_s=0.6}]", "joint.g_rad_s=100")
    assert failed(loaded, bound_rad=1e-3)
    assert not failed(loaded, bound_rad=1e-2)


# -- where there is no theory, or no limit --


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (["joint.observer=false"], "joint.observer = false"),
        (["joint.observer=false", "dsp.law=computed-torque"], "dsp.law = 'computed-torque'"),
        (["joint1.cpu=examples.pd_joint:SpeedDamping"], "joint1.cpu = 'examples.pd_joint:SpeedDamping'"),
        (["drive.lag_s=0.0001"], "drive.lag_s = 0.0001"),
    ],
)
def test_what_the_theory_does_not_know_is_measured_only(
    settings: list[str], reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = rig_of(linear(*settings))
    assert rig.without_theory.startswith(reason)
    monkeypatch.setattr(limits, "COARSE", 4)
    found = delay_margin(rig, 1)
    assert (found.predicted, found.by_largest) == (None, None)
    assert found.measured.value is not None


def test_without_observer_three_periods_of_delay_are_borne_and_it_is_said_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its K1 alone crosses 1 at 90 rad/s, with a phase margin for some 10 ms."""
    monkeypatch.setattr(limits, "COARSE", 4)
    assert delay_margin(rig_of(linear("joint.observer=false")), 1).measured == Largest(3 * T, beyond=True)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        (["joint.inertia_kg_m2=[2.6]"], "saturations: "),
        (["drive.dead_time_s=[0.0012]"], "saturations: "),
        (["wire.faults=[{kind='cut off', node='joint1', from_s=0.1}]"], "current lost at 0.1"),
    ],
)
def test_a_scenario_that_fails_as_it_is_says_why(settings: list[str], reason: str) -> None:
    found = examine(linear(*settings))
    assert isinstance(found, str)
    assert found.startswith(reason)
