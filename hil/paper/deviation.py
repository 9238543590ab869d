"""The paper's claims about deviation: figs. 15 and 16, interference between the axes, steps, and a shorter period."""

from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from hil import scenario_file
from hil.constants import check_budget
from hil.errors import ScenarioError
from hil.evaluate import Evaluation, evaluate
from hil.rig import run_inline

OFF = "joint.observer=false"
LINE = ("dsp.space=task", "duration_s=0.8")
TORQUE_STEP = (
    "duration_s=2.2",
    "torque=[{joint=1, amplitude_N_m=15.0, at_s=1.2, until_s=2.2},"
    " {joint=2, amplitude_N_m=-8.0, at_s=1.2, until_s=2.2}, {joint=3, amplitude_N_m=2.0, at_s=1.2, until_s=2.2}]",
)
LOAD_STEP = ("duration_s=2.2", "load=[{mass_kg=3.0, at_s=1.2, until_s=2.2}]")
JOINT_SPACE_S, TASK_SPACE_S = 100e-6, 700e-6
"""The DSP's computing times: a table looked up and eq. (16), beside kinematics and eqs. (20)-(21). The paper has none;
what the comparison shows hangs on their order alone."""
PERIODS_S = tuple(round(1e-6 * us, 6) for us in range(500, 2001, 50))
RUN_S = 1.5


def evaluated(name: str, *settings: str) -> Evaluation:
    """Run a built-in scenario inline and evaluate it."""
    found = evaluate(run_inline(scenario_file.load(name, settings)))
    if found is None:
        raise ScenarioError(f"{name} with {', '.join(settings)}: the run ended before cycle 0")
    return found


# -- interference --


@dataclass(frozen=True)
class Interference:
    """A straight line of 10 cm in 0.5 s along one axis: the largest deviation along it and across it, m."""

    axis: str
    along_m: float
    across_m: float
    across_without_observer_m: float


def interference(executor: Executor) -> list[Interference]:
    """Run a line along each axis, in task space."""
    return list(executor.map(_interfere, (0, 1)))


def _interfere(axis: int) -> Interference:
    by_m = [0.0, 0.0]
    by_m[axis] = -0.1
    # a fresh table: `load` would keep the circle's radius
    settings = (*LINE, f'trajectory={{kind="line", by_m={by_m}, time_s=0.5}}')
    on, off = (np.max(np.abs(run.x_cmd - run.x), axis=0) for run in _both(settings))
    return Interference("xy"[axis], float(on[axis]), float(on[1 - axis]), float(off[1 - axis]))


def _both(settings: tuple[str, ...]) -> tuple[Evaluation, Evaluation]:
    return evaluated("paper-task", *settings), evaluated("paper-task", *settings, OFF)


# -- steps --


@dataclass(frozen=True)
class Step:
    """A step disturbance: what is left at the end, rms of the last 100 ms, rad or m."""

    what: str
    unit: str
    left: list[float]
    left_without_observer: list[float]


def steps(executor: Executor) -> list[Step]:
    """Run a load and a step torque, in joint space and in task space."""
    cases = [
        (f"{what} in {space} space", space, settings)
        for what, settings in (("3 kg put on the hand", LOAD_STEP), ("a torque on every joint", TORQUE_STEP))
        for space in ("joint", "task")
    ]
    return list(executor.map(_step, *zip(*cases, strict=True)))


def _step(what: str, space: str, settings: tuple[str, ...]) -> Step:
    on, off = (_left(evaluated(f"paper-{space}", *settings, *more), space) for more in ((), (OFF,)))
    return Step(what, "rad" if space == "joint" else "m", on, off)


def _left(run: Evaluation, space: str) -> list[float]:
    deviation = run.deviation if space == "joint" else run.x_cmd - run.x
    left: list[float] = np.sqrt(np.mean(deviation[run.final_rows] ** 2, axis=0)).tolist()
    return left


# -- a shorter period --


@dataclass(frozen=True)
class ShortestPeriod:
    """The shortest period that holds with a computing time of the DSP, and the largest deviation there, rad."""

    what: str
    compute_s: float
    period_s: float
    largest_rad: float


def shortest_periods(executor: Executor) -> list[ShortestPeriod]:
    """Find them for the arm of one joint, on whose bus there is room."""
    cases = [("joint space, inverse kinematics offline", JOINT_SPACE_S), ("task space", TASK_SPACE_S)]
    return list(executor.map(_shortest, *zip(*cases, strict=True)))


def _shortest(what: str, compute_s: float) -> ShortestPeriod:
    for period_s in PERIODS_S:
        duration_s = round(round(RUN_S / period_s) * period_s, 9)
        settings = [f"clock.period_s={period_s}", f"dsp.compute_s={compute_s:.6f}", f"duration_s={duration_s}"]
        try:
            check_budget(scenario_file.load("one-joint", settings))
        except ScenarioError:
            continue
        largest = np.max(np.abs(evaluated("one-joint", *settings).deviation))
        return ShortestPeriod(what, compute_s, period_s, float(largest))
    raise ScenarioError(f"dsp.compute_s = {compute_s}: no period up to {PERIODS_S[-1]} s holds it")
