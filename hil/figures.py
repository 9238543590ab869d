"""The figures of a run with the observer and one without: joint response, deviation, task space, disturbance.

Each as PNG and SVG, the same bytes from the same signals. Colours of M. Okabe and K. Ito's colour-blind safe set.

Ref: the paper's eqs. (3)-(4), figs. 15 and 16.
"""

import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.errors import MissingExtraError
from hil.evaluate import Array, Evaluation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Style = dict[str, Any]
Draw = Callable[["Figure", Evaluation, Evaluation], str]

WIDTH_IN = 7.2
"""Text width of an A4 page."""

RC: Style = {
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.titlelocation": "left",
    "axes.linewidth": 0.6,
    "axes.formatter.useoffset": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.xmargin": 0.0,
    "legend.frameon": False,
    "lines.solid_capstyle": "butt",
    "svg.fonttype": "none",  # text stays text: to be found, and small
    "svg.hashsalt": "hil",
}

COMMAND: Style = {"label": "command", "color": "black", "linestyle": "--", "linewidth": 0.9, "zorder": 4}
WITH: Style = {"label": "with observer", "color": "#0072B2", "linewidth": 1.5, "zorder": 3}
WITHOUT: Style = {"label": "without observer", "color": "#D55E00", "linewidth": 1.5, "zorder": 2}
RESPONSE: Style = WITH | {"label": "response, with observer"}
TRUE: Style = {"label": "true sum of the terms", "color": "#999999", "linewidth": 2.4, "zorder": 2}
ESTIMATE: Style = WITH | {"label": "estimate", "linewidth": 0.9}
LOAD: Style = {"color": "#CC79A7", "linestyle": "-.", "linewidth": 1.1, "zorder": 1}
FINAL: Style = {"label": "last 100 ms (final)", "color": "#F0E442", "alpha": 0.5, "linewidth": 0.0, "zorder": 0}

TERMS: dict[str, Style] = {
    "inertia_variation": {"label": "inertia variation", "color": "#0072B2"},
    "coriolis": {"label": "Coriolis, centrifugal", "color": "#E69F00"},
    "gravity": {"label": "gravity", "color": "#009E73"},
    "viscous": {"label": "viscous", "color": "#56B4E9", "linestyle": (0, (4, 1))},
    "friction": {"label": "friction", "color": "#D55E00", "linestyle": (0, (6, 1, 1, 1))},
    "reaction": {"label": "reaction", "color": "#CC79A7", "linestyle": (0, (2, 1))},
    "ripple": {"label": "torque ripple", "color": "black", "linewidth": 0.6},
}
IF_NONZERO = ("reaction", "ripple")


def write_figures(folder: Path, with_observer: Evaluation, without_observer: Evaluation) -> list[Path]:
    """Write every figure to the folder as PNG (150 dpi) and SVG; return their paths."""
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtraError(
            "figures are drawn by matplotlib, which is not installed: pip install 'hil[report]'"
        ) from None
    paths = []
    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # whatever the user's matplotlibrc says
        matplotlib.rcParams.update(RC)
        for name, (draw, height_in) in FIGURES.items():
            figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
            title = f"{with_observer.scenario.name}: {draw(figure, with_observer, without_observer)}"
            _finish(figure, with_observer, title)
            paths += _save(figure, folder / name, title)
    return paths


def _save(figure: "Figure", stem: Path, title: str) -> list[Path]:
    png, svg = stem.with_name(stem.name + ".png"), stem.with_name(stem.name + ".svg")
    figure.savefig(png, dpi=150, metadata={"Title": title})
    figure.set_layout_engine("none")  # laid out once for both
    figure.savefig(svg, metadata={"Title": title, "Date": None})
    return [png, svg]


# -- the four figures: each draws its panels and returns what is seen --


def _response(figure: "Figure", on: Evaluation, off: Evaluation) -> str:
    panels = figure.subplots(on.scenario.joints, 2, sharex=True, squeeze=False)
    for n, (angle, current) in enumerate(panels):
        for run, style in ((off, WITHOUT), (on, WITH)):
            _line(angle, run.t_s, run.q[:, n], style)
            _line(current, run.t_s, run.current[:, n], style)
        _line(angle, on.t_s, on.q_cmd[:, n], COMMAND)
        angle.set(title=f"joint {n + 1}", ylabel="angle, rad")
        current.set(title=f"motor {n + 1}", ylabel="current, A")
    return "response of every joint to its command (left) and the motor currents that it takes (right)."


def _deviation(figure: "Figure", on: Evaluation, off: Evaluation) -> str:
    panels = figure.subplots(on.scenario.joints, 2, sharex=True, squeeze=False)
    for column, (run, style) in enumerate(((off, WITHOUT), (on, WITH))):
        final_s = run.t_s[run.final_rows]
        for n, axes in enumerate(panels[:, column]):
            deviation = run.deviation[:, n]
            factor, unit = _angle_unit(_largest(deviation))
            _line(axes, run.t_s, deviation * factor, style)
            axes.axvspan(final_s[0], final_s[-1] + run.scenario.clock.period_s, **FINAL)
            axes.axhline(0.0, color="black", linewidth=0.6)
            final = _rms(deviation[run.final_rows])
            axes.set_title(
                f"({'ab'[column]}) joint {n + 1}: largest {_angle(_largest(deviation))}, final {_angle(final)}"
            )
            axes.set_ylabel(f"deviation, {unit}")
    shares = [_share(_largest(on.deviation[:, n]), _largest(off.deviation[:, n])) for n in range(on.scenario.joints)]
    seen = f"The largest deviation of (b) is {', '.join(shares)} of (a)'s; each panel has its own scale."
    return f"joint deviation without (a) and with (b) the disturbance observer. {seen}"


