"""Figures of a sweep: fronts against all pairs, files as asked, and what cannot be drawn."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.errors import ScenarioError
from hil.sweep import sweep_file
from hil.sweep.figures import front, write_figures
from hil.sweep.run import plan
from hil.sweep.table import columns, table

HEAD = 'scenario = "paper-joint"\n[[sweep]]\nname = "one"\nmethod = "grid"\n[sweep.vary]\njoint.g_rad_s = [300, 700]\n'
small = st.integers(0, 6)


@given(points=st.lists(st.tuples(small, small), min_size=1))
def test_a_front_is_what_nobody_beats(points):
    """By all pairs: a point is beaten by one that is no worse in both and better in one."""
    beaten = {(x, y) for x, y in points if any(u <= x and v <= y and (u, v) != (x, y) for u, v in points)}
    assert front(points) == sorted(set(points) - beaten)


def load(tmp_path, figure, vary=""):
    path = tmp_path / "sweep.toml"
    path.write_text(f"{HEAD}{vary}[sweep.figure]\n{figure}")
    return sweep_file.load(str(path))


def rows_of(file, value):
    """A table as of a run: every figure is a number of its own, or as said."""
    made = plan(file)
    kinds = columns(made.points, 3)
    figures = {name: value for name, kind in kinds.items() if kind == "float64" and name not in file.sweep[0].vary}
    counts = dict.fromkeys((name for name, kind in kinds.items() if kind == "int64"), 5)
    rows = [
        figures | counts | {"sweep": "one", "index": point.index, "status": "ok", "reason": ""} for point in made.points
    ]
    return table(rows, made.points, kinds)


@pytest.mark.parametrize(
    ("figure", "vary"),
    [
        ('kind = "lines"\nx = "joint.g_rad_s"\ny = "max_deviation_rad"', ""),
        (
            'kind = "lines"\nx = "joint.g_rad_s"\ny = "max_tip_deviation_m"\nby = "drive.limit_A"',
            "drive.limit_A = [6, 8]\n",
        ),
        ('kind = "pareto"\nx = "total_bits"\ny = "swing_rad"', ""),
        (
            'kind = "lines"\nx = "joint.word.round_d"\ny = "swing_rad"\nby = "joint.g_rad_s"',
            'joint.word.round_d = ["floor", "nearest"]\n',
        ),
        (
            'kind = "heat-map"\nx = "joint.g_rad_s"\ny = "drive.limit_A"\nvalue = "current_noise_A"',
            "drive.limit_A = [6, 8]\n",
        ),
    ],
)
@pytest.mark.parametrize("value", [1e-4, 0.0, None])
def test_every_kind_is_drawn_whatever_the_figures_are(tmp_path, figure, vary, value):
    """Nothing measured, and zero on a logarithmic scale, too."""
    file = load(tmp_path, figure, vary)
    paths = write_figures(tmp_path, file.sweep, rows_of(file, value), 3)
    assert [path.name for path in paths] == ["one.png", "one.svg"]
    assert all(path.stat().st_size > 1000 for path in paths)


@pytest.mark.parametrize(
    ("figure", "said"),
    [
        ('kind = "lines"\nx = "joint.g_rad"\ny = "max_deviation_rad"', "'joint.g_rad' .* did you mean joint.g_rad_s"),
        ('kind = "lines"\nx = "joint.g_rad_s"\ny = "max_deviation"', "did you mean max_deviation_rad"),
        ('kind = "heat-map"\nx = "joint.g_rad_s"\ny = "total_bits"', "value, the colour"),
        ('kind = "pareto"\nx = "total_bits"\ny = "swing_rad"\nby = "joint.g_rad_s"', "by goes with lines"),
        (
            'kind = "pareto"\nx = "swing_rad"\ny = "max_deviation_rad"',
            "'swing_rad' is neither varied nor a figure of a whole",
        ),
        ('kind = "lines"\nx = "total_bits"\ny = "swing_rad"', "does not show joint.g_rad_s, which the sweep varies"),
        ('kind = "lines"\nx = "total_bits"\ny = "joint.g_rad_s"', "'joint.g_rad_s' is not a figure of a run"),
        ('kind = "pie"\nx = "total_bits"\ny = "swing_rad"', "'lines', 'heat-map' or 'pareto'"),
        ('kind = "lines"\nx = "qqqq"\ny = "swing_rad"', "'qqqq' is neither varied nor a figure"),
    ],
)
def test_a_figure_that_cannot_be_is_refused_before_anything_runs(tmp_path, figure, said):
    with pytest.raises(ScenarioError, match=said):
        load(tmp_path, figure)
