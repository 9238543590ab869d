"""The figures of a run with the observer and one without: joint response, deviation, task space, disturbance.

Each as PNG and SVG, the same bytes from the same signals.

Ref: the paper's eqs. (3)-(4), figs. 15 and 16; M. Okabe, K. Ito, Color Universal Design (the colours).
"""

import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.errors import MissingExtraError
from hil.evaluate import Array, Evaluation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Style = dict[str, Any]
WIDTH_IN = 7.2  # text width of an A4 page
RC: dict[Any, Style] = {
    "agg.path": {"chunksize": 20_000},  # long noisy runs otherwise exceed what Agg can hold
    "axes": {"titlesize": 9.0, "titlelocation": "left", "linewidth": 0.6, "axisbelow": True, "xmargin": 0.0},
    "axes.spines": {"top": False, "right": False},
    "font": {"size": 9.0},
    "svg": {"fonttype": "none", "hashsalt": "hil"},  # text stays text: to be found, and small
}

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Of joints, and of whatever else is counted."""
WITH: Style = {"label": "with observer", "color": "#0072B2", "linewidth": 1.4, "zorder": 3}
WITHOUT: Style = {"label": "without observer", "color": "#D55E00", "linewidth": 1.4, "zorder": 2.5}
WIDE, FINE = {"linewidth": 2.4}, {"linewidth": 0.6, "zorder": 2.2}
COMMAND: Style = {"label": "command", "color": "black", "linestyle": "--", "linewidth": 0.9, "zorder": 4}
ESTIMATE: Style = {"label": "estimate", "color": "#56B4E9", "linewidth": 2.0}
TRUE: Style = {"label": "true sum of the terms", "color": "black", "linewidth": 0.7, "zorder": 3}
FINAL: Style = {"label": "last 100 ms (final)", "color": "#F0E442", "alpha": 0.5, "linewidth": 0.0, "zorder": 0}
LOAD: Style = {"color": "0.3", "linestyle": "-.", "linewidth": 0.9, "zorder": 1}
ZERO: Style = {"color": "black", "linewidth": 0.6, "zorder": 1}
GRID: Style = {"color": "0.85", "linewidth": 0.5, "zorder": 0.5}

TERMS: dict[str, Style] = {
    "inertia_variation": {"label": "inertia variation", "color": "#CC79A7", "linewidth": 0.8},
    "coriolis": {"label": "Coriolis, centrifugal", "color": "#E69F00"},
    "gravity": {"label": "gravity", "color": "#009E73"},
    "viscous": {"label": "viscous", "color": "#0072B2", "linestyle": (0, (5, 1))},
    "friction": {"label": "friction", "color": "#D55E00"},
    "reaction": {"label": "reaction", "color": "black", "linestyle": (0, (2, 1))},
    "ripple": {"label": "torque ripple", "color": "0.5", "linewidth": 0.8},
}
DIVISIONS_S = (0.001, 0.01, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)


@contextmanager
def drawing() -> Iterator[None]:
    """Draw in our style whatever the user's matplotlibrc says; raise MissingExtraError where there is no matplotlib."""
    try:
        import matplotlib
    except ImportError:
        raise MissingExtraError("figures need matplotlib, which is not installed: pip install 'hil[report]'") from None
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        for group, values in RC.items():
            matplotlib.rc(group, **values)
        yield


def write_figures(folder: Path, with_observer: Evaluation, without_observer: Evaluation) -> list[Path]:
    """Write every figure to the folder as PNG (150 dpi) and SVG; return their paths."""
    paths = []
    with drawing():
        from matplotlib.figure import Figure

        for name, (draw, height_in, joint_in) in FIGURES.items():
            height_in += joint_in * with_observer.scenario.joints
            figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
            title = f"{with_observer.scenario.name}: {draw(figure, with_observer, without_observer)}"
            _finish(figure, with_observer, title)
            paths += save(figure, folder / name, title)
    return paths


