"""The folder of a sweep: its file, a part for every few points as they come, at the end one table and its summary.

Every file is there whole or not at all. What a killed sweep leaves is read by the next one of the same file, which
runs the points that are missing; a part that cannot be read is put aside, and its points run again.
"""

import fcntl
import json
import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any

from hil.errors import OutputError
from hil.record import explained, parquet
from hil.sweep.table import sha256

SWEEP, PARTS, RESULTS, SUMMARY = "sweep.toml", "parts", "results.parquet", "sweep.json"
HASH = b"hil.sha256"
"""Of the rows of a file, in its metadata: a flipped bit may read as another number."""
PARTIAL, DAMAGED = ".partial", ".damaged"

Key = tuple[str, int]
"""Of a row: sweep and index."""


@contextmanager
def sweep_folder(path: Path, text: str) -> Iterator["Folder"]:
    """Give the folder of the sweep of this text, new or begun by another; nobody else has it. Raise OutputError."""
    with _explained(path):
        path.mkdir(parents=True, exist_ok=True)
        held = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        with _explained(path):
            _hold(path, held)
            _begin(path, text)
            folder = Folder(path)
        try:
            yield folder
        finally:
            if not folder.has_rows:
                folder.remove()
    finally:
        os.close(held)


def _explained(path: Path) -> AbstractContextManager[None]:
    return explained(f"sweep folder {path}", "what it holds is whole: mend it, or take another --out")


def _hold(path: Path, held: int) -> None:
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise OutputError(f"sweep folder {path}: another hil sweep works in it: wait, or take another --out") from None


def _begin(path: Path, text: str) -> None:
    """Write the sweep's file, or see that it is the one that is there."""
    file = path / SWEEP
    if not file.exists():
        if any(not each.name.endswith(PARTIAL) for each in path.iterdir()):
            raise OutputError(f"sweep folder {path} holds something, but no {SWEEP}: choose another --out")
        _write(file, lambda partial: partial.write_text(text))
    there = file.read_text(errors="replace")
    if there != text:
        lines = zip([*there.splitlines(), ""], [*text.splitlines(), ""], strict=False)
        old, new = next(((a, b) for a, b in lines if a != b), ("", ""))
        raise OutputError(
            f"sweep folder {path} holds another sweep: its {SWEEP} has {old!r} where this one has {new!r}: "
            "choose another --out, or remove it"
        )


def _write(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file that takes its name only when everything is in it."""
    partial = path.with_name(path.name + PARTIAL)
    try:
        write(partial)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


class Folder:
    """An open folder of a sweep."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._parquet = parquet("sweeps", "sweep").parquet
        (path / PARTS).mkdir(exist_ok=True)

    @property
    def has_rows(self) -> bool:
        """Whether there is anything to go on with."""
        return bool(self._tables())

    def remove(self) -> None:
        """Remove a folder that holds nothing but the sweep's file."""
        with suppress(OSError):
            (self.path / PARTS).rmdir()
            (self.path / SWEEP).unlink()
            self.path.rmdir()

    def add(self, number: int, rows: Any) -> None:
        """Write a part; number: the first of its points, among all."""
        with _explained(self.path):
            self._write_table(self.path / PARTS / f"part-{number:07d}.parquet", rows)

    def _write_table(self, path: Path, rows: Any) -> None:
        whole = rows.replace_schema_metadata({HASH: sha256(rows)})
        _write(path, lambda partial: self._parquet.write_table(whole, partial))

    def read(self, schema: Any, notice: Callable[[str], None]) -> Any:
        """Return the rows that are there, in no order, as a table; say what was half-written or damaged."""
        pyarrow = parquet("sweeps", "sweep")
        with _explained(self.path):
            for partial in sorted(self.path.rglob(f"*{PARTIAL}")):
                notice(f"{partial} is half-written: removed; its points run again")
                partial.unlink()
            found = [self._read(path, schema, notice) for path in self._tables()]
        return pyarrow.concat_tables([schema.empty_table(), *(each for each in found if each is not None)])

    def _tables(self) -> list[Path]:
        return sorted([*self.path.glob(RESULTS), *self.path.glob(f"{PARTS}/part-*.parquet")])

    def _read(self, path: Path, schema: Any, notice: Callable[[str], None]) -> Any:
        """Return a table; None for one that is damaged, which is put aside."""
        try:
            rows = self._parquet.read_table(path)
            if not rows.schema.equals(schema):
                raise ValueError("its columns are not this sweep's")
            if (rows.schema.metadata or {}).get(HASH) != sha256(rows).encode():
                raise ValueError("its rows are not those that were written")
        except (OSError, ValueError, RuntimeError) as error:  # pyarrow's own are all of these
            aside = path.with_name(path.name + DAMAGED)
            path.replace(aside)
            said = str(error).splitlines()[0].rstrip(".")
            notice(f"{path} is damaged ({said}): put aside as {aside.name}; its points run again")
            return None
        return rows.replace_schema_metadata(None)

    def results(self) -> Any:
        """Return the whole table of a finished sweep."""
        return self._parquet.read_table(self.path / RESULTS)

    def finish(self, rows: Any, summary: dict[str, Any]) -> None:
        """Write the whole table and its summary; remove the parts."""
        text = json.dumps(summary, indent=2, allow_nan=False) + "\n"
        with _explained(self.path):
            self._write_table(self.path / RESULTS, rows)
            _write(self.path / SUMMARY, lambda partial: partial.write_text(text))
            for part in self.path.glob(f"{PARTS}/part-*.parquet"):
                part.unlink()
        with suppress(OSError):  # damaged ones stay
            (self.path / PARTS).rmdir()
