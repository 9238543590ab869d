"""The figure of a run by the machine's clock: which share of all was later than so long.

Ref: M. Okabe, K. Ito, Color Universal Design (the colours).
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.figures import GRID, WIDTH_IN, drawing, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEIGHT_IN = 4.2
COLOURS = {"Sync": "black", "Encoder": "#0072B2", "Current": "#D55E00", "AccelRef": "#009E73"}
DASHES = ("-", "--", "-.", ":")
"""Of joints 1, 2, 3 and so on."""


def write_latency(folder: Path, summary: dict[str, Any]) -> list[Path]:
    """Write latency.png and latency.svg; return their paths. Raises MissingExtraError without matplotlib."""
    figures = summary["real_time"]
    rows = {"Sync, behind its deadline": figures["sync_late"]}
    rows |= {f"{name}, behind Sync": found for name, found in figures["since_sync"].items()}
    with drawing():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), layout="constrained")
        axes = figure.subplots()
        for label, found in rows.items():
            if found is not None:
                _later_than(axes, found, label)
        axes.axvline(figures["period_s"] * 1e6, color="0.4", linewidth=0.9, label="one period", dashes=(1, 1))
        axes.set(xscale="log", yscale="log", xlabel="wall time, µs", ylabel="share of all that was later")
        axes.grid(**GRID)
        pace = f"{figures['pace']:g} of real time" if figures["pace"] < 1 else "real time"
        title = f"{summary['scenario']}: how late everything was by the machine's clock, at {pace}."
        figure.suptitle(title, x=0.01, ha="left", fontsize=10.0)
        figure.legend(loc="outside lower center", frameon=False, ncols=3)
        return save(figure, folder / "latency", title)


def _later_than(axes: "Axes", found: dict[str, Any], label: str) -> None:
    """Draw a frame of every cycle, at the edges of its histogram; State and Heartbeat are late on purpose."""
    kind, _, number = label.partition(",")[0].partition("_")
    if kind not in COLOURS:
        return
    later = 1.0 - np.cumsum([0, *found["counts"]]) / found["count"]
    shown = later > 0.5 / found["count"]
    dash = DASHES[(int(number or 1) - 1) % len(DASHES)]
    axes.plot(np.array(found["edges_s"])[shown] * 1e6, later[shown], dash, color=COLOURS[kind], label=label)
