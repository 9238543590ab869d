"""The figures of a study: all there, legible, the same bytes twice, and what is drawn is where a count by hand says."""

import struct
import sys
import xml.etree.ElementTree as ET
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dbc.compiler import load_arm
from hil import scenario_file
from hil.errors import MissingExtraError
from hil.timing import pictures, style
from hil.timing.gantt import PERIODS, Bar, laid, write_gantt
from hil.timing.response_figure import write_responses
from hil.timing.study import Study, study
from hil.timing.timeline import FrameTime, Timeline
from hil.timing.waterfall import write_waterfalls

FIGURES = ("gantt", "responses", "waterfall", "waterfall-dsp")
SHORT = ("duration_s=0.1", "trajectory.time_s=0.08")
CODEC = load_arm()
INTERMISSION_US = 3.0  # three bits at 1 Mbit/s
CLOSE = 1e-6  # us: what a float of seconds loses


def short(name: str, joints: int) -> Study:
    by_rad = f"trajectory.by_rad={[0.01] * joints}"
    return study(scenario_file.load(name, [*SHORT, by_rad]), data_bit_ns=250)


class Drawn:
    """A study's figures as matplotlib has them, and their files."""

    def __init__(self, folder: Path, found: Study) -> None:
        self.folder, self.study, self.figures = folder, found, {}
        assert found.outcome is not None
        assert found.timeline is not None
        self.scenario, self.timeline = found.outcome.scenario, found.timeline
        save = style.save

        def keep(figure, stem, title):
            self.figures[stem.name] = figure
            return save(figure, stem, title)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(style, "save", keep)
            self.paths = pictures.write(folder, found)

    def frames(self, name: str, first: int = 0) -> list[FrameTime]:
        """Return the frames of a message from a cycle on, in order; looked up by hand."""
        identifier, begins_ns = CODEC[name].identifier, first * self.scenario.period_ns
        return [f for f in self.timeline.frames if f.identifier == identifier and f.queued_ns >= begins_ns]


@pytest.fixture(scope="module")
def one(tmp_path_factory) -> Drawn:
    return Drawn(tmp_path_factory.mktemp("one"), short("one-joint", 1))


@pytest.fixture(scope="module")
def five(tmp_path_factory) -> Drawn:
    return Drawn(tmp_path_factory.mktemp("five"), short("five-joints", 5))


@pytest.fixture(scope="module", params=["one", "five"])
def drawn(request) -> Drawn:
    found: Drawn = request.getfixturevalue(request.param)
    return found


# -- files --


def test_files(drawn):
    names = [f"{name}{suffix}" for name in FIGURES for suffix in (".png", ".svg")]
    assert [path.name for path in drawn.paths] == [*names, "trace.json"]
    for name in FIGURES:
        data = (drawn.folder / f"{name}.png").read_bytes()
        width, height = struct.unpack(">II", data[16:24])
        assert width == 1080  # 7.2 in at 150 dpi
        assert 200 < height < 1754  # an A4 page
        texts = {"".join(node.itertext()) for node in ET.parse(drawn.folder / f"{name}.svg").iter() if node.text}
        assert any(text.startswith(f"{drawn.scenario.name}: ") for text in texts)


def test_no_text_lies_on_another_or_is_cut(drawn):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text

    for name, figure in drawn.figures.items():
        canvas = FigureCanvasAgg(figure)
        canvas.draw()  # now that it is laid out, so that all know where they are
        renderer = canvas.get_renderer()
        marks = {mark for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) for mark in axis.get_ticklabels()}
        texts = [text for text in figure.findobj(Text) if text.get_text().strip() and text not in marks]
        boxes = [(text.get_text(), text.get_window_extent(renderer)) for text in texts if text.get_visible()]
        assert len(boxes) > 8
        for text, box in boxes:
            inside = box.x0 >= 0 and box.y0 >= 0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1
            assert inside, f"{name}: {text!r} is cut"
        for (one, a), (other, b) in combinations(boxes, 2):
            apart = a.x1 <= b.x0 or b.x1 <= a.x0 or a.y1 <= b.y0 + 1 or b.y1 <= a.y0 + 1  # 1 of 100 px an inch
            assert apart, f"{name}: {one!r} lies on {other!r}"


def test_the_same_bytes_twice(one, tmp_path):
    for path in pictures.write(tmp_path, one.study):
        assert path.read_bytes() == (one.folder / path.name).read_bytes()


# -- gantt --


def bars(axes: Any, look: dict[str, Any]) -> list[tuple[float, float]]:
    """Return (begins, ends) of all bars of a colour, in order."""
    from matplotlib.colors import to_rgba

    colour = to_rgba(look["color"], look.get("alpha"))
    found = [bar for bar in axes.patches if bar.get_facecolor() == colour]
    return sorted((round(bar.get_x(), 6), round(bar.get_x() + bar.get_width(), 6)) for bar in found)


