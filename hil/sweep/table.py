"""The table of a sweep: its columns, which are known before the first run, and its hash."""

import hashlib
import json
from collections.abc import Iterable
from typing import Any

from hil.record import parquet
from hil.sweep.row import OF_A_JOINT, OF_A_RUN, TIP
from hil.sweep.sampling import Point

TEXT, WHOLE, REAL, TRUTH = "string", "int64", "float64", "bool"

Columns = dict[str, str]
"""The type of every column, by name, in order."""


def columns(points: Iterable[Point], joints: int) -> Columns:
    """Return the columns of these points, of arms of up to so many joints."""
    kinds: dict[str, set[type]] = {}
    for point in points:
        for path, value in point.values.items():
            kinds.setdefault(path, set()).add(type(value))
    return {
        "sweep": TEXT,
        "index": WHOLE,
        **{path: _kind(found) for path, found in kinds.items()},
        "status": TEXT,
        "reason": TEXT,
        **{f"{name}_{n}": REAL for name in OF_A_JOINT for n in range(1, joints + 1)},
        **dict.fromkeys(OF_A_RUN, WHOLE),
        TIP: REAL,
    }


def _kind(found: set[type]) -> str:
    """Return the type that holds all of these; lists, tables and mixtures are JSON texts."""
    if found == {bool}:
        return TRUTH
    if found == {int}:
        return WHOLE
    return REAL if found <= {int, float} else TEXT


def schema(kinds: Columns) -> Any:
    """Return the table's schema for pyarrow; raise MissingExtraError."""
    pyarrow = parquet("sweeps", "sweep")
    return pyarrow.schema([(name, pyarrow.type_for_alias(kind)) for name, kind in kinds.items()])


def table(rows: list[dict[str, Any]], points: list[Point], kinds: Columns) -> Any:
    """Return the rows of these points as a table; what is not in a row is null."""
    whole = [
        row | {path: _as(kinds[path], value) for path, value in point.values.items()}
        for row, point in zip(rows, points, strict=True)
    ]
    return parquet("sweeps", "sweep").Table.from_pylist(whole, schema(kinds))


def _as(kind: str, value: Any) -> Any:
    if kind == REAL:
        return float(value)
    return json.dumps(value) if kind == TEXT and not isinstance(value, str) else value


def sha256(rows: Any) -> str:
    """Return the hash of a table: of its column names and its rows in order, each a line of JSON.

    Floats are written as the shortest decimals that read back as the same number; no time of the wall's is among them.
    """
    found = hashlib.sha256(json.dumps(rows.column_names).encode() + b"\n")
    for batch in rows.to_batches():
        for row in batch.to_pylist():
            found.update(json.dumps([*row.values()]).encode() + b"\n")
    return found.hexdigest()
