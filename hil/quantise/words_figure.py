"""The figure of all word lengths: each joint's deviation, and where the knee is."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.figures import COLOURS, GRID, WIDTH_IN, drawing
from hil.timing.style import finish

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PANELS = {"max_deviation_rad": "largest, µrad", "final_deviation_rad": "last 100 ms (rms), µrad"}
KNEE: dict[str, Any] = {"color": "0.4", "linestyle": "--", "linewidth": 1.0}


def write_figure(folder: Path, scenario: str, found: dict[str, Any]) -> list[Path]:
    """Write word-lengths as PNG and SVG; return their paths."""
    with drawing():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(WIDTH_IN, 5.0), layout="constrained")
        for axes, (name, label) in zip(figure.subplots(2, 1, sharex=True), PANELS.items(), strict=True):
            _panel(axes, found, name)
            axes.set_ylabel(label)
        axes.set_xlabel("bits of a word")
        return finish(
            figure, folder / "word-lengths", f"{scenario}: joint deviation over the length of the joint CPUs' words."
        )


def _panel(axes: "Axes", found: dict[str, Any], name: str) -> None:
    rows = [row for row in found["lengths"] if row[name] is not None]
    bits = [row["bits"] for row in rows]
    for joint, values in enumerate(zip(*(row[name] for row in rows), strict=True)):
        micro = [value * 1e6 for value in values]
        axes.plot(bits, micro, "o-", color=COLOURS[joint], markersize=3.5, linewidth=1.0, label=f"joint {joint + 1}")
    if found["knee_bits"] is not None:
        axes.axvline(found["knee_bits"], label="knee", **KNEE)
    axes.set_yscale("log")
    axes.grid(**GRID)
