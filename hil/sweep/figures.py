"""The figures that a sweep file asks for, from its table: lines, a heat map, a Pareto front; a panel a joint.

A front is what no other point beats in both: fewer of x and less of y. Points without figures are left out.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.figures import GRID, WIDTH_IN, drawing
from hil.sweep.columns import OF_A_JOINT, OK
from hil.sweep.sweep_file import Figure, Sweep
from hil.timing.style import finish

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Rows = list[dict[str, Any]]
HEIGHT_IN = 2.3
WIDE = 10
FRONT: dict[str, Any] = {"color": "#D55E00", "linewidth": 1.2, "label": "front"}
POINT: dict[str, Any] = {"color": "#0072B2", "markersize": 3.0, "alpha": 0.6, "label": "a run"}


def write_figures(folder: Path, sweeps: Iterable[Sweep], table: Any, joints: int) -> list[Path]:
    """Write a figure of each sweep that asks for one, as PNG and SVG; return their paths. Raise MissingExtraError."""
    asked = [sweep for sweep in sweeps if sweep.figure is not None]
    if not asked:
        return []
    rows = [row for row in table.to_pylist() if row["status"] == OK]
    with drawing():
        return [path for sweep in asked for path in _figure(folder, sweep, rows, joints)]


def _figure(folder: Path, sweep: Sweep, rows: Rows, joints: int) -> list[Path]:
    from matplotlib.figure import Figure as Canvas

    asked = sweep.figure
    assert asked is not None
    shown = asked.value or asked.y
    columns = [f"{shown}_{n}" for n in range(1, joints + 1)] if shown in OF_A_JOINT else [shown]
    canvas = Canvas(figsize=(WIDTH_IN, 0.8 + HEIGHT_IN * len(columns)), layout="constrained")
    draw = {"lines": _lines, "heat-map": _heat_map, "pareto": _pareto}[asked.kind]
    own = [row for row in rows if row["sweep"] == sweep.name]
    panels = canvas.subplots(len(columns), 1, sharex=True, squeeze=False)[:, 0]
    for axes, column in zip(panels, columns, strict=True):
        there = [row for row in own if row[column] is not None and np.isfinite(row[column])]
        if there:
            draw(axes, asked, there, column)
    panels[-1].set_xlabel(asked.x)
    over = f"{asked.x} and {asked.y}; white: none" if asked.kind == "heat-map" else asked.x
    return finish(canvas, folder / sweep.name, f"Sweep {sweep.name}: {shown} over {over}.")


def _lines(axes: "Axes", asked: Figure, rows: Rows, column: str) -> None:
    for place, by in enumerate(_distinct(rows, asked.by)):
        own = sorted((row for row in rows if asked.by is None or row[asked.by] == by), key=lambda row: row[asked.x])
        label = column if asked.by is None else f"{asked.by.rpartition('.')[2]} {_number(by)}"
        x, y = [row[asked.x] for row in own], [row[column] for row in own]
        axes.plot(x, y, "o-", color=f"C{place}", markersize=3.0, linewidth=1.0, label=label)
    _finish(axes, column, [row[asked.x] for row in rows], [row[column] for row in rows])


def _finish(axes: "Axes", column: str, x: Sequence[Any], y: Sequence[float]) -> None:
    """Give y a logarithmic scale where it has one, x where it covers much; and the ends some room."""
    numbers = all(isinstance(each, int | float) for each in x)
    axes.set(ylabel=column, yscale="log" if min(y) > 0 else "linear")
    if numbers and min(x) > 0 and max(x) >= WIDE * min(x):
        axes.set_xscale("log")
    axes.margins(x=0.03)
    axes.grid(**GRID)


def _heat_map(axes: "Axes", asked: Figure, rows: Rows, column: str) -> None:
    x, y = (_distinct(rows, name) for name in (asked.x, asked.y))
    values = np.full((len(y), len(x)), np.nan)
    for row in rows:
        values[y.index(row[asked.y]), x.index(row[asked.x])] = row[column] or np.nan  # white: no logarithm
    norm = "log" if np.nanmin(values, initial=np.inf) < np.inf and np.nanmin(values) > 0 else "linear"
    drawn = axes.pcolormesh(range(len(x)), range(len(y)), values, norm=norm, cmap="viridis", shading="nearest")
    axes.set_xticks(range(len(x)), [_number(each) for each in x], rotation=20, ha="right")
    axes.set_yticks(range(len(y)), [_number(each) for each in y])
    axes.set_ylabel(asked.y)
    axes.figure.colorbar(drawn, ax=axes, label=column)


def _pareto(axes: "Axes", asked: Figure, rows: Rows, column: str) -> None:
    points = [(row[asked.x], row[column]) for row in rows]
    axes.plot(*zip(*points, strict=True), "o", **POINT)
    axes.step(*zip(*front(points), strict=True), where="post", **FRONT)
    _finish(axes, column, *zip(*points, strict=True))


def front(points: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the points that no other has less of both than, by x."""
    kept: list[tuple[float, float]] = []
    for x, y in sorted(points):
        if not kept or y < kept[-1][1]:
            kept.append((x, y))
    return kept


def _distinct(rows: Rows, name: str | None) -> list[Any]:
    return [None] if name is None else sorted({row[name] for row in rows})


def _number(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
