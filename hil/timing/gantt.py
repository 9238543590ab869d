"""The bus as a Gantt chart: two cycles in the middle of the motion; who computes, who waits, who sends.

A node has as many lanes as it takes to keep apart what it has under way. Frames go by their name: in the bar, or beside
it where the bar is too short. A wait ends where the attempt begins that is acknowledged.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from dbc.codec import Codec
from dbc.compiler import load_arm
from hil.figures import WIDTH_IN, drawing
from hil.scenario import Scenario
from hil.scenario_parts import to_ns
from hil.timing.measured import name_of
from hil.timing.style import COMPUTES, ON_BUS, WAITS, Style, finish
from hil.timing.timeline import Timeline
from hil.wire.bits import INTERMISSION_BITS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BOUNDARY: Style = {"label": "a cycle begins", "color": "black", "linewidth": 0.9, "linestyle": "--"}

PERIODS = 2
LANE_IN = 0.19
AXIS_IN = 6.4
"""Width of a panel, about."""
FONT_PT = 6.0
CHARACTER_IN = 0.62 * FONT_PT / 72
"""Width of a letter, about."""


class Bar(NamedTuple):
    """One thing of one node, us from the first cycle shown. starts: on the bus, where it is a frame.

    takes: from where to where it needs its lane, the name included.
    """

    begins: float
    starts: float | None
    ends: float
    name: str
    takes: tuple[float, float]


def write_gantt(folder: Path, scenario: Scenario, timeline: Timeline) -> list[Path]:
    """Write gantt.png and gantt.svg; return their paths. Raises MissingExtraError without matplotlib."""
    first, codec = _first_cycle(scenario, timeline), load_arm()
    panels = [_bars(scenario, timeline, codec, first, first + k) for k in range(PERIODS)]
    lanes = {node: max(_depth(panel[node]) for panel in panels) for node in scenario.node_names}
    with drawing():
        from matplotlib.figure import Figure

        height_in = 1.3 + PERIODS * (0.45 + LANE_IN * sum(lanes.values()))
        figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
        for k, (axes, panel) in enumerate(zip(figure.subplots(PERIODS, squeeze=False).flat, panels, strict=True)):
            _draw(axes, panel, lanes)
            _frame_up(axes, k, scenario.period_ns / 1e3, lanes)
            axes.set_title(f"cycle {first + k}")
        figure.axes[-1].set_xlabel(f"time from the start of cycle {first}, µs")
        title = f"{scenario.name}: {_seen(scenario, timeline, codec, first)}."
        return finish(figure, folder / "gantt", title)


def _first_cycle(scenario: Scenario, timeline: Timeline) -> int:
    """Return the cycle in the middle of the motion, or the last that the run came to."""
    middle = to_ns(min(scenario.trajectory.time_s, scenario.duration_s)) // (2 * scenario.period_ns)
    last = timeline.frames[-1].queued_ns // scenario.period_ns
    return min(middle, last - PERIODS)


def _seen(scenario: Scenario, timeline: Timeline, codec: Codec, first: int) -> str:
    """Say how much of the time the bus is in use, intermissions included, and who waits longest."""
    begins_ns, ends_ns = first * scenario.period_ns, (first + PERIODS) * scenario.period_ns
    frames = list(timeline.between(begins_ns, ends_ns))
    rest_ns = INTERMISSION_BITS * scenario.bit_ns
    share = sum(frame.ends_ns - frame.starts_ns + rest_ns for frame in frames) / (ends_ns - begins_ns)
    text = f"two cycles of the bus, {share * 100:.0f} % in use"
    if not frames:
        return text
    longest = max(frames, key=lambda frame: frame.starts_ns - frame.queued_ns)
    waits_us = (longest.starts_ns - longest.queued_ns) / 1e3
    return f"{text}; the longest wait is {waits_us:.4g} µs, of {name_of(longest.identifier, codec)}"


# -- what there is to draw --


def _bars(scenario: Scenario, timeline: Timeline, codec: Codec, first: int, cycle: int) -> dict[str, list[Bar]]:
    """Return what each node has under way in a cycle, by when it begins."""
    period_ns = scenario.period_ns
    begins_ns, ends_ns = cycle * period_ns, (cycle + 1) * period_ns
    per_inch = period_ns / 1e3 / AXIS_IN

    def us(ns: int) -> float:
        return (ns - first * period_ns) / 1e3

    found: dict[str, list[Bar]] = {node: [] for node in scenario.node_names}
    for node, computing in timeline.computing.items():
        for woken_ns, lasts_ns in computing:
            if lasts_ns and woken_ns < ends_ns and woken_ns + lasts_ns > begins_ns:
                span = us(woken_ns), us(woken_ns + lasts_ns)
                found[node].append(Bar(span[0], None, span[1], "", span))
    for frame in timeline.frames:
        if frame.queued_ns >= ends_ns or frame.ends_ns <= begins_ns:
            continue
        name = name_of(frame.identifier, codec)
        times = us(frame.queued_ns), us(frame.starts_ns), us(frame.ends_ns)
        takes = _takes(times, len(name) * CHARACTER_IN * per_inch, us(ends_ns))
        found[frame.sender].append(Bar(*times, name, takes))
    return {node: sorted(bars, key=lambda bar: bar.takes) for node, bars in found.items()}


def _takes(times: tuple[float, float, float], name: float, limit: float) -> tuple[float, float]:
    """Return what a frame takes of its lane with its name in it, behind it, or before it where that is beyond limit."""
    queued, starts, ends = times
    if name <= ends - starts:
        return queued, ends
    return (queued, ends + name) if ends + name <= limit else (queued - name, ends)


def laid(bars: list[Bar]) -> Iterator[tuple[int, Bar]]:
    """Yield each bar with the first lane that is free for it."""
    free: list[float] = []
    for bar in bars:
        lane = next((k for k, until in enumerate(free) if until <= bar.takes[0]), len(free))
        free[lane : lane + 1] = [bar.takes[1]]
        yield lane, bar


def _depth(bars: list[Bar]) -> int:
    return 1 + max((lane for lane, _ in laid(bars)), default=0)


# -- drawing --


def _draw(axes: "Axes", panel: dict[str, list[Bar]], lanes: dict[str, int]) -> None:
    """Draw the bars of a cycle, a node below the other."""
    top = 0
    for node, bars in panel.items():
        for lane, bar in laid(bars):
            _draw_bar(axes, bar, top + lane + 0.5)
        top += lanes[node]


def _draw_bar(axes: "Axes", bar: Bar, at: float) -> None:
    if bar.starts is None:
        axes.barh(at, bar.ends - bar.begins, 0.78, bar.begins, **COMPUTES)
        return
    axes.barh(at, bar.starts - bar.begins, 0.5, bar.begins, **WAITS)
    axes.barh(at, bar.ends - bar.starts, 0.78, bar.starts, **ON_BUS)
    style: Style = {"va": "center_baseline", "fontsize": FONT_PT, "clip_on": True}
    if bar.takes == (bar.begins, bar.ends):
        axes.text((bar.starts + bar.ends) / 2, at, bar.name, ha="center", color="white", **style)
    elif bar.takes[1] > bar.ends:
        axes.text(bar.ends, at, f" {bar.name}", ha="left", **style)
    else:
        axes.text(bar.begins, at, f"{bar.name} ", ha="right", **style)


def _frame_up(axes: "Axes", k: int, period_us: float, lanes: dict[str, int]) -> None:
    """Give a panel its cycle's boundaries, and a row with a name for each node."""
    middles, top = [], 0
    for count in lanes.values():
        middles.append(top + count / 2)
        top += count
        axes.axhline(top, color="0.85", linewidth=0.6, zorder=0)
    for boundary in (k, k + 1):
        axes.axvline(boundary * period_us, **BOUNDARY)
    axes.set(xlim=((k - 0.01) * period_us, (k + 1.01) * period_us), ylim=(top, 0), yticks=middles)
    axes.set_yticklabels(lanes.keys())
    axes.tick_params(axis="y", length=0)
