"""What the figures of a study share: a colour for whatever takes time, the title and the legend.

Ref: M. Okabe, K. Ito, Color Universal Design (the colours).
"""

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.figures import save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Style = dict[str, Any]
WAITS: Style = {"label": "waits for the bus", "color": "#56B4E9", "alpha": 0.45}
ON_BUS: Style = {"label": "on the bus", "color": "#0072B2"}
COMPUTES: Style = {"label": "computes", "color": "#E69F00"}
HELD: Style = {"label": "held", "color": "0.6"}
LETTERS = 92
"""A line of a title."""


def finish(figure: "Figure", stem: Path, title: str) -> list[Path]:
    """Give a figure its title and one legend of all its panels; write it as PNG and SVG; return their paths."""
    figure.suptitle(textwrap.fill(title, LETTERS), x=0.01, ha="left", fontsize=10.0)
    entries: dict[str, Any] = {}
    for axes in figure.axes:
        lines, labels = axes.get_legend_handles_labels()
        entries |= dict(zip(labels, lines, strict=True))
    style: Style = {"loc": "outside lower center", "frameon": False, "fontsize": 8.0, "ncols": max(1, len(entries))}
    figure.legend(entries.values(), entries.keys(), **style)
    return save(figure, stem, title)
