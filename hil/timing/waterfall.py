"""Where the time goes: the parts of every chain behind one another, a panel a chain.

A bar is a part's mean and begins where the mean of the part before it ends; its whisker goes to the largest.
"""

from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.figures import GRID, WIDTH_IN, drawing
from hil.timing.style import COMPUTES, HELD, ON_BUS, WAITS, finish

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Row = dict[str, Any]
STEMS = {"sample to action": "waterfall", "sample, DSP, action": "waterfall-dsp"}
"""Of figures, by the chains that they show."""
STYLES = {" waits": WAITS, " on the bus": ON_BUS, " computes": COMPUTES, "held ": HELD}
"""By what a part's name says."""
BOUND: Row = {"label": "bound of the whole", "color": "#D55E00", "linestyle": "--", "linewidth": 1.2}
ROW_IN, SMALL_ROW_IN = 0.165, 0.13
FEW = 3
"""Chains up to which there is room for the higher rows."""


def write_waterfalls(folder: Path, name: str, chains: list[Row]) -> list[Path]:
    """Write waterfall (sample to action) and waterfall-dsp (by the DSP), PNG and SVG; return their paths.

    chains: of the study. Raises MissingExtraError without matplotlib.
    """
    paths = []
    for kind, stem in STEMS.items():
        chosen = [chain for chain in chains if chain["name"].endswith(f": {kind}")]
        if chosen:
            paths += _write(folder / stem, f"{name}: {kind}", chosen)
    return paths


def _write(stem: Path, what: str, chains: list[Row]) -> list[Path]:
    row_in = ROW_IN if len(chains) <= FEW else SMALL_ROW_IN
    with drawing():
        from matplotlib.figure import Figure

        height_in = 1.1 + len(chains) * (0.3 + row_in * len(chains[0]["parts"]))
        figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
        panels = figure.subplots(len(chains), squeeze=False, sharex=True)[:, 0]
        right_us = 1.02 * max(_ends_us(chain) for chain in chains)
        for axes, chain in zip(panels, chains, strict=True):
            _draw(axes, chain, right_us)
        panels[-1].set_xlabel("time since the sample, µs")
        title = f"{what}, {_seen(chains)}."
        return finish(figure, stem, title)


def _ends_us(chain: Row) -> float:
    """Return what a panel has to show: the bound, or the largest where there is none."""
    parts_s = sum(part["max_s"] or 0.0 for part in chain["parts"])
    return 1e6 * float(chain["bound_s"] or parts_s or chain["deadline_s"])


def _seen(chains: list[Row]) -> str:
    """Say how long the longest was beside its bound."""
    came = [chain for chain in chains if chain["measured"] is not None]
    if not came:
        return "which never came to its end"
    longest = max(came, key=lambda chain: float(chain["measured"]["max_s"]))
    bound_s = longest["bound_s"]
    bound = "" if bound_s is None else f" (bound {bound_s * 1e6:.4g} µs)"
    return f"at most {longest['measured']['max_s'] * 1e6:.4g} µs{bound}"


def _draw(axes: "Axes", chain: Row, right_us: float) -> None:
    """Draw the parts of a chain from top to bottom, and the bound of the whole."""
    parts = chain["parts"]
    rows = range(len(parts))
    means_us, most_us = ([1e6 * (part[key] or 0.0) for part in parts] for key in ("mean_s", "max_s"))
    ends_us = list(accumulate(means_us))
    beyond_us = [max(0.0, most - mean) for most, mean in zip(most_us, means_us, strict=True)]
    for k, part in enumerate(parts):
        _draw_part(axes, k, part, ends_us[k] - means_us[k], ends_us[k] - means_us[k] > _ends_us(chain) / 2)
    no_us = [0.0 for _ in rows]
    axes.errorbar(ends_us, rows, xerr=[no_us, beyond_us], fmt="none", ecolor="black", capsize=2.0, elinewidth=0.8)
    if chain["bound_s"] is not None:
        axes.axvline(chain["bound_s"] * 1e6, **BOUND)
    axes.set(yticks=rows, xlim=(0.0, right_us), ylim=(len(rows) - 0.4, -0.6))
    axes.set_yticklabels([part["name"] for part in parts], fontsize=6.5)
    axes.set_title(f"joint {chain['joint']}: {_figures(chain)}", fontsize=8.0)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", **GRID)


def _draw_part(axes: "Axes", k: int, part: Row, begins_us: float, text_before: bool) -> None:
    """Draw the bar of one part, and its figures behind or before it."""
    style: Row = {"textcoords": "offset points", "va": "center", "fontsize": 6.0}
    if part["mean_s"] is None:
        axes.annotate("never", (begins_us, k), (4, 0), **style)
        return
    mean_us, most_us = part["mean_s"] * 1e6, part["max_s"] * 1e6
    axes.barh(k, mean_us, 0.72, begins_us, **next(look for word, look in STYLES.items() if word in part["name"]))
    text = f"{mean_us:.0f}" if most_us - mean_us < 0.5 else f"{mean_us:.0f}, max {most_us:.0f}"
    if text_before:
        axes.annotate(text, (begins_us, k), (-3, 0), ha="right", **style)
    else:
        axes.annotate(text, (begins_us + most_us, k), (4, 0), **style)


def _figures(chain: Row) -> str:
    found, bound_s = chain["measured"], chain["bound_s"]
    if found is None:
        return "no cycle came to its end"
    bound = "" if bound_s is None else f", bound {bound_s * 1e6:.4g}"
    return f"{found['p50_s'] * 1e6:.4g} µs in the median, at most {found['max_s'] * 1e6:.4g}{bound}"
