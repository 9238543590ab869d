"""All signals of a scenario's run beside float64: open loop, on what the run's joints heard, and closed loop."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np

from dbc.codec import Codec
from dbc.compiler import load_arm
from firmware_py.joint_cpu import PARAMETERS_NAMES, SHIFT
from hil.errors import ScenarioError
from hil.evaluate import Evaluation, evaluate
from hil.exact_constants import rad_per_count
from hil.quantise import signals
from hil.quantise.closed_loop import Loop, closed_loop
from hil.quantise.derived import Interval, Limits, derived, physical_limits
from hil.quantise.float_twin import FloatLaw, Values, open_loop
from hil.quantise.measure import Reference, bits_used, measure
from hil.quantise.proposal import changes, propose
from hil.quantise.signals import AS_IT_WAS, SATURATED, UNDERFLOWED, Signal, Trace
from hil.quantise.tap import Tap
from hil.rig import Progress, no_progress, run_inline
from hil.scenario import Scenario
from hil.scenario_joint import I8086, PYTHON
from hil.summary import faults
from hil.word_format import WordFormat, words_of

WRAPPING = ("count", "w")
"""The counter wraps where it must, and w with it, which undoes it."""


@dataclass(frozen=True)
class Study:
    """What was found, JSON-ready, and the faults that ended the run; none if it came to its end."""

    found: dict[str, Any]
    faults: list[dict[str, Any]]


@dataclass(frozen=True)
class Measured:
    """A scenario's run: its evaluation (None if it never began), its faults, and the row of each signal."""

    evaluation: Evaluation | None
    stopped: list[dict[str, Any]]
    rows: list[dict[str, Any]]
    frame_log_sha256: str


def study(scenario: Scenario, progress: Progress = no_progress) -> Study:
    """Run a scenario as it is, with joints in float64, and in the formats that its ranges ask for, and compare.

    Without the second and third if the first stops itself.
    """
    _check_cpus(scenario)
    codec = load_arm()
    measured = measured_run(scenario, codec, lambda share: progress(share / 3))
    compared = proposed = None
    if measured.evaluation is not None and not measured.stopped:
        compared = closed_loop(measured.evaluation, codec, lambda share: progress((1 + share) / 3))
        proposed = _proposal(scenario, codec, measured, lambda share: progress((2 + share) / 3))
    found = {
        "scenario": scenario.name,
        "frame_log_sha256": measured.frame_log_sha256,
        "signals": measured.rows,
        "closed_loop": compared,
        "proposal": proposed,
    }
    return Study(found, measured.stopped)


def _check_cpus(scenario: Scenario) -> None:
    """Refuse joints of machine code, which would go on in its own formats where others are tried."""
    for joint in range(1, scenario.joints + 1):
        if scenario.cpu(joint) == I8086:
            raise ScenarioError(
                f"joint{joint}: cpu = {I8086!r}: its machine code is of the default formats, and others are tried "
                f"here: take cpu = {PYTHON!r}, which computes the same bits"
            )


def measured_run(scenario: Scenario, codec: Codec, progress: Progress = no_progress) -> Measured:
    """Run a scenario, and look on."""
    tap = Tap()
    outcome = run_inline(scenario, progress, compiled=False, seat=tap.seat)
    evaluation = evaluate(outcome)
    limits = physical_limits(scenario, codec)
    rows = [row for n in range(1, scenario.joints + 1) for row in _of_joint(scenario, n, codec, tap, limits)]
    rows += [] if evaluation is None else _of_dsp(evaluation, codec, tap)
    in_order = sorted(rows, key=lambda row: (row["joint"], row["constant"]))
    return Measured(evaluation, faults(outcome), in_order, outcome.log.sha256())


def _proposal(scenario: Scenario, codec: Codec, measured: Measured, progress: Progress) -> dict[str, Any]:
    """Propose formats, and run in them; against: why they are not proved.

    A deviation may be larger by an encoder count: so much another limit cycle makes, in any format.
    """
    chosen = propose(scenario, codec, measured.rows)
    formats = changes(scenario, chosen, codec)
    again = measured_run(chosen, codec, progress) if formats else measured
    before, after = (_largest_deviations(run, scenario.joints) for run in (measured, again))
    joints = [
        {
            "joint": joint,
            "sqnr_db": _of_signal(measured.rows, "i", joint)["sqnr_db"],
            "sqnr_proposed_db": _of_signal(again.rows, "i", joint)["sqnr_db"],
            "max_deviation_rad": before[joint - 1],
            "max_deviation_proposed_rad": after[joint - 1],
        }
        for joint in range(1, scenario.joints + 1)
    ]
    overflows = sum(row["saturations"] + (row["name"] not in WRAPPING) * row["wraps"] for row in again.rows)
    against = {
        "the run stops itself": bool(again.stopped),
        f"{overflows} overflows": overflows > 0,
        "a current is less exact": any(
            _exactness(row["sqnr_proposed_db"]) < _exactness(row["sqnr_db"]) for row in joints
        ),
        "a deviation is larger by more than an encoder count": any(
            (row["max_deviation_proposed_rad"] or inf) > row["max_deviation_rad"] + rad_per_count(scenario)
            for row in joints
        ),
    }
    found = [reason for reason, holds in against.items() if holds]
    return {
        "formats": formats,
        "overflows": overflows,
        "joints": joints,
        "against": found,
        "proved": not found,
    }


