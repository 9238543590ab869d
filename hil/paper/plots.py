"""The figures of the report that no single run has: fig. 8, tolerance, noise, interference, limits."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.figures import COLOURS, COMMAND, GRID, WIDTH_IN, WITH, WITHOUT, drawing, save
from hil.paper.frequency_response import FrequencyResponse, dB
from hil.paper.noise import Noise
from hil.paper.robustness import Tolerated
from hil.paper.sampled_loop import Complex, first_order

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKS = ("o", "s", "^")


def draw_fig8(stem: Path, found: FrequencyResponse) -> None:
    """Draw G and 1 - G: measured points, the sampled loop, and the printed first order for g and for 1000 rad/s."""
    with drawing():
        figure = _figure(4.2)
        panels = figure.subplots(1, 2, sharey=True)
        dense = np.geomspace(10.0, 2500.0, 400)
        for axes, title, part in zip(
            panels, ("1 - G (sensitivity)", "G (complementary)"), (_itself, _complement), strict=True
        ):
            for n, loop in enumerate(found.loops):
                style: dict[str, Any] = {"color": COLOURS[n], "linewidth": 1.0}
                axes.plot(dense, dB(part(loop.sensitivity(dense))), label=f"joint {n + 1}: sampled loop", **style)
                points = dB(part(found.measured[:, n]))
                axes.plot(
                    found.rad_s, points, MARKS[n], color=COLOURS[n], markersize=4, label=f"joint {n + 1}: measured"
                )
            for g, line in ((found.loops[0].g, "--"), (1000.0, ":")):
                printed = dB(part(first_order(g, dense)))
                axes.plot(dense, printed, line, color="black", linewidth=0.9, label=f"first order, g = {g:g} rad/s")
            axes.set(xscale="log", title=title, xlabel="frequency, rad/s", ylim=(-45, 15))
            axes.grid(**GRID)
        panels[0].set_ylabel("gain, dB")
        _close(figure, stem, "fig. 8: measured on the running rig, beside the sampled loop and the printed formula.", 3)


def _itself(sensitivity: Complex) -> Complex:
    return sensitivity


def _complement(sensitivity: Complex) -> Complex:
    return 1 - sensitivity


def draw_tolerance(stem: Path, runs: list[Tolerated]) -> None:
    """Draw the largest and the final deviation over the inertia factor, a line a payload."""
    with drawing():
        figure = _figure(4.6)
        joints = len(runs[0].largest_rad)
        panels = figure.subplots(2, joints, sharex=True, squeeze=False)
        for payload_kg, colour in zip(sorted({run.payload_kg for run in runs}), COLOURS, strict=False):
            chosen = [run for run in runs if run.payload_kg == payload_kg]
            factors = [run.factor for run in chosen]
            for n in range(joints):
                style: dict[str, Any] = {"color": colour, "label": f"{payload_kg:g} kg on the hand", "marker": "."}
                panels[0, n].plot(factors, [run.largest_rad[n] * 1e6 for run in chosen], **style)
                panels[1, n].plot(factors, [run.final_rad[n] * 1e6 for run in chosen], **style)
        for n in range(joints):
            panels[0, n].set(title=f"joint {n + 1}: largest", ylim=(0, None))
            panels[1, n].set(title=f"joint {n + 1}: final", ylim=(0, None), xlabel="Jn of the controller / Jn")
        for axes in panels.flat:
            axes.grid(**GRID)
        for axes in panels[:, 0]:
            axes.set_ylabel("deviation, µrad")
        _close(figure, stem, "inertia error and payload: deviation of paper-joint.", 3)


def draw_noise(stem: Path, runs: list[Noise], joint: int) -> None:
    """Draw the current noise of one joint (from 0) and its deviation over encoder counts and g; x: a limit cycle."""
    with drawing():
        figure = _figure(6.0)
        panels = figure.subplots(2, 2, sharex=True, sharey=True)
        noise = "current noise, A rms"
        _map(panels[0, 0], runs, lambda run: run.measured_A[joint], f"{noise}: measured", (0.01, 5.0))
        _map(panels[0, 1], runs, lambda run: run.predicted_A[joint], f"{noise}: predicted", (0.01, 5.0))
        deviation = "largest deviation, µrad"
        _map(
            panels[1, 0], runs, lambda run: run.largest_rad[joint] * 1e6, f"{deviation}: joint {joint + 1}", (20, 3000)
        )
        _map(panels[1, 1], runs, lambda run: max(run.largest_rad) * 1e6, f"{deviation}: of all joints", (20, 3000))
        title = f"noise in the current of joint {joint + 1}, and deviation; x: a limit is reached, a limit cycle."
        _close(figure, stem, title, 0)


def _map(
    axes: "Axes", runs: list[Noise], value: Callable[[Noise], float], title: str, limits: tuple[float, float]
) -> None:
    from matplotlib.colors import LogNorm

    counts, gs = sorted({run.counts_per_turn for run in runs}), sorted({run.g_rad_s for run in runs})
    found = {(run.counts_per_turn, run.g_rad_s): run for run in runs}
    grid = [[found[count, g] for count in counts] for g in gs]
    values = np.array([[value(run) for run in row] for row in grid])
    axes.imshow(values, origin="lower", aspect="auto", cmap="cividis", norm=LogNorm(*limits))
    middle = np.sqrt(limits[0] * limits[1])
    for (row, column), x in np.ndenumerate(values):
        text = f"{x:.{2 if x < 10 else 0}{'g' if x < 10 else 'f'}}{' x' if grid[row][column].saturated else ''}"
        colour = "white" if x < middle else "black"
        axes.text(column, row, text, ha="center", va="center", fontsize=7.0, color=colour)
    axes.set(title=title, xticks=range(len(counts)), yticks=range(len(gs)))
    axes.set_xticklabels([f"{count:,}".replace(",", " ") for count in counts], rotation=30, ha="right")
    axes.set_yticklabels([f"{g:g}" for g in gs])
    if axes.get_subplotspec().is_last_row():  # type: ignore[union-attr]
        axes.set_xlabel("encoder counts a turn")
    if axes.get_subplotspec().is_first_col():  # type: ignore[union-attr]
        axes.set_ylabel("g, rad/s")


def draw_bars(stem: Path, title: str, unit: str, labels: list[str], groups: dict[str, list[float]]) -> None:
    """Draw values side by side on a logarithmic axis: groups of bars, one bar a label."""
    with drawing():
        figure = _figure(1.0 + 0.14 * len(labels) * len(groups))
        axes = figure.subplots()
        height = 0.8 / len(groups)
        places = np.arange(len(labels))
        colours = (WITH["color"], WITHOUT["color"], COLOURS[2], COMMAND["color"])
        for k, (name, values) in enumerate(groups.items()):
            bars = axes.barh(places + k * height, values, height, label=name, color=colours[k % len(colours)])
            axes.bar_label(bars, fmt="%.4g", fontsize=6.0, padding=2)
        axes.set(yticks=places + 0.4 - height / 2, xscale="log", xlabel=unit)
        axes.set_yticklabels(labels)
        axes.invert_yaxis()
        axes.margins(x=0.15, y=0.01)
        axes.grid(axis="x", **GRID)
        _close(figure, stem, title, len(groups))


def _figure(height_in: float) -> "Figure":
    from matplotlib.figure import Figure

    return Figure(figsize=(WIDTH_IN, height_in), layout="constrained")


def _close(figure: "Figure", stem: Path, title: str, columns: int) -> None:
    """Give a figure its title and, if wanted, one legend; write it."""
    figure.suptitle(title, x=0.01, ha="left", fontsize=10.0)
    if columns:
        lines, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(lines, labels, loc="outside lower center", frameon=False, ncols=columns)
    save(figure, stem, title)