def save(figure: "Figure", stem: Path, title: str) -> list[Path]:
    """Write a figure as PNG (150 dpi) and SVG, the same bytes from the same values; return their paths."""
    paths = [stem.with_name(stem.name + suffix) for suffix in (".png", ".svg")]
    figure.savefig(paths[0], dpi=150, metadata={"Title": title})
    figure.set_layout_engine(None)  # laid out once for both
    figure.savefig(paths[1], metadata={"Title": title, "Date": None})
    return paths


def _response(figure: "Figure", on: Evaluation, off: Evaluation) -> str:
    panels = figure.subplots(on.scenario.joints, 2, sharex=True, squeeze=False)
    for n, (angle, current) in enumerate(panels):
        _line(angle, off.t_s, off.q[:, n], WITHOUT | WIDE)
        _line(angle, on.t_s, on.q[:, n], WITH | WIDE)
        _line(current, off.t_s, off.current[:, n], WITHOUT)
        _line(current, on.t_s, on.current[:, n], WITH | FINE)
        _line(angle, on.t_s, on.q_cmd[:, n], COMMAND)
        angle.set(title=f"joint {n + 1}: angle", ylabel="angle, rad")
        current.set(title=f"joint {n + 1}: motor current", ylabel="current, A")
    return "the response of every joint to its command, and the motor currents that it takes."


def _deviation(figure: "Figure", on: Evaluation, off: Evaluation) -> str:
    panels = figure.subplots(on.scenario.joints, 2, sharex=True, squeeze=False)
    for letter, run, style, column in zip("ab", (off, on), (WITHOUT, WITH), panels.T, strict=True):
        for n, axes in enumerate(column):
            _joint_deviation(axes, run, run.deviation[:, n], f"({letter}) joint {n + 1}", style)
    shares = np.max(np.abs(on.deviation), axis=0) / np.maximum(np.max(np.abs(off.deviation), axis=0), 1e-12)
    seen = f"The largest of (b) is {', '.join(f'{share:.1f}' for share in shares * 100.0)} % of that of (a)"
    return f"joint deviation (a) without and (b) with the disturbance observer. {seen}; every panel has its own scale."


def _task_space(figure: "Figure", on: Evaluation, off: Evaluation) -> str:
    panels = figure.subplots(4, 2, sharex=True, height_ratios=(3, 3, 2, 2))
    for k, (x, v, v_deviation, x_deviation) in enumerate(panels.T):
        for axes, command, response in ((x, on.x_cmd, on.x), (v, on.v_cmd, on.v)):
            _line(axes, on.t_s, response[:, k] * 100.0, WITH | WIDE)
            _line(axes, on.t_s, command[:, k] * 100.0, COMMAND)
        x.set(title=f"tip position {'xy'[k]}", ylabel="position, cm")
        v.set(title=f"tip velocity {'xy'[k]}", ylabel="velocity, cm/s")
        for axes, what, unit, deviation, without in (
            (v_deviation, "velocity", "cm/s", (on.v_cmd - on.v) * 100.0, (off.v_cmd - off.v) * 100.0),
            (x_deviation, "position", "mm", (on.x_cmd - on.x) * 1000.0, (off.x_cmd - off.x) * 1000.0),
        ):
            largest = f"{_largest(deviation[:, k]):.2g} ({_largest(without[:, k]):.2g})"
            _about_zero(axes, on.t_s, deviation[:, k], WITH, f"{what} deviation, largest {largest} {unit}", unit)
    return "the tip with the observer, and its deviation (in brackets: without the observer)."


def _disturbance(figure: "Figure", on: Evaluation, _off: Evaluation) -> str:
    panels = figure.subplots(on.scenario.joints, 2, sharex=True, squeeze=False)
    total = on.disturbance.total()
    for n, (sums, terms) in enumerate(panels):
        _line(sums, on.t_s, on.estimate[:, n], ESTIMATE)
        _line(sums, on.t_s, total[:, n], TRUE)
        sums.set(title=f"joint {n + 1}: estimate and true sum", ylabel="torque, N m")
        for name, style in TERMS.items():
            values = getattr(on.disturbance, name)
            if name not in ("reaction", "ripple") or np.any(values):
                _line(terms, on.t_s, values[:, n], {"linewidth": 1.3} | style)
        terms.set(title=f"joint {n + 1}: terms of eq. (4)", ylabel="torque, N m")
    return "the disturbance torque as each observer estimates it, and its true terms."


