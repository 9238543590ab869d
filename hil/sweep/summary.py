"""What a finished sweep comes to: sweep.json, without a word of how long it took or who ran it."""

from collections import Counter
from math import isfinite
from typing import Any

from hil.sweep.folder import RESULTS
from hil.sweep.row import OK, REFUSED, STOPPED, TIP
from hil.sweep.sweep_file import Sweep, SweepFile
from hil.sweep.table import sha256


def summarise(file: SweepFile, table: Any) -> dict[str, Any]:
    """Return the summary of a whole table, JSON-ready."""
    paths = list(dict.fromkeys(path for sweep in file.sweep for path in sweep.vary))
    rows = table.select(["sweep", "index", "status", "reason", TIP, *paths]).to_pylist()
    return {
        "scenario": file.name,
        "seed": file.seed,
        **_counted(rows),
        "results": RESULTS,
        "columns": table.column_names,
        "table_sha256": sha256(table),
        "sweeps": [_of_sweep(sweep, [row for row in rows if row["sweep"] == sweep.name]) for sweep in file.sweep],
    }


def _of_sweep(sweep: Sweep, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return a sweep's counts, its best and worst run by the tip's largest deviation, and its first without."""
    run = sorted((row for row in rows if row["status"] == OK and isfinite(row[TIP])), key=lambda row: row[TIP])
    shown = {"best": run[:1], "worst": run[-1:]}
    shown |= {f"first_{status}": [row for row in rows if row["status"] == status][:1] for status in (STOPPED, REFUSED)}
    picked = {key: _picked(sweep, found[0]) if found else None for key, found in shown.items()}
    return {"name": sweep.name, "method": sweep.method, **_counted(rows), **picked}


def _picked(sweep: Sweep, row: dict[str, Any]) -> dict[str, Any]:
    values = {path: row[path] for path in sweep.vary}
    return {key: row[key] for key in ("index", TIP, "reason")} | {"values": values}


def _counted(rows: list[dict[str, Any]]) -> dict[str, int]:
    counts = Counter(row["status"] for row in rows)
    return {"points": len(rows)} | {status: counts[status] for status in (OK, STOPPED, REFUSED)}
