"""A sweep from its file to its table: what is missing is run in chunks, a part on disk as each comes."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from contextlib import AbstractContextManager
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil import scenario_file
from hil.assemble import build_nodes
from hil.errors import NodeError, OutputError, ScenarioError
from hil.interrupts import held_back
from hil.sweep.crew import Crew
from hil.sweep.folder import Folder, Key
from hil.sweep.paths import FACTOR, Base
from hil.sweep.row import rows
from hil.sweep.sampling import Point, points
from hil.sweep.summary import summarise
from hil.sweep.sweep_file import SweepFile
from hil.sweep.table import Columns, columns, schema, table

CHUNK = 8
"""Points of a task at most: some tenths of a second, small beside what a kill may cost."""
WAITING = 4
"""Tasks submitted for everyone at work: nobody waits, and few are lost."""

Step = Callable[[dict[str, int]], None]
"""Told the points done, by status."""
Hire = Callable[[], AbstractContextManager[Crew]]
Notice = Callable[[str], None]


@dataclass(frozen=True)
class Plan:
    """What is to be run. bases: by sweep; numbers: the place of each row in the table."""

    file: SweepFile
    points: list[Point]
    bases: dict[str, Base]
    columns: Columns

    @property
    def numbers(self) -> dict[Key, int]:
        """The place of each row in the table, by sweep and index."""
        return {(point.sweep, point.index): number for number, point in enumerate(self.points)}


def plan(file: SweepFile) -> Plan:
    """Return what a file asks for; raise ScenarioError where a sweep cannot begin."""
    found = points(file)
    bases = {sweep.name: _base(file, sweep) for sweep in file.sweep}
    for name, base in bases.items():
        _check_some_run(name, base, [point for point in found if point.sweep == name])
    return Plan(file, found, bases, columns(found, max(base.joints for base in bases.values())))


def _base(file: SweepFile, sweep: Any) -> Base:
    values = deepcopy(file.scenario)
    asked = f"sweep {sweep.name}"
    for path, value in sweep.fixed.items():
        scenario_file.put(values, path, value, f"{asked}: set {path}")
    try:
        base = Base.of(values)
        base.check_factors(path for path in sweep.vary if path.endswith(FACTOR))
    except ScenarioError as error:
        raise ScenarioError(f"{asked}: {error}") from None
    return base


def _check_some_run(name: str, base: Base, chosen: list[Point]) -> None:
    """Refuse a sweep none of whose points can be run."""
    first = ""
    for point in chosen:
        try:
            build_nodes(base.scenario(point.values))
            return
        except ScenarioError as error:
            first = first or f"point 0, {point.values}: {error}"
    raise ScenarioError(f"sweep {name}: the scenario refuses all {len(chosen)} points; {first}")


def carry_out(plan: Plan, folder: Folder, crew: Hire, step: Step, notice: Notice) -> dict[str, Any]:
    """Run what is missing in a folder, and write its table; return the summary.

    Raises OutputError, NodeError, ChannelError; what is done is kept then.
    """
    form, numbers = schema(plan.columns), plan.numbers
    there, missing = _sorted_out(folder.read(form, notice), plan)
    if len(there) and missing:
        notice(f"{len(there)} of {len(plan.points)} points are in {folder.path} already")
    done = count(there)
    step(done)
    if missing:
        with crew() as hands:
            for first, found in _finished(hands, plan.bases, missing):
                folder.add(numbers[first[0].sweep, first[0].index], table(found, first, plan.columns))
                for row in found:
                    done[row["status"]] = done.get(row["status"], 0) + 1
                step(done)
        there, missing = _sorted_out(folder.read(form, notice), plan)
    if missing:
        raise OutputError(f"sweep folder {folder.path}: {len(missing)} rows went missing: give the same command again")
    summary = summarise(plan.file, there)
    folder.finish(there, summary)
    return summary


def count(there: Any) -> dict[str, int]:
    """Return the rows of a table by status."""
    return {each["values"]: each["counts"] for each in there["status"].combine_chunks().value_counts().to_pylist()}


def _sorted_out(there: Any, plan: Plan) -> tuple[Any, list[Point]]:
    """Return the rows in the order of the points, each once, and the points that have none."""
    keys = zip(there["sweep"].to_pylist(), there["index"].to_pylist(), strict=True)
    numbers = plan.numbers
    places = {numbers[key]: row for row, key in enumerate(keys) if key in numbers}
    rows = there.take(np.array([places[number] for number in sorted(places)], dtype=np.int64))
    return rows, [point for number, point in enumerate(plan.points) if number not in places]


def _finished(
    crew: Crew, bases: dict[str, Base], missing: list[Point]
) -> Iterator[tuple[list[Point], list[dict[str, Any]]]]:
    """Yield chunks of points with their rows as they come."""
    waiting = deque(_chunks(missing, crew.size))
    running: dict[Future[list[dict[str, Any]]], list[Point]] = {}
    while waiting or running:
        with held_back():  # a worker begins with the signals that are held back then: Ctrl-C is not for it
            while waiting and len(running) < WAITING * crew.size:
                chunk = waiting.popleft()
                running[crew.executor.submit(rows, bases[chunk[0].sweep], chunk)] = chunk
        done, _ = wait(running, timeout=1.0, return_when=FIRST_COMPLETED)
        if not done:
            crew.check()
        for future in done:
            yield running.pop(future), _result(future)


def _result(future: Future[list[dict[str, Any]]]) -> list[dict[str, Any]]:
    try:
        return future.result()
    except (BrokenExecutor, CancelledError):
        raise NodeError(
            "a worker died in the middle of its points (killed, or out of memory?): what is done is kept; "
            "give the same command again, perhaps with fewer --jobs"
        ) from None


def _chunks(missing: list[Point], size: int) -> Iterator[list[Point]]:
    """Yield points of one sweep each, few enough that all workers have some."""
    length = max(1, min(CHUNK, len(missing) // (WAITING * size)))
    chunk: list[Point] = []
    for point in missing:
        if chunk and (len(chunk) == length or point.sweep != chunk[0].sweep):
            yield chunk
            chunk = []
        chunk.append(point)
    yield chunk