def _task_space(figure: "Figure", on: Evaluation, off: Evaluation) -> str:
    panels = figure.subplots(4, 2, sharex=True, height_ratios=(3, 3, 2, 2))
    for k, axis in enumerate("xy"):
        x, v, v_deviation, x_deviation = panels[:, k]
        for axes, command, response in ((x, on.x_cmd, on.x), (v, on.v_cmd, on.v)):
            _line(axes, on.t_s, response[:, k] * 100.0, RESPONSE)
            _line(axes, on.t_s, command[:, k] * 100.0, COMMAND)
        x.set(title=f"tip position {axis}", ylabel=f"{axis}, cm")
        v.set(title=f"tip velocity {axis}", ylabel="velocity, cm/s")
        _tip_deviation(v_deviation, on.t_s, on.v_cmd[:, k] - on.v[:, k], off.v_cmd[:, k] - off.v[:, k], 100.0, "cm/s")
        _tip_deviation(x_deviation, on.t_s, on.x_cmd[:, k] - on.x[:, k], off.x_cmd[:, k] - off.x[:, k], 1000.0, "mm")
        v_deviation.set_ylabel("velocity\ndeviation, cm/s")
        x_deviation.set_ylabel("position\ndeviation, mm")
    return "the tip follows its command with the observer; below, what remains in velocity and in position."


def _disturbance(figure: "Figure", on: Evaluation, _off: Evaluation) -> str:
    panels = figure.subplots(on.scenario.joints, 2, sharex=True, squeeze=False)
    total = on.disturbance.total()
    for n, (sums, terms) in enumerate(panels):
        _line(sums, on.t_s, total[:, n], TRUE)
        _line(sums, on.t_s, on.estimate[:, n], ESTIMATE)
        sums.set(title=f"joint {n + 1}: estimate over true sum", ylabel="torque, N m")
        for name, style in TERMS.items():
            values = getattr(on.disturbance, name)
            if name not in IF_NONZERO or np.any(values):
                _line(terms, on.t_s, values[:, n], {"linewidth": 1.3} | style)
        terms.set(title=f"joint {n + 1}: terms of eq. (4)", ylabel="torque, N m")
    return "disturbance torque as each joint's observer estimates it (left) and what it truly consists of (right)."


FIGURES: dict[str, tuple[Draw, float]] = {
    "response": (_response, 6.0),
    "deviation": (_deviation, 6.2),
    "task-space": (_task_space, 8.2),
    "disturbance": (_disturbance, 6.6),
}
"""What draws each figure, and its height in inches."""


# -- parts of figures --


def _line(axes: "Axes", t_s: Array, values: Array, style: Style) -> None:
    """Draw one signal, NaN as gaps, and as points where there are too few for a line."""
    axes.plot(t_s, values, marker="." if len(t_s) <= 5 else None, **style)


def _tip_deviation(axes: "Axes", t_s: Array, on: Array, off: Array, factor: float, unit: str) -> None:
    _line(axes, t_s, on * factor, RESPONSE)
    axes.axhline(0.0, color="black", linewidth=0.6)
    axes.set_title(f"largest {_largest(on) * factor:.2g} {unit} (without observer {_largest(off) * factor:.2g} {unit})")


def _finish(figure: "Figure", run: Evaluation, title: str) -> None:
    """Give every panel the same time axis and marks, and the figure its title and one legend."""
    from matplotlib.ticker import MultipleLocator

    duration_s = run.scenario.duration_s
    division_s = next((d for d in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 60.0) if duration_s / d <= 30), duration_s / 10)
    for axes in figure.axes:
        axes.set_xlim(0.0, duration_s)
        axes.xaxis.set_major_locator(MultipleLocator(division_s * (1 if duration_s / division_s <= 6 else 5)))
        axes.xaxis.set_minor_locator(MultipleLocator(division_s))
        axes.grid(which="both", linewidth=0.4, color="0.85")
        axes.tick_params(which="minor", length=0.0)
        _mark_loads(axes, run)
    for axes in figure.axes[-2:]:
        axes.set_xlabel(f"time, s ({division_s * 1000:g} ms a division)")
    figure.align_ylabels()
    figure.suptitle(textwrap.fill(title, 104), x=0.01, ha="left", fontsize=10.0)
    entries = {
        label: line for axes in figure.axes for line, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(entries.values(), entries.keys(), loc="outside lower center", ncols=4)


def _mark_loads(axes: "Axes", run: Evaluation) -> None:
    for load in run.scenario.load:
        label = f"{load.mass_kg:g} kg on the hand, {load.at_s:g} s to {load.until_s:g} s"
        axes.axvline(load.at_s, label=label, **LOAD)
        if load.until_s < run.scenario.duration_s:
            axes.axvline(load.until_s, **LOAD)


# -- numbers --


def _largest(values: Array) -> float:
    return float(np.max(np.abs(values)))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _share(part: float, whole: float) -> str:
    return f"{part / whole * 100.0:.2g} %" if whole > 0.0 else "no finite share"


def _angle_unit(rad: float) -> tuple[float, str]:
    """Return the factor from rad and the name of the unit that fits."""
    if rad < 0.9995e-3:
        return 1e6, "µrad"
    return (1e3, "mrad") if rad < 0.9995 else (1.0, "rad")


def _angle(rad: float) -> str:
    factor, unit = _angle_unit(rad)
    return f"{rad * factor:.3g} {unit}"
