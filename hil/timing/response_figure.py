"""Response times as histograms, a panel a message, with their bounds.

State and Heartbeat share a slot of the cycle, and so a panel.

Ref: M. Okabe, K. Ito, Color Universal Design (the colours).
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dbc.compiler import load_arm
from hil.constants import BY_TURNS
from hil.figures import GRID, WIDTH_IN, drawing
from hil.scenario import Scenario
from hil.timing.measured import Array, by_message, response_ns
from hil.timing.style import finish
from hil.timing.timeline import Timeline

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Row = dict[str, Any]
COLUMNS = 3
MOST_BINS = 50
NEAR = 1.25
"""A deadline up to so many times the bound is drawn; one further away stands in the title alone."""
MEASURED: Row = {"color": "#56B4E9", "label": "measured"}
LINES: dict[str, Row] = {
    "response_bound_actual_s": {"color": "#0072B2", "label": "bound, this run's frames"},
    "response_bound_s": {"color": "#D55E00", "label": "bound, longest frames", "linestyle": "--"},
    "deadline_s": {"color": "black", "label": "deadline, where near", "linestyle": ":"},
}


class Panel(NamedTuple):
    """One message, or those that share a slot: its row of the study, and what was measured, us."""

    name: str
    row: Row
    lasted_us: Array


def write_responses(folder: Path, scenario: Scenario, timeline: Timeline, rows: list[Row]) -> list[Path]:
    """Write responses.png and responses.svg; return their paths. Raises MissingExtraError without matplotlib.

    rows: the messages of the study.
    """
    panels = _panels(scenario, timeline, rows)
    deep = max(1, -(-len(panels) // COLUMNS))
    with drawing():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(WIDTH_IN, 1.1 + 1.5 * deep), layout="constrained")
        places = list(figure.subplots(deep, COLUMNS, squeeze=False).flat)
        for axes, panel in zip(places, panels, strict=False):
            _draw(axes, panel, scenario.bit_ns / 1e3)
        for axes in places[len(panels) :]:
            axes.set_axis_off()
        for axes in places[::COLUMNS]:
            axes.set_ylabel("frames")
        for axes in places[(deep - 1) * COLUMNS : len(panels)]:
            axes.set_xlabel("response time, µs")
        title = f"{scenario.name}: {_seen(panels)}."
        return finish(figure, folder / "responses", title)


def _panels(scenario: Scenario, timeline: Timeline, rows: list[Row]) -> list[Panel]:
    """Return a panel for every message that came, in the order of priority; State and Heartbeat make one."""
    frames = by_message(timeline, scenario, load_arm())
    found: dict[str, tuple[Row, list[float]]] = {}
    for row in rows:
        name = " and ".join(BY_TURNS) if row["name"].startswith(BY_TURNS) else row["name"]
        _, lasted_us = found.setdefault(name, (row, []))
        lasted_us += [response_ns(frame, scenario) / 1e3 for frame in frames.get(row["name"], [])]
    return [Panel(name, row, np.array(lasted_us)) for name, (row, lasted_us) in found.items() if lasted_us]


def _seen(panels: list[Panel]) -> str:
    """Say what was measured at most beside the bounds."""
    ratios = {each.name: float(each.lasted_us.max()) / _us(each.row["response_bound_s"], np.inf) for each in panels}
    if not ratios:
        return "no frame was sent behind the set-up"
    least, most = min(ratios, key=ratios.__getitem__), max(ratios, key=ratios.__getitem__)
    return (
        f"response times, queued to end of intermission; the longest were {ratios[least] * 100:.0f} % ({least}) "
        f"to {ratios[most] * 100:.0f} % ({most}) of the bound with the longest frames"
    )


def _draw(axes: "Axes", panel: Panel, bit_us: float) -> None:
    """Draw the histogram of a message, its bounds, and its deadline where that is near."""
    row, lasted_us = panel.row, panel.lasted_us
    bound_us = _us(row["response_bound_s"], lasted_us.max())
    deadline_us = _us(row["deadline_s"], np.inf)
    right = deadline_us if deadline_us <= NEAR * bound_us else bound_us
    axes.stairs(*np.histogram(lasted_us, _edges(lasted_us, bit_us)), fill=True, **MEASURED)
    for key, style in LINES.items():
        if row[key] is not None and row[key] * 1e6 <= right * (1 + 1e-9):
            axes.axvline(row[key] * 1e6, linewidth=1.2, **style)
    margin = 0.08 * max(right - lasted_us.min(), bit_us)
    axes.set(xlim=(lasted_us.min() - margin - bit_us, right + margin))
    axes.set_title(f"{panel.name}{_deadline(row)}\nmax {lasted_us.max():.4g}, bounds {_bounds(row)} µs", fontsize=7.0)
    axes.tick_params(labelsize=7.0)
    axes.grid(axis="y", **GRID)


def _edges(lasted_us: Array, bit_us: float) -> list[float]:
    """Return bins of whole bit times, each value in the middle of a bit."""
    bits = round(float(np.ptp(lasted_us)) / bit_us) + 1
    width = -(-bits // MOST_BINS)
    first = float(lasted_us.min())
    return [first + bit_us * (k - 0.5) for k in range(0, bits + width, width)]


def _deadline(row: Row) -> str:
    return "" if row["deadline_s"] is None else f", deadline {row['deadline_s'] * 1e6:.4g} µs"


def _bounds(row: Row) -> str:
    return " / ".join(f"{row[key] * 1e6:.4g}" for key in list(LINES)[:2] if row[key] is not None)


def _us(value_s: float | None, otherwise: float) -> float:
    return otherwise if value_s is None else value_s * 1e6
