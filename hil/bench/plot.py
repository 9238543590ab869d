"""The figure of `make bench`: wall time of a frame against clients and against load, as PNG."""

from pathlib import Path
from typing import TYPE_CHECKING

from hil.bench.clients import Case
from hil.bench.scaling import BATCHES, CLIENTS, LOADS, USUAL_CLIENTS, USUAL_LOAD, Costs
from hil.errors import MissingExtraError
from hil.figures import RC

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = dict(zip(BATCHES, ("#0072B2", "#009E73", "#D55E00"), strict=True))
NAMES = {"inline": "inline", "observers": "observers", "timed": "timed clients"}


def write_plot(costs: Costs, path: Path) -> None:
    """Write the figure; raise MissingExtraError without matplotlib."""
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtraError(
            "the plot needs matplotlib, which is not installed: pip install 'hil[report]'"
        ) from None
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        for group, style in RC.items():
            matplotlib.rc(group, **style)
        figure = Figure(figsize=(9.0, 4.0), layout="constrained")
        by_clients, by_load = figure.subplots(1, 2, sharey=True)
        _draw_by_clients(by_clients, costs)
        _draw_by_load(by_load, costs)
        figure.legend(*by_clients.get_legend_handles_labels(), loc="outside right upper", frameon=False)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=150)


def _draw_by_clients(axes: "Axes", costs: Costs) -> None:
    _draw(axes, costs, [(float(clients), clients, USUAL_LOAD) for clients in CLIENTS])
    first = costs[Case("timed", CLIENTS[0], True, USUAL_LOAD)]
    proportional = [first * clients / CLIENTS[0] for clients in CLIENTS]
    axes.plot(CLIENTS, proportional, color="black", linewidth=0.6, linestyle=":", label="in proportion")
    axes.set_title(f"load {USUAL_LOAD:.0%}")
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    axes.set_xticks(CLIENTS, [str(clients) for clients in CLIENTS])
    axes.set_xlabel("clients")
    axes.set_ylabel("wall time of a frame [us]")


def _draw_by_load(axes: "Axes", costs: Costs) -> None:
    _draw(axes, costs, [(100.0 * load, USUAL_CLIENTS, load) for load in LOADS])
    axes.set_title(f"{USUAL_CLIENTS} clients")
    axes.set_xlabel("bus load [%]")


def _draw(axes: "Axes", costs: Costs, points: list[tuple[float, int, float]]) -> None:
    """Draw a line for each kind of client and acceptance through (x, clients, load)."""
    for kind, colour in COLOURS.items():
        for everyone, style in ((False, "--"), (True, "-")):
            found = [costs[Case(kind, clients, everyone, load)] for _, clients, load in points]
            label = f"{NAMES[kind]}, accepted by {'all' if everyone else 'one'}"
            axes.plot([x for x, _, _ in points], found, style, color=colour, marker="o", markersize=3, label=label)
    axes.grid(color="0.85", linewidth=0.5)
