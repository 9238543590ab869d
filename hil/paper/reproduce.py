"""The whole report, made: its parts measured over a pool of processes, then written as JSON, page and figures."""

import json
import multiprocessing
import signal
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager, nullcontext
from pathlib import Path

from hil.errors import ScenarioError
from hil.paper.page import write_page
from hil.paper.report import Folder, Section, to_json
from hil.paper.sections import SECTIONS
from hil.record import run_folder

VALUES = "paper.json"


def reproduce(
    out: Path | None, jobs: int | None, step: Callable[[float], None], only: Collection[str] = ()
) -> list[Section]:
    """Measure all parts, or only these, and write them to the folder, whole or not at all; return them.

    step: told the share done. Raises ScenarioError for a part that is not there.
    """
    unknown = sorted(set(only) - SECTIONS.keys())
    if unknown:
        raise ScenarioError(f"the report has no part {unknown[0]!r}: it has {', '.join(SECTIONS)}")
    names = [name for name in SECTIONS if name in only or not only]
    with pool(jobs) as executor, nullcontext() if out is None else run_folder(out) as folder:
        sections = list(_measured(names, executor, folder, step))
        if folder is not None:
            (folder / VALUES).write_text(json.dumps(to_json(sections), indent=2, allow_nan=False) + "\n")
            write_page(folder, sections)
    return sections


def _measured(
    names: Sequence[str], executor: Executor, folder: Folder, step: Callable[[float], None]
) -> Iterator[Section]:
    for done, name in enumerate(names):
        step(done / len(names))
        yield SECTIONS[name](executor, folder)


@contextmanager
def pool(jobs: int | None) -> Iterator[Executor]:
    """Give processes for independent runs; on the way out of an error, those not begun are dropped."""
    # spawned: a fork would take over the threads of a progress bar in the middle of what they do
    executor = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _leave_signals_to_the_parent)
    try:
        yield executor
    finally:
        executor.shutdown(cancel_futures=True)


def _leave_signals_to_the_parent() -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