FIGURES = {  # what draws each, and its height in inches: in all, and more for each joint
    "response": (_response, 1.2, 1.6),
    "deviation": (_deviation, 1.4, 1.6),
    "task-space": (_task_space, 8.2, 0.0),
    "disturbance": (_disturbance, 1.5, 1.7),
}


def _line(axes: "Axes", t_s: Array, values: Array, style: Style) -> None:
    """Draw one signal, NaN as gaps, and as points where there are too few for a line."""
    axes.plot(t_s, values, marker="." if len(t_s) <= 5 else None, **style)


def _joint_deviation(axes: "Axes", run: Evaluation, deviation: Array, what: str, style: Style) -> None:
    final_s, final = run.t_s[run.final_rows], float(np.sqrt(np.mean(deviation[run.final_rows] ** 2)))
    factor, unit = angle_unit(_largest(deviation))
    axes.axvspan(final_s[0], final_s[-1] + run.scenario.clock.period_s, **FINAL)
    title = f"{what}: largest {_angle(_largest(deviation))}, final {_angle(final)}"
    _about_zero(axes, run.t_s, deviation * factor, style, title, unit)


def _about_zero(axes: "Axes", t_s: Array, deviation: Array, style: Style, title: str, unit: str) -> None:
    _line(axes, t_s, deviation, style | {"linewidth": 1.0})
    axes.axhline(0.0, **ZERO)
    axes.set(title=title, ylabel=f"deviation, {unit}")


def _finish(figure: "Figure", run: Evaluation, title: str) -> None:
    """Give every panel the same time axis and marks, and the figure its title and one legend."""
    duration_s = run.scenario.duration_s
    division_s = next(division_s for division_s in DIVISIONS_S if duration_s / division_s <= 25)
    divisions = np.arange(0.0, duration_s * (1 + 1e-9), division_s)
    entries: dict[str, Any] = {}
    for axes in figure.axes:
        axes.vlines(divisions, 0.0, 1.0, transform=axes.get_xaxis_transform(), **GRID)
        axes.grid(axis="y", **GRID)
        for load in run.scenario.load:
            axes.axvline(load.at_s, label=f"{load.mass_kg:g} kg put on", **LOAD)
            if load.until_s < duration_s:
                axes.axvline(load.until_s, label="load taken off", **LOAD)
        for grasp in run.scenario.grasp:
            axes.axvline(grasp.at_s, label=f"hand closes on {grasp.mass_kg:g} kg", **LOAD)
            axes.axvline(grasp.until_s, label="hand opens", **LOAD)
        axes.set(xlim=(0.0, duration_s), xticks=divisions[:: 1 if len(divisions) <= 7 else 5])
        lines, labels = axes.get_legend_handles_labels()
        entries |= {label: line for line, label in zip(lines, labels, strict=True) if label not in entries}
    for axes in figure.axes[-2:]:
        axes.set_xlabel(f"time, s ({division_s * 1000.0:g} ms a division)")
    figure.align_ylabels()
    figure.suptitle(textwrap.fill(title, 98), x=0.01, ha="left", fontsize=10.0)
    columns = 4 if len(entries) == 4 else 3
    figure.legend(entries.values(), entries.keys(), loc="outside lower center", frameon=False, ncols=columns)


def _largest(values: Array) -> float:
    return float(np.max(np.abs(values)))


def angle_unit(rad: float) -> tuple[float, str]:
    """Return the factor from rad to the unit that fits, and its name."""
    return (1e6, "µrad") if rad < 0.9995e-3 else (1e3, "mrad") if rad < 0.9995 else (1.0, "rad")


def _angle(rad: float) -> str:
    factor, unit = angle_unit(rad)
    return f"{rad * factor:.3g} {unit}"