def _exactness(sqnr_db: float | None) -> float:
    return inf if sqnr_db is None else sqnr_db


def _of_signal(rows: list[dict[str, Any]], name: str, joint: int) -> dict[str, Any]:
    return next(row for row in rows if (row["name"], row["joint"]) == (name, joint))


def _largest_deviations(run: Measured, joints: int) -> list[Any]:
    """Return that of every joint, rad; None where the run never began."""
    return [None] * joints if run.evaluation is None else Loop.of(run.evaluation).largest


def _of_joint(scenario: Scenario, joint: int, codec: Codec, tap: Tap, limits: Limits) -> Iterator[dict[str, Any]]:
    """Yield the row of each signal and constant of joint 1 to n; none if it never came to compute."""
    samples = tap.samples(joint)
    if not len(samples):
        return
    at_s = samples[:, 0].astype(np.float64) * 1e-9
    table = samples[0, -len(PARAMETERS_NAMES) :].tolist()
    form = WordFormat.of(scenario, codec)
    law, same = FloatLaw.of(scenario, joint, codec), FloatLaw.of_table(form, *table)
    traces = signals.replay(samples, words_of(scenario, codec, signals.TracedWords))
    exact, with_same = open_loop(law, samples), open_loop(same, samples)
    ranges = derived(scenario, joint, codec, limits)
    for signal in signals.step_signals(form):
        reference = Reference(exact[signal.name], with_same[signal.name])
        row = measure(signal, joint, traces[signal.name], at_s, reference)
        yield row | _derived(signal, ranges.get(signal.name))
    of_law = (law.ka, same.ka), (law.kb, same.kb), (law.kj, same.kj)
    for signal, raw, values in zip(signals.constants(form, table[SHIFT]), table, of_law, strict=False):
        reference = Reference(*(np.array([value]) for value in values))
        yield measure(signal, joint, Trace.of([raw]), at_s[:1], reference)


def _derived(signal: Signal, interval: Interval | None) -> dict[str, Any]:
    """Return the derived range, and the head-room that it leaves."""
    if interval is None:
        return {}
    ends = np.array([interval.low, interval.high])
    used = bits_used(np.rint(np.ldexp(ends, signal.fraction)).astype(np.int64), signal.signed)
    return {"derived_min": interval.low, "derived_max": interval.high, "derived_headroom_bits": signal.bits - used}


def _of_dsp(evaluation: Evaluation, codec: Codec, tap: Tap) -> Iterator[dict[str, Any]]:
    """Yield the row of each joint's reference: as it was on the bus, beside what the DSP had before it rounded."""
    scale = codec.scale("AccelRef", "Joint1")
    heard = [(cycle, each) for cycle, each in tap.accelerations if cycle < len(evaluation.t_s)]
    cycles = [cycle for cycle, _ in heard]
    wanted = np.array([each for _, each in heard], dtype=np.float64).reshape(len(heard), -1) / scale
    for k in range(evaluation.scenario.joints):
        sent = evaluation.a_ref[cycles, k] / scale
        there = np.isfinite(sent)
        if np.any(there):
            exact: Values = wanted[there, k]
            trace = rounded_trace(exact, np.rint(sent[there]))
            at_s = evaluation.t_s[cycles][there]
            yield measure(signals.ACCEL_REF, k + 1, trace, at_s, Reference(exact, exact))


def rounded_trace(exact: Values, rounded: Values) -> Trace:
    """Return the trace of values that were rounded to the nearest: what is further away was limited."""
    saturated = np.abs(exact - rounded) > 0.5
    underflowed = (exact != 0.0) & (rounded == 0.0)
    return Trace.of(rounded, np.select([saturated, underflowed], [SATURATED, UNDERFLOWED], AS_IT_WAS))
