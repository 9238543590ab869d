"""The fast engine: a run under the rule `functional` as machine code, to the bits and integers of the inline run.

What it does not cover it refuses, with the reason: `quickest` then runs inline.
"""

from functools import lru_cache
from typing import Any

import numpy as np

from dbc.codec import Codec
from dbc.compiler import load_arm
from firmware_py.dsp.control import JointSpace, TaskSpace
from hil import constants
from hil.assemble import arm_parameters, build_control, dead_time, external_torques, payloads
from hil.engine import loop as engine
from hil.engine.flat_dsp import FlatDsp, flat_dsp
from hil.engine.functional_run import FunctionalRun, functional, inline
from hil.exact_constants import rad_per_count
from hil.scenario import Arm, Clock, Dsp, Scenario
from hil.scenario_joint import PYTHON
from hil.word_format import words_of
from plant.compiled import machine_code_of
from plant.external import ExternalTorque, changes
from plant.flat_dynamics import Floats, Ints
from plant.flat_robot import NO_END, NOT_FINITE, FlatRobot, flat_robot
from plant.parameters import MAX_JOINTS

NO_NUMBA = "Numba is not installed, or has no folder for what it compiles: pip install -e '.[fast]'"
ENDED = {
    NOT_FINITE: "the arm's motion does not stay finite",
    NO_END: "changes of friction do not end",
    engine.NO_REFERENCE: "a singular point, or a reference beyond all measure",
}
SETUP_CYCLES_A_JOINT, SETUP_MARGIN = 12, 10
"""A parameter takes two cycles under the rule `functional`; where the set-up may be too short, the bus has to tell."""


class Unsupported(Exception):
    """What the fast engine does not do, and the inline run does."""


def quickest(scenario: Scenario) -> tuple[FunctionalRun, str]:
    """Run a scenario, fast where that can be, else inline; return why it was not fast, too, empty if it was."""
    try:
        return run(scenario), ""
    except Unsupported as reason:
        return inline(scenario), str(reason)


def slow_because(scenario: Scenario) -> str:
    """Return why a scenario's run is not fast, empty if it is; the first call on a machine compiles for 10 s."""
    try:
        run(scenario)
    except Unsupported as reason:
        return str(reason)
    return ""


def run(scenario: Scenario, compiled: bool = True) -> FunctionalRun:
    """Run a scenario under the rule `functional`; raise Unsupported, or ScenarioError as the inline run does.

    compiled: False runs the same source as Python, a thousand times slower.
    """
    refusal = uncovered(scenario)
    carry_through = machine_code_of(engine.carry_through) if compiled else engine.carry_through
    if refusal or carry_through is None:
        raise Unsupported(refusal or NO_NUMBA)
    loop = loop_of(functional(scenario))
    ended = carry_through(loop)
    if ended:
        raise Unsupported(f"{scenario.name}: {ENDED[ended]}")
    joints = scenario.joints
    return FunctionalRun(
        q=loop.q,
        a_ref=loop.a_ref,
        current=loop.current,
        estimate=loop.estimate,
        saturations=loop.words.saturations.copy(),
        reference_saturations=loop.dsp.state.saturations[:joints].copy(),
        amplifier_saturations=loop.robot.state.saturations[:joints].copy(),
    )


def uncovered(scenario: Scenario) -> str:
    """Return why the engine does not cover a scenario, empty if it does."""
    joints = range(1, scenario.joints + 1)
    reasons = {
        "a world": scenario.has_world,
        f"plant.backend = {scenario.plant.backend!r}": scenario.plant.backend != "closed",
        f"dsp.law = {scenario.dsp.law!r}": scenario.dsp.law != "acceleration",
        f"clock.kind = {scenario.clock.kind!r}": scenario.clock.kind != "virtual",
        "wire.faults": bool(scenario.wire.faults),
        "a joint's own crystal": any(scenario.crystal_ppb(joint) is not None for joint in joints),
        "a joint's own cpu": any(scenario.cpu(joint) != PYTHON for joint in joints),
        f"clock.setup_cycles = {scenario.clock.setup_cycles}, which may end before all joints are ready": (
            scenario.clock.setup_cycles < SETUP_CYCLES_A_JOINT * scenario.joints + SETUP_MARGIN
        ),
    }
    found = [reason for reason, holds in reasons.items() if holds]
    return f"not in the fast engine: {', '.join(found)}" if found else ""


