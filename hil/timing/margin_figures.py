"""The figures of the margins of a loop: dead time that each joint bears; largest g and Jn over the latency.

Points are measured, lines and bars without filling predicted; a triangle: it does not fail up to there.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hil.figures import GRID, WIDTH_IN, Style, drawing
from hil.timing.limits import DelayMargin, Raised
from hil.timing.margin import Margins
from hil.timing.search import Largest
from hil.timing.style import finish

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MEASURED, PREDICTED, BY_LARGEST = "#0072B2", "black", "#D55E00"


def write_figures(folder: Path, found: Margins) -> list[Path]:
    """Write delay-margins and largest-g-and-jn as PNG and SVG; return their paths. None where the scenario fails."""
    with drawing():
        paths = _delay_margins(folder, found) if found.delay_margins else []
        return paths + (_over_latency(folder, found) if found.largest_g else [])


def _delay_margins(folder: Path, found: Margins) -> list[Path]:
    """Draw a row for every joint and width of jitter."""
    rows = sorted([*found.delay_margins, *found.with_jitter], key=lambda row: (row.joint, row.jitter_s))
    figure = _figure(1.3 + 0.24 * len(rows))
    axes = figure.subplots()
    for place, row in enumerate(rows):
        _bar(axes, place, row)
    axes.set(yticks=range(len(rows)), xlabel="dead time more than the scenario's, µs")
    axes.set_yticklabels([_named(row) for row in rows])
    axes.invert_yaxis()
    axes.margins(x=0.06)
    axes.set_xlim(0.0, None)
    axes.grid(axis="x", **GRID)
    return finish(figure, folder / "delay-margins", f"{found.scenario.name}: the delay that each joint's loop bears.")


def _bar(axes: "Axes", place: int, row: DelayMargin) -> None:
    if row.predicted is not None and row.predicted.value is not None:
        style: Style = {"edgecolor": PREDICTED, "facecolor": "0.92", "linewidth": 0.9}
        what = "sampled loop, mean delay"
        axes.barh(place, row.predicted.value * 1e6, 0.62, label=what, **style)
    if row.jitter_s and row.by_largest is not None and row.by_largest.value is not None:
        at_us = row.by_largest.value * 1e6
        axes.vlines(at_us, place - 0.31, place + 0.31, BY_LARGEST, label="sampled loop, largest delay", linewidth=1.4)
    if row.measured.value is not None:
        mark = ">" if row.measured.beyond else "o"
        axes.plot(row.measured.value * 1e6, place, mark, color=MEASURED, markersize=5, label=_label(row.measured))


def _over_latency(folder: Path, found: Margins) -> list[Path]:
    figure = _figure(3.3)
    g, inertia = figure.subplots(1, 2)
    _points(g, found.largest_g)
    _points(inertia, found.largest_inertia)
    used: Style = {"color": "0.45", "linewidth": 0.9, "linestyle": "--", "label": "the scenario's"}
    g.axhline(found.scenario.joint.g_rad_s, **used)
    inertia.axhline(1.0, **used)
    g.set(title="largest g", ylabel="g, rad/s")
    inertia.set(title="largest Jn of the controllers", ylabel="times the scenario's Jn")
    for axes in (g, inertia):
        axes.margins(x=0.06, y=0.08)
        axes.set(xlabel="sample to action, mean of the joints, µs", ylim=(0.0, None))
        axes.grid(**GRID)
    title = f"{found.scenario.name}: what the loop bears at each latency, all joints delayed alike."
    return finish(figure, folder / "largest-g-and-jn", title)


def _points(axes: "Axes", rows: Sequence[Raised]) -> None:
    found = [(row.latency_s * 1e6, row.predicted) for row in rows]
    known = [(at_us, each.value) for at_us, each in found if each is not None and each.value and not each.beyond]
    if known:
        axes.plot(*zip(*known, strict=True), color=PREDICTED, linewidth=1.0, label="sampled loop")
    for row in rows:
        if row.measured.value is not None:
            mark = "^" if row.measured.beyond else "o"
            style: Style = {"color": MEASURED, "markersize": 5, "label": _label(row.measured)}
            axes.plot(row.latency_s * 1e6, row.measured.value, mark, **style)


def _label(measured: Largest) -> str:
    return "measured: more than this" if measured.beyond else "measured"


def _named(row: DelayMargin) -> str:
    jitter = f"jitter 0 to {row.jitter_s * 1e6:g} µs" if row.jitter_s else "no jitter"
    return f"joint {row.joint}, {jitter}"


def _figure(height_in: float) -> "Figure":
    from matplotlib.figure import Figure

    return Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