def test_gantt_shows_every_frame_of_its_cycles(drawn):
    period_us = drawn.scenario.period_ns / 1e3
    first = int(0.04e9) // drawn.scenario.period_ns  # the middle of a motion of 0.08 s
    panels = drawn.figures["gantt"].axes
    assert len(panels) == PERIODS
    for k, axes in enumerate(panels):
        frames = [f for f in drawn.timeline.frames if f.queued_ns // drawn.scenario.period_ns == first + k]
        times = [tuple((ns - first * drawn.scenario.period_ns) / 1e3 for ns in frame[:3]) for frame in frames]
        assert bars(axes, style.ON_BUS) == sorted((starts, ends) for _, starts, ends in times)
        assert bars(axes, style.WAITS) == sorted((queued, starts) for queued, starts, _ in times)
        assert len(bars(axes, style.COMPUTES)) == drawn.scenario.joints + 1  # the DSP
        names = [text.get_text().strip() for text in axes.texts]
        assert sorted(names) == sorted(CODEC.by_identifier[frame.identifier].name for frame in frames)
        edges = [line.get_xdata()[0] for line in axes.lines if line.get_linestyle() == "--"]
        assert edges == [k * period_us, (k + 1) * period_us]


def test_a_name_is_in_its_bar_or_next_to_it(drawn):
    """White within the bar of a frame, black on no bar at all, but touching its own."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    renderer = FigureCanvasAgg(drawn.figures["gantt"]).get_renderer()
    for axes in drawn.figures["gantt"].axes:
        assert axes.texts
        for text in axes.texts:
            at, lane = text.get_position()
            own = [bar for bar in axes.patches if bar.get_y() < lane < bar.get_y() + bar.get_height()]
            assert any(bar.get_x() - CLOSE <= at <= bar.get_x() + bar.get_width() + CLOSE for bar in own)
            name, boxes = text.get_window_extent(renderer), [bar.get_window_extent(renderer) for bar in own]
            if text.get_color() == "white":
                assert any(box.x0 <= name.x0 and name.x1 <= box.x1 for box in boxes), text
            else:
                assert all(name.x1 <= box.x0 + 0.5 or box.x1 <= name.x0 + 0.5 for box in boxes), text


def test_gantt_tells_how_full_the_bus_is(five):
    frames = [f for f in five.timeline.frames if 20 <= f.queued_ns / 2e6 < 22]
    busy_us = sum((f.ends_ns - f.starts_ns) / 1e3 + INTERMISSION_US for f in frames)
    waits_us = max(f.starts_ns - f.queued_ns for f in frames) / 1e3
    title = five.figures["gantt"].get_suptitle()
    assert f" {busy_us / 4000 * 100:.0f} % in use" in title
    assert f" {waits_us:.0f} µs, of AccelRef_2" in title


@given(st.lists(st.tuples(st.integers(0, 100), st.integers(1, 30)), max_size=30))
def test_lanes_keep_bars_apart_and_are_as_few_as_can_be(drawn):
    spans = sorted((begins, begins + lasts) for begins, lasts in drawn)
    lanes: dict[int, list[tuple[float, float]]] = {}
    for lane, bar in laid([Bar(begins, None, ends, "", (begins, ends)) for begins, ends in spans]):
        lanes.setdefault(lane, []).append(bar.takes)
    assert sorted(span for found in lanes.values() for span in found) == spans
    for found in lanes.values():
        assert all(before[1] <= after[0] for before, after in pairwise(found))
    at_once = max((sum(b <= instant < e for b, e in spans) for instant in range(131)), default=0)
    assert len(lanes) == at_once


# -- response times --


def test_histograms_and_bounds(drawn):
    """Counts, ends and lines of every panel, from the frames by hand."""
    rows = {row["name"]: row for row in drawn.study.found["messages"]}
    panels = [axes for axes in drawn.figures["responses"].axes if axes.axison]
    titles = [axes.get_title(loc="left").split(",")[0] for axes in panels]
    joints = range(1, drawn.scenario.joints + 1)
    references = ["AccelRef", "AccelRef_2"][: 1 + (drawn.scenario.joints > 3)]
    expected = ["Sync", *(f"Encoder_{n}" for n in joints), *(f"Current_{n}" for n in joints), *references]
    assert titles == [*expected, "State and Heartbeat"]
    for name, axes in zip(expected, panels, strict=False):
        frames = [f for f in drawn.frames(name) if f.queued_ns < drawn.scenario.duration_ns]
        lasted_us = [(f.ends_ns - f.queued_ns) / 1e3 + INTERMISSION_US for f in frames]
        counts, edges, _ = axes.patches[0].get_data()
        assert sum(counts) == len(frames) == drawn.scenario.cycles
        for low, high, count in zip(edges, edges[1:], counts, strict=False):
            assert count == sum(low <= value < high for value in lasted_us)
        lines = {line.get_label(): line.get_xdata()[0] for line in axes.lines}
        assert lines == pytest.approx(
            {
                "bound, this run's frames": rows[name]["response_bound_actual_s"] * 1e6,
                "bound, longest frames": rows[name]["response_bound_s"] * 1e6,
            }
        )
        low, high = axes.get_xlim()
        assert low < min(lasted_us) <= max(lasted_us) < high
        assert low < max(lines.values()) < high


def test_a_near_deadline_is_a_line(drawn):
    status = next(axes for axes in drawn.figures["responses"].axes if "Heartbeat" in axes.get_title(loc="left"))
    tail_us = 160.0  # README: State is queued 160 us before the end of its cycle
    assert [line.get_xdata()[0] for line in status.lines][2:] == [pytest.approx(tail_us)]
    assert sum(status.patches[0].get_data().values) == drawn.scenario.cycles
    assert f"deadline {tail_us:g} µs" in status.get_title(loc="left")


# -- waterfalls --


@pytest.mark.parametrize(("name", "cycles", "parts"), [("waterfall", 0, 5), ("waterfall-dsp", 1, 9)])
def test_a_waterfall_ends_where_the_mean_of_the_chain_does(drawn, name, cycles, parts):
    """The current of so many cycles later has ended; the bars before it lie behind one another."""
    period_ns = drawn.scenario.period_ns
    for n, axes in enumerate(drawn.figures[name].axes, start=1):
        currents = drawn.frames(f"Current_{n}")[: drawn.scenario.cycles]
        ends_us = [(f.ends_ns - (k - cycles) * period_ns) / 1e3 for k, f in enumerate(currents)][cycles:]
        spans = [(bar.get_x(), bar.get_x() + bar.get_width()) for bar in axes.patches]
        assert len(spans) == parts
        assert spans[0][0] == 0.0
        assert [span[0] for span in spans[1:]] == pytest.approx([span[1] for span in spans[:-1]], abs=CLOSE)
        assert spans[-1][1] == pytest.approx(sum(ends_us) / len(ends_us), abs=CLOSE)
        bound_us = next(line.get_xdata()[0] for line in axes.lines if line.get_linestyle() == "--")
        chain = next(c for c in drawn.study.found["chains"] if c["joint"] == n and ("DSP" in c["name"]) == bool(cycles))
        assert bound_us == pytest.approx(chain["bound_s"] * 1e6)
        assert max(ends_us) <= bound_us < axes.get_xlim()[1]
        assert f"at most {max(ends_us):.4g}, bound {bound_us:.4g}" in axes.get_title(loc="left")


def test_whiskers_go_to_the_largest(five):
    axes = five.figures["waterfall"].axes[0]
    waits_us = [(f.starts_ns - f.queued_ns) / 1e3 for f in five.frames("Current_1")[: five.scenario.cycles]]
    bar, whisker = axes.patches[3], axes.collections[0].get_segments()[3]
    assert bar.get_width() == pytest.approx(sum(waits_us) / len(waits_us), abs=CLOSE)
    assert whisker[0][0] == pytest.approx(bar.get_x() + bar.get_width(), abs=CLOSE)
    assert whisker[1][0] - bar.get_x() == pytest.approx(max(waits_us), abs=CLOSE)
    assert axes.texts[3].get_text() == f"{bar.get_width():.0f}, max {max(waits_us):.0f}"


# -- little, or nothing, to draw --


def test_nothing_is_written_where_no_frame_was_sent(one, tmp_path):
    assert pictures.write(tmp_path, Study({"late": "State"})) == []
    assert pictures.write(tmp_path, Study(one.study.found, one.study.outcome, Timeline())) == []
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("until_ns", "cycles"), [(-150_000_000, (-153, -152)), (2_500_000, (0, 1))])
def test_a_run_that_ended_early(one, tmp_path, until_ns, cycles):
    """In its set-up, or in its third cycle: the two cycles before its last frame are shown."""
    timeline = Timeline()
    timeline.frames = [frame for frame in one.timeline.frames if frame.ends_ns < until_ns]
    never = {"mean_s": None, "max_s": None}
    chains = [
        chain | {"measured": None, "parts": [part | never for part in chain["parts"]]}
        for chain in one.study.found["chains"]
    ]
    found = one.study.found | {"chains": chains}
    assert len(pictures.write(tmp_path, Study(found, one.study.outcome, timeline))) == 9
    gantt = (tmp_path / "gantt.svg").read_text()
    assert all(f">cycle {cycle}<" in gantt for cycle in cycles)


@pytest.mark.parametrize("what", ["all", "gantt", "responses", "waterfalls"])
def test_without_matplotlib(one, tmp_path, monkeypatch, what):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    scenario, timeline, found = one.scenario, one.timeline, one.study.found
    draw = {
        "all": lambda: pictures.write(tmp_path, one.study),
        "gantt": lambda: write_gantt(tmp_path, scenario, timeline),
        "responses": lambda: write_responses(tmp_path, scenario, timeline, found["messages"]),
        "waterfalls": lambda: write_waterfalls(tmp_path, scenario.name, found["chains"]),
    }
    with pytest.raises(MissingExtraError, match=r"pip install 'hil\[report\]'"):
        draw[what]()
    assert not list(tmp_path.iterdir())
