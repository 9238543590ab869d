"""All that `hil cpu` finds of a scenario: counted in its run, bounded over all paths, what it comes to; as JSON."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

from firmware_py.joint_cpu import SIGNALS, make_step
from firmware_py.words import InstrumentedWords, Words
from hil import scenario_file
from hil.errors import ScenarioError
from hil.i8086 import image, straight_line
from hil.i8086.cost import beside_newton_euler, by_clock
from hil.i8086.profile import IMUL, CountingBoard, profile
from hil.options import with_clock
from hil.paper.newton_euler import Operations
from hil.rig import Progress, no_progress
from hil.scenario import Scenario
from hil.scenario_joint import I8086, PYTHON
from hil.summary import faults
from hil.timing.computing import BASIS

DEEPEST = (1, 0, 0, -(1 << 31), 0, 0, 0x7FFF, 0, 0, 0)
"""Arguments of a step in which d saturates, and its code calls once more."""


@dataclass(frozen=True)
class Study:
    """What was found, and the faults that ended the run; none if it came to its end."""

    scenario: Scenario
    found: dict[str, Any]
    faults: list[dict[str, Any]]


def with_machine_code(name_or_path: str, settings: list[str]) -> Scenario:
    """Return a scenario with all joints of machine code; raise ScenarioError where one cannot be."""
    asked = with_clock(settings, "virtual")
    scenario = scenario_file.load(name_or_path, asked)
    joints = range(1, scenario.joints + 1)
    for n in joints:
        if scenario.cpu(n) not in (PYTHON, I8086):
            raise ScenarioError(
                f"joint{n}: cpu = {scenario.cpu(n)!r}: there is machine code of firmware_py.joint_cpu's step alone: "
                f"take cpu = {PYTHON!r} or {I8086!r}, or another scenario"
            )
    return scenario_file.load(name_or_path, [*asked, f"joint.cpu={I8086}", *(f"joint{n}.cpu={I8086}" for n in joints)])


def study(scenario: Scenario, progress: Progress = no_progress) -> Study:
    """Run a scenario whose joints are all of machine code, on boards that count; `cost` is None where none stepped."""
    outcome, boards = profile(scenario, progress)
    found = {
        "scenario": scenario.name,
        "period_s": scenario.clock.period_s,
        "bitrate": scenario.bus.bitrate,
        "frame_log_sha256": outcome.log.sha256(),
        "basis": BASIS,
        "law": operations_of_the_law()._asdict(),
        "joints": [_joint(scenario, n, boards[n]) for n in sorted(boards)],
        "bytes": _bytes(boards.values()),
        "clocks": by_clock(scenario),
        "cost": _cost(scenario.joints, list(boards.values())),
    }
    return Study(scenario, found, faults(outcome))


def operations_of_the_law() -> Operations:
    """Return the multiplications and additions of firmware_py's step, which has no branch: one step says it."""
    words: Any = InstrumentedWords(16, len(SIGNALS))
    make_step(InstrumentedWords)(words, *(0,) * 10)
    return Operations(words.multiplications, words.additions)


def _joint(scenario: Scenario, number: int, board: CountingBoard) -> dict[str, Any]:
    """Return what one joint's step and interrupt took, and their bounds: straight where nothing saturates."""
    steps = len(board.taken)
    return {
        "joint": number,
        "shift": straight_line.shift_of(scenario, number),
        "steps": steps,
        "saturated_steps": board.saturated_steps,
        "multiplications": board.spread("multiplications")._asdict(),
        "additions": board.spread("additions")._asdict(),
        "step": {
            "instructions": board.spread("step_instructions")._asdict(),
            "clocks": board.spread("step_clocks")._asdict(),
            "straight": straight_line.step_clocks(scenario, number)[1],
            "bounds": straight_line.step_bounds(scenario, number),
        },
        "interrupt": {
            "instructions": board.spread("instructions")._asdict(),
            "clocks": board.spread("clocks")._asdict(),
            "straight": straight_line.most_clocks(scenario, number),
            "bounds": straight_line.interrupt_bounds(scenario, number),
        },
        "clocks_by_kind": {kind: clocks / max(steps, 1) for kind, clocks in board.clocks_by_kind().items()},
    }


def _bytes(boards: Iterable[CountingBoard]) -> dict[str, int]:
    """Return what the machine code takes of memory; stack: as deep as in the run, and where d saturates."""
    deepest = CountingBoard()
    deepest.step(Words(16, len(SIGNALS)), *DEEPEST)
    return {
        "entries": image.INTERRUPT,
        "interrupt": image.STEP - image.INTERRUPT,
        "step": image.SATURATING - image.STEP,
        "saturating": len(image.CODE) - image.SATURATING,
        "code": len(image.CODE),
        "data": image.DATA_BYTES,
        "stack": max(board.stack_bytes for board in boards),
        "stack_saturating": deepest.stack_bytes,
    }


def _cost(joints: int, boards: Sequence[CountingBoard]) -> dict[str, Any] | None:
    """Return the step beside inverse dynamics, by the means of all steps of all joints."""
    taken = [each for board in boards for each in board.taken]
    if not taken:
        return None
    imul = sum(board.clocks_by_kind()[IMUL] for board in boards) / sum(each.multiplications for each in taken)
    return beside_newton_euler(joints, imul, fmean(each.step_clocks for each in taken))
