"""All signals of a scenario's run beside float64: open loop, on what the run's joints heard, and closed loop."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from dbc.codec import Codec
from dbc.compiler import load_arm
from firmware_py.joint_cpu import PARAMETERS_NAMES, SHIFT
from hil.evaluate import Evaluation, evaluate
from hil.quantise import signals
from hil.quantise.float_twin import FloatLaw, FloatSeats, Values, open_loop
from hil.quantise.measure import Reference, measure
from hil.quantise.signals import AS_IT_WAS, SATURATED, UNDERFLOWED, Trace
from hil.quantise.tap import Tap
from hil.rig import Progress, no_progress, run_inline
from hil.scenario import Scenario
from hil.summary import deviations, faults
from hil.word_format import WordFormat, words_of


@dataclass(frozen=True)
class Study:
    """What was found, JSON-ready, and the faults that ended the run; none if it came to its end."""

    found: dict[str, Any]
    faults: list[dict[str, Any]]


def study(scenario: Scenario, progress: Progress = no_progress) -> Study:
    """Run a scenario as it is and with joints in float64, and compare; without the second if the first stops itself."""
    codec, tap = load_arm(), Tap()
    outcome = run_inline(scenario, lambda share: progress(share / 2), compiled=False, seat=tap.seat)
    evaluation, stopped = evaluate(outcome), faults(outcome)
    rows = [row for n in range(1, scenario.joints + 1) for row in _of_joint(scenario, n, codec, tap)]
    compared = None
    if evaluation is not None:
        rows += _of_dsp(evaluation, codec, tap)
        if not stopped:
            compared = closed_loop(evaluation, codec, lambda share: progress((1 + share) / 2))
    found = {
        "scenario": scenario.name,
        "frame_log_sha256": outcome.log.sha256(),
        "signals": sorted(rows, key=lambda row: (row["joint"], row["constant"])),
        "closed_loop": compared,
    }
    return Study(found, stopped)


def _of_joint(scenario: Scenario, joint: int, codec: Codec, tap: Tap) -> Iterator[dict[str, Any]]:
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
    for signal in signals.step_signals(form):
        reference = Reference(exact[signal.name], with_same[signal.name])
        yield measure(signal, joint, traces[signal.name], at_s, reference)
    of_law = (law.ka, same.ka), (law.kb, same.kb), (law.kj, same.kj)
    for signal, raw, values in zip(signals.constants(form, table[SHIFT]), table, of_law, strict=False):
        reference = Reference(*(np.array([value]) for value in values))
        yield measure(signal, joint, Trace.of([raw]), at_s[:1], reference)


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


def closed_loop(evaluation: Evaluation, codec: Codec, progress: Progress = no_progress) -> dict[str, Any]:
    """Run a scenario with each joint in float64; return the deviations of both, and what 16 bits add to the largest.

    fault: what ended the run in float64; its figures are left out then.
    """
    scenario = evaluation.scenario
    seats = FloatSeats(scenario, codec)
    outcome = run_inline(scenario, progress, compiled=False, seat=seats.seat)
    other, stopped = evaluate(outcome), faults(outcome)
    if other is None or stopped:
        return {"fault": stopped[0], "joints": []}
    difference = np.max(np.abs(evaluation.deviation - other.deviation), axis=0)
    figures, in_float = deviations(evaluation), deviations(other)
    largest, final = "max_deviation_rad", "final_deviation_rad"
    rows = [
        {
            "joint": joint,
            "max_deviation_rad": figures[largest][joint - 1],
            "max_deviation_float_rad": in_float[largest][joint - 1],
            "penalty": _penalty(figures[largest][joint - 1], in_float[largest][joint - 1]),
            "final_deviation_rad": figures[final][joint - 1],
            "final_deviation_float_rad": in_float[final][joint - 1],
            "largest_difference_rad": float(difference[joint - 1]),
            "largest_output_rounding": max(map(abs, step.roundings)),
        }
        for joint, step in sorted(seats.steps.items())
    ]
    return {"fault": None, "joints": rows}


def _penalty(of_words: float, of_float: float) -> float | None:
    """Return by which share of the float's a deviation is larger; None where that is nothing."""
    return of_words / of_float - 1.0 if of_float > 0.0 else None
