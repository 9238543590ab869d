"""The figure of an arm at rest: a row a joint, its dead band over the bits of d, and the spectrum of its limit cycle.

Points are measured, lines predicted, dotted what the resolution of d alone predicts.

Ref: M. Okabe, K. Ito, Color Universal Design (the colours).
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.figures import GRID, WIDTH_IN, drawing
from hil.quantise.rest import Rest
from hil.quantise.rest_cases import Found
from hil.timing.style import finish

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Style = dict[str, Any]
ENCODERS: dict[bool, Style] = {
    False: {"color": "#0072B2", "label": "as it is"},
    True: {"color": "#D55E00", "label": "with a finer encoder"},
}
OF_D: Style = {"color": "black", "linestyle": ":", "linewidth": 1.0, "label": "resolution of d alone"}
SMALLEST_URAD = 0.01
"""Of an axis: what is less is no longer of interest."""


def write_rest(folder: Path, found: Sequence[Found]) -> list[Path]:
    """Write rest.png and rest.svg; return their paths. Raises MissingExtraError without matplotlib."""
    first = found[0]
    with drawing():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(WIDTH_IN, 1.2 + 1.9 * len(first.joints)), layout="constrained")
        panels = figure.subplots(len(first.joints), 2, squeeze=False)
        for k, (band, spectrum) in enumerate(panels):
            _band(band, found, k)
            _spectrum(spectrum, first.joints[k])
        panels[-1][0].set_xlabel("bits of d behind a current count")
        panels[-1][1].set_xlabel("frequency, Hz")
        ratios = [joint.ratio for each in found for joint in each.joints]
        title = (
            f"{first.case.scenario.name} at rest without friction: dead band, predicted (lines) and measured (points), "
            f"{min(ratios):.2f} to {max(ratios):.2f} of the prediction; spectrum of its limit cycle as it is."
        )
        return finish(figure, folder / "rest", title)


def _band(axes: "Axes", found: Sequence[Found], k: int) -> None:
    """Draw the range of one joint over the bits of d, with both encoders."""
    for fine, style in ENCODERS.items():
        swept = [each for each in found if each.joints and each.case.swept == "d_fraction" and each.case.fine == fine]
        bits = [each.case.scenario.joint.word.d_fraction or 0 for each in swept]
        joints = [each.joints[k] for each in swept]
        axes.plot(bits, [joint.predicted.range * 1e6 for joint in joints], linewidth=1.2, color=style["color"])
        axes.plot(bits, [joint.measured * 1e6 for joint in joints], ".", **style)
        if not fine:
            of_d = [joint.predicted.alone["d"] * 1e6 for joint in joints]
            axes.plot(bits, of_d, **OF_D)
    axes.set(yscale="log", ylabel="µrad", xticks=range(0, 17, 4))
    axes.set_title(f"joint {k + 1}: dominated by the {found[0].joints[k].predicted.dominant}", fontsize=8.0)
    axes.set_ylim(bottom=SMALLEST_URAD)
    axes.grid(**GRID)


def _spectrum(axes: "Axes", joint: Rest) -> None:
    peak = "nothing moves" if joint.period_s is None else f"most at {1.0 / joint.period_s:.3g} Hz"
    axes.plot(joint.frequencies, joint.spectrum * 1e6, linewidth=0.8, color=ENCODERS[False]["color"])
    axes.set(ylabel="µrad", xlim=(0.0, joint.frequencies[-1]))
    axes.set_title(f"joint {joint.joint}: {joint.amplitude * 1e6:.3g} µrad peak to peak, {peak}", fontsize=8.0)
    axes.grid(**GRID)
