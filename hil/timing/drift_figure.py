"""The figure of joints by their own timers: deviation over time, with the samples that were doubled and missed.

Ref: M. Okabe, K. Ito, Color Universal Design (the colours).
"""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hil.figures import GRID, WIDTH_IN, ZERO, Style, angle_unit, drawing
from hil.timing.drift import Comparison, Slips
from hil.timing.style import finish

if TYPE_CHECKING:
    from matplotlib.axes import Axes

OWN: Style = {"label": "by its own timer", "color": "#D55E00", "linewidth": 1.0, "zorder": 2}
ON_FRAME: Style = {"label": "on the Encoder frame", "color": "#0072B2", "linewidth": 1.0, "zorder": 3}
DOUBLED: Style = {"label": "sample doubled", "color": "black", "marker": "|"}
MISSED: Style = {"label": "sample missed", "color": "#CC79A7", "marker": "|"}
MARK: Style = {"linestyle": "none", "markersize": 7.0, "markeredgewidth": 0.9, "zorder": 4}


def write_drift(folder: Path, found: Comparison) -> list[Path]:
    """Write drift.png and drift.svg; return their paths. Raises MissingExtraError without matplotlib."""
    scenario = found.outcome.scenario
    with drawing():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(WIDTH_IN, 1.2 + 1.6 * scenario.joints), layout="constrained")
        panels = figure.subplots(scenario.joints, 1, sharex=True, squeeze=False)[:, 0]
        for n, axes in enumerate(panels):
            _joint(axes, found, n)
        panels[-1].set(xlabel="time, s", xlim=(0.0, scenario.duration_s))
        figure.align_ylabels()
        title = f"{scenario.name}: joint deviation, sampled by own timers and on the Encoder frame."
        return finish(figure, folder / "drift", title)


def _joint(axes: "Axes", found: Comparison, n: int) -> None:
    """Draw one joint; n counts from 0."""
    own, on_frame = (run.deviation[:, n] for run in (found.own, found.on_frame))
    factor, unit = angle_unit(float(np.max(np.abs(own))))
    ppb = found.outcome.scenario.crystal_ppb(n + 1)
    axes.plot(found.own.t_s, own * factor, **OWN | ({"label": "_"} if ppb is None else {}))
    axes.plot(found.on_frame.t_s, on_frame * factor, **ON_FRAME)
    if ppb is None:
        what = "on the Encoder frame in both runs"
    else:
        slips = found.slips[n + 1]
        _marks(axes, slips)
        what = f"crystal {ppb / 1000:+g} ppm: {len(slips.doubled_s)} samples doubled, {len(slips.missed_s)} missed"
    axes.axhline(0.0, **ZERO)
    axes.grid(**GRID)
    axes.margins(y=0.15)  # for the marks
    axes.set(title=f"joint {n + 1}, {what}", ylabel=f"deviation, {unit}")


def _marks(axes: "Axes", slips: Slips) -> None:
    """Mark the instants along the edges: doubled at the bottom, missed at the top."""
    across = axes.get_xaxis_transform()
    for times_s, height, style in ((slips.doubled_s, 0.05, DOUBLED), (slips.missed_s, 0.95, MISSED)):
        axes.plot(times_s, [height] * len(times_s), transform=across, **style | MARK)
