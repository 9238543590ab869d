"""The whole report, made: its parts measured over a pool of processes, then written as JSON, page and figures."""

import json
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from pathlib import Path

from hil.errors import ScenarioError
from hil.paper.page import write_page
from hil.paper.report import Folder, Section, to_json
from hil.paper.sections import SECTIONS
from hil.pool import pool
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
