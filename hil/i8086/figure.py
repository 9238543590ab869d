"""The figure of `hil cpu`: where an interrupt's clocks go, and how long it takes beside inverse dynamics."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.figures import COLOURS, GRID, WIDTH_IN, drawing, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

KIND_COLOURS = (*COLOURS, "0.75", "0.45")
MARKS = (("|", "straight, most"), (".", "all paths, most"))
GREYS = ("white", "0.85", "0.6", "0.35")
WIDTH = 0.2
"""Of a bar, of the place of one clock."""


def write_figure(folder: Path, found: dict[str, Any]) -> list[Path]:
    """Write clocks as PNG and SVG; return their paths."""
    with drawing():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(WIDTH_IN, 5.6), layout="constrained")
        above, below = figure.subplots(2, 1, height_ratios=(1, 1.3))
        _kinds(above, found["joints"])
        _times(below, found)
        title = f"{found['scenario']}: an 8086's control interrupt, its clocks and its time, beside inverse dynamics."
        figure.suptitle(title, x=0.01, ha="left", fontsize=10.0)
        for axes in (above, below):
            axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=8.0)
        return save(figure, folder / "clocks", title)


def _kinds(axes: "Axes", joints: list[dict[str, Any]]) -> None:
    """Draw the mean clocks of an interrupt by kind of instruction, a bar a joint."""
    names = [f"joint {joint['joint']}" for joint in joints]
    left = [0.0] * len(joints)
    for kind, colour in zip(joints[0]["clocks_by_kind"], KIND_COLOURS, strict=True):
        clocks = [joint["clocks_by_kind"][kind] for joint in joints]
        axes.barh(names, clocks, left=left, color=colour, label=kind, height=0.6)
        left = [a + b for a, b in zip(left, clocks, strict=True)]
    straight = [joint["interrupt"]["straight"] for joint in joints]
    most = [joint["interrupt"]["bounds"][1] for joint in joints]
    for values, (marker, label) in zip((straight, most), MARKS, strict=True):
        axes.plot(values, names, marker, color="black", markersize=11 if marker == "|" else 6, label=label)
    axes.set_xlim(0, 1.04 * max(most))
    axes.invert_yaxis()
    axes.set_xlabel("clocks of an interrupt, mean of the run")


def _times(axes: "Axes", found: dict[str, Any]) -> None:
    """Draw the times of step and interrupt, and of inverse dynamics of this arm, at each clock."""
    cost = found["cost"]
    this_arm = next(row for row in cost["newton_euler"] if row["joints"] == len(found["joints"]))
    most = max(joint["interrupt"]["bounds"][1] for joint in found["joints"])
    n = this_arm["joints"]
    bars = (
        ("step, mean", cost["step"]["clocks"]),
        ("interrupt, at most", most),
        (f"Newton-Euler, {n} joints,\nalone (estimate)", this_arm["floor_clocks"]),
        (f"Newton-Euler, {n} joints,\nas steps (estimate)", this_arm["clocks_as_the_step"]),
    )
    clocks_hz = [row["clock_hz"] for row in found["clocks"]]
    for k, (label, clocks) in enumerate(bars):
        places = [place + (k - (len(bars) - 1) / 2) * WIDTH for place in range(len(clocks_hz))]
        times = [clocks / clock_hz * 1e6 for clock_hz in clocks_hz]
        drawn = axes.bar(places, times, WIDTH, color=GREYS[k], edgecolor="black", linewidth=0.6, label=label)
        axes.bar_label(drawn, [f"{time:.0f}" for time in times], fontsize=7.0)
    axes.axhline(found["period_s"] * 1e6, color="#D55E00", linewidth=1.0, label="period")
    axes.set_xticks(range(len(clocks_hz)), [f"{clock_hz / 1e6:g} MHz" for clock_hz in clocks_hz])
    axes.set_yscale("log")
    axes.margins(x=0.05, y=0.12)
    axes.set_ylabel("µs")
    axes.grid(axis="y", **GRID)