def loop_of(scenario: Scenario) -> engine.Loop:
    """Return the run of a scenario before it begins; raise ScenarioError, or Unsupported for words beyond 64 bits."""
    codec = load_arm()
    joints, cycles = scenario.joints, scenario.cycles
    coulomb_Nm = np.zeros(MAX_JOINTS)
    coulomb_Nm[:joints] = scenario.arm.coulomb_N_m

    def rows() -> Ints:
        return np.zeros((cycles, joints), dtype=np.int64)

    return engine.Loop(
        robot=_robot(scenario, codec),
        dsp=_dsp(scenario, codec),
        words=_words(scenario, codec),
        joints=_joints(scenario, codec),
        period_ns=scenario.period_ns,
        first=-scenario.clock.setup_cycles,
        cycles=cycles,
        coulomb_Nm=coulomb_Nm,
        counters=np.zeros(joints, dtype=np.int64),
        q=np.zeros((cycles, joints)),
        a_ref=rows(),
        current=rows(),
        estimate=rows(),
    )


def _robot(scenario: Scenario, codec: Codec) -> FlatRobot:
    start_ns = -scenario.clock.setup_cycles * scenario.period_ns
    return flat_robot(
        arm_parameters(scenario, codec),
        scenario.start_rad,
        start_ns,
        min(scenario.period_ns, 1_000_000),
        _applied_ns(scenario),
        payloads(scenario),
        _torque_changes(tuple(external_torques(scenario)), scenario.duration_ns),
    )


def _applied_ns(scenario: Scenario) -> Ints:
    """Return when the current of every joint (rows) and cycle, set-up included, is applied."""
    first, joints = -scenario.clock.setup_cycles, range(scenario.joints)
    delays = np.array(constants.action_delays_ns(scenario), dtype=np.int64)
    begins_ns = np.arange(first, scenario.cycles, dtype=np.int64) * scenario.period_ns
    arrives_ns: Ints = delays[:, None] + begins_ns
    dead = dead_time(scenario)
    if dead is None:
        return arrives_ns
    rows = [[dead.applied_ns(j, first + k, at) for k, at in enumerate(arrives_ns[j].tolist())] for j in joints]
    return np.array(rows, dtype=np.int64)


@lru_cache(maxsize=64)
def _torque_changes(torques: tuple[ExternalTorque, ...], end_ns: int) -> list[tuple[int, int, float]]:
    return changes(torques, 0, end_ns)


def _dsp(scenario: Scenario, codec: Codec) -> FlatDsp:
    control, position, acceleration = _commands(_path_alone(scenario))
    gains = scenario.dsp.k1_1_s, scenario.dsp.k2_1_s2
    scales = rad_per_count(scenario), 1.0 / codec.scale("AccelRef", "Joint1")
    return flat_dsp(control, position, acceleration, scenario.start_rad, gains, scales)


@lru_cache(maxsize=64)
def _commands(path: Scenario) -> tuple[JointSpace | TaskSpace, Floats, Floats]:
    """Return the position controller of a path, and its command table: milliseconds, and the same for many runs."""
    control = build_control(path)
    table = control.commands
    return control, np.array(table.position, dtype=np.float64), np.array(table.acceleration, dtype=np.float64)


def _path_alone(scenario: Scenario) -> Scenario:
    """Return a scenario with nothing in it but what the commands hang on."""
    return Scenario.model_construct(
        name="path",
        duration_s=scenario.duration_s,
        start_rad=scenario.start_rad,
        clock=Clock(period_s=scenario.clock.period_s),
        arm=Arm(lengths_m=scenario.arm.lengths_m),
        dsp=Dsp(space=scenario.dsp.space),
        trajectory=scenario.trajectory,
    )


def _words(scenario: Scenario, codec: Codec) -> Any:
    """Return the words of every joint as records."""
    words = np.zeros(scenario.joints, engine.WORDS).view(np.recarray)
    values = vars(words_of(scenario, codec))
    try:
        for name in engine.WORDS.names or ():
            if name != "saturations":
                words[name] = values[name]
    except OverflowError:
        raise Unsupported(
            f"not in the fast engine: joint.word: {name} = {values[name]} has more than 64 bits"
        ) from None
    return words


def _joints(scenario: Scenario, codec: Codec) -> Any:
    """Return the joints before cycle 0 as records, with their parameter tables."""
    joints = np.zeros(scenario.joints, engine.JOINT).view(np.recarray)
    for j in range(scenario.joints):
        table = constants.parameter_table(scenario, j + 1, codec)
        for name, value in zip(engine.TABLE, table, strict=True):
            joints[name][j] = value
    return joints
