"""What joints by their own timers cost: a run with their crystals beside the same run on the Encoder frame.

A crystal that is e too fast slides by e of a period in each: after 1 / e periods there was one tick more than samples,
by a slow one there was one less, which is a beat. Around a beat the Encoder frame's jitter (stuff bits, frames in its
way) takes it to and fro across the tick: samples are doubled and missed by turns. The difference counts the beats. A
crystal of no error (0 ppm), set by an Encoder frame, stays at that coincidence for the whole run, unless its phase is
another.
"""

from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.table import Table

from dbc.compiler import load_arm
from hil.errors import ScenarioError
from hil.evaluate import Evaluation, evaluate
from hil.rig import Outcome, run_inline
from hil.scenario import Scenario
from hil.summary import deviations, summarise
from plant.parameters import MAX_JOINTS


@dataclass(frozen=True)
class Slips:
    """When the Current of a sample ended that was taken twice, and of one behind a sample that never was; s."""

    doubled_s: list[float]
    missed_s: list[float]


@dataclass(frozen=True)
class Comparison:
    """A run by the joints' own timers and the same on the Encoder frame; slips: by joint, as the bus shows them."""

    outcome: Outcome
    own: Evaluation
    on_frame: Evaluation
    slips: dict[int, Slips]


def compare(scenario: Scenario) -> Comparison:
    """Run a scenario with its crystals and without, inline; raise ScenarioError where there are none."""
    joints = [joint for joint in range(1, scenario.joints + 1) if scenario.crystal_ppb(joint) is not None]
    if not joints:
        raise ScenarioError(
            f"{scenario.name}: no joint samples by a timer of its own: set joint1.crystal_ppm=100, or take drift"
        )
    outcome, own = _run(scenario)
    _, reference = _run(on_frame(scenario))
    return Comparison(outcome, own, reference, {joint: slips(outcome, joint) for joint in joints})


def _run(scenario: Scenario) -> tuple[Outcome, Evaluation]:
    outcome = run_inline(scenario, compiled=False)
    evaluation = evaluate(outcome)
    if evaluation is None:
        raise ScenarioError(f"{scenario.name}: the run ended before cycle 0: `hil run` says why")
    return outcome, evaluation


def on_frame(scenario: Scenario) -> Scenario:
    """Return the scenario with every joint sampling on the Encoder frame."""
    nothing = {"crystal_ppm": None, "crystal_phase_s": None}
    parts: dict[str, Any] = {f"joint{n}": scenario.own(n).model_copy(update=nothing) for n in range(1, MAX_JOINTS + 1)}
    parts["joint"] = scenario.joint.model_copy(update={"crystal_ppm": None})
    return scenario.model_copy(update=parts)


def slips(outcome: Outcome, joint: int) -> Slips:
    """Return a joint's doubled and missed samples, read off the cycles that its Currents name."""
    current = load_arm()[f"Current_{joint}"]
    found = Slips([], [])
    before = None
    for end_ns, identifier, data, _ in outcome.log.frames:
        fields = current.unpack(data) if identifier == current.identifier and end_ns >= 0 else None
        if fields is None:
            continue
        further = 1 if before is None else (fields[-1] - before) & 0xFF
        before = fields[-1]
        if further == 0:
            found.doubled_s.append(end_ns * 1e-9)
        found.missed_s.extend([end_ns * 1e-9] * (further - 1))
    return found


def describe(found: Comparison) -> dict[str, Any]:
    """Return a comparison as JSON-ready values. slip_periods: how far the samples slid in the run, by the crystal."""
    summary = summarise(found.outcome, found.own, 0.0)
    own, reference = summary, deviations(found.on_frame)
    scenario = found.outcome.scenario
    rows = []
    for n in range(scenario.joints):
        name, ppb = f"joint{n + 1}", scenario.crystal_ppb(n + 1)
        samples = summary["samples"].get(name, dict.fromkeys(("doubled", "missed", "beats")))
        rows.append(
            {
                "joint": name,
                "crystal_ppm": None if ppb is None else ppb / 1000,
                "slip_periods": None if ppb is None else ppb * 1e-9 * summary["cycles"],
                **samples,
                "largest_rad": own["max_deviation_rad"][n],
                "largest_on_frame_rad": reference["max_deviation_rad"][n],
                "final_rad": own["final_deviation_rad"][n],
                "final_on_frame_rad": reference["final_deviation_rad"][n],
            }
        )
    kept = ("scenario", "cycles", "deadline_misses_by_cause", "saturations_by_signal", "faults")
    return {key: summary[key] for key in kept} | {"joints": rows}


def show_drift(console: Console, found: dict[str, Any]) -> None:
    """Print samples and deviations of every joint, and what else was late or saturated."""
    table = Table(title=f"{found['scenario']}: sampled by own timers (on the Encoder frame); deviation, urad")
    for column in (
        "joint",
        "crystal\nppm",
        "periods\nslid",
        "\nbeats",
        "doubled,\nmissed",
        "largest\n(on frame)",
        "final, rms\n(on frame)",
    ):
        table.add_column(column, justify="right", no_wrap=True)
    for row in found["joints"]:
        free = row["crystal_ppm"] is not None
        samples = [f"{row['crystal_ppm']:+g}", f"{row['slip_periods']:+.2f}"] if free else ["-", "-"]
        samples += [str(row["beats"]), f"{row['doubled']}, {row['missed']}"] if free else ["-", "-"]
        sizes = [
            f"{row[key] * 1e6:.1f} ({row[f'{key[:-4]}_on_frame_rad'] * 1e6:.1f})"
            for key in ("largest_rad", "final_rad")
        ]
        table.add_row(row["joint"].removeprefix("joint"), *samples, *sizes)
    console.print(table)
    for key in ("deadline_misses_by_cause", "saturations_by_signal"):
        if found[key]:
            causes = ", ".join(f"{cause}: {count}" for cause, count in found[key].items())
            console.print(f"{key.replace('_', ' ')}: {causes}", soft_wrap=True)
    for fault in found["faults"]:
        console.print(f"stopped at {fault['time_s']:.3f} s: {fault['node']}: {fault['reason']} ({fault['cause']})")
