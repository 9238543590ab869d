"""The figures of a run: all there, readable by a machine, the same bytes twice, and drawn from very little too."""

import dataclasses
import struct
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil import figures, scenario_file
from hil.errors import MissingExtraError
from hil.evaluate import Evaluation, evaluate
from hil.figures import ESTIMATE, write_figures
from hil.rig import run_inline
from plant.disturbance import DisturbanceTerms

NAMES = ("response", "deviation", "task-space", "disturbance")
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
WIDTH_PX = 1080  # 7.2 in at 150 dpi


def run(*settings: str) -> Evaluation:
    short = ("duration_s=0.3", "trajectory.time_s=0.2", "trajectory.by_rad=[0.02, -0.02, 0.02]")
    evaluation = evaluate(run_inline(scenario_file.load("paper-joint", [*short, *settings])))
    assert evaluation is not None
    return evaluation


def cut(evaluation: Evaluation, rows: int) -> Evaluation:
    """Return what a run that ended after so many cycles leaves."""
    arrays = {
        field.name: getattr(evaluation, field.name)[:rows]
        for field in dataclasses.fields(evaluation)
        if isinstance(getattr(evaluation, field.name), np.ndarray)
    }
    terms = {f.name: getattr(evaluation.disturbance, f.name)[:rows] for f in dataclasses.fields(DisturbanceTerms)}
    return dataclasses.replace(evaluation, **arrays, disturbance=DisturbanceTerms(**terms))


def texts(svg: Path) -> str:
    """Return the texts of an SVG, a line each."""
    return "\n".join("".join(node.itertext()) for node in ET.parse(svg).iter("{http://www.w3.org/2000/svg}text"))


def lines_in(svg: Path, style: dict[str, Any]) -> list[str]:
    """Return the path data of the signals (not those of the legend) of a colour."""
    paths = ET.parse(svg).iter("{http://www.w3.org/2000/svg}path")
    drawn = [path.get("d", "") for path in paths if f"stroke: {style['color'].lower()}" in path.get("style", "")]
    return [line for line in drawn if line.count("L") > 10]


@pytest.fixture(scope="module")
def runs() -> tuple[Evaluation, Evaluation]:
    return run(), run("joint.observer=false")


@pytest.fixture(scope="module")
def folder(runs, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("figures")
    paths = write_figures(folder, *runs)
    assert paths == [folder / f"{name}{suffix}" for name in NAMES for suffix in (".png", ".svg")]
    return folder


@pytest.mark.parametrize("name", NAMES)
def test_png(folder, name):
    data = (folder / f"{name}.png").read_bytes()
    assert data[:8] == PNG_SIGNATURE
    width, height = struct.unpack(">II", data[16:24])
    assert width == WIDTH_PX
    assert 700 < height < 1500


@pytest.mark.parametrize(
    ("name", "labels"),
    [
        ("response", ["angle, rad", "current, A", "command", "with observer", "without observer"]),
        (
            "deviation",
            ["deviation, mrad", "deviation, µrad", "(a) joint 1: largest", "(b) joint 3: largest", ", final "],
        ),
        ("task-space", ["position, cm", "velocity, cm/s", "deviation, cm/s", "deviation, mm"]),
        ("disturbance", ["torque, N m", "estimate", "inertia variation", "gravity", "viscous", "friction"]),
    ],
)
def test_svg_labels(folder, name, labels):
    seen = texts(folder / f"{name}.svg")
    for label in ["paper-joint: ", "time, s (100 ms a division)", *labels]:
        assert label in seen


def test_zero_terms_are_left_out(folder):
    seen = texts(folder / "disturbance.svg")
    assert "reaction" not in seen
    assert "torque ripple" not in seen


@pytest.fixture
def disturbance_alone(monkeypatch):
    monkeypatch.setattr(figures, "FIGURES", {"disturbance": figures.FIGURES["disturbance"]})


@pytest.mark.usefixtures("disturbance_alone")
def test_ripple_and_load_are_named_where_there_are_any(tmp_path, runs):
    rippling = run("drive.ripple=[0.02, 0.02, 0.02]", "load=[{mass_kg=1.0, at_s=0.1, until_s=0.2}]")
    write_figures(tmp_path, rippling, runs[1])
    seen = texts(tmp_path / "disturbance.svg")
    for label in ("torque ripple", "1 kg put on", "load taken off"):
        assert label in seen


def test_deviation_is_that_of_the_evaluation(folder, runs):
    largest_mrad = np.max(np.abs(runs[1].deviation[:, 0])) * 1e3
    final_urad = np.sqrt(np.mean(runs[0].deviation[-100:, 2] ** 2)) * 1e6
    seen = texts(folder / "deviation.svg")
    assert f"(a) joint 1: largest {largest_mrad:.3g} mrad, final " in seen
    assert f", final {final_urad:.3g} µrad" in seen.partition("(b) joint 3")[2].partition("\n")[0]


def test_two_writes_are_the_same_bytes_and_leave_nothing_global_changed(tmp_path, folder, runs):
    import matplotlib

    before, pyplot = matplotlib.rcParams.copy(), "matplotlib.pyplot" in sys.modules
    paths = write_figures(tmp_path, *runs)
    assert len(paths) == 2 * len(NAMES)
    assert [path.read_bytes() for path in paths] == [(folder / path.name).read_bytes() for path in paths]
    assert matplotlib.rcParams.copy() == before
    assert ("matplotlib.pyplot" in sys.modules) == pyplot


@pytest.mark.parametrize(("rows_with", "rows_without"), [(1, 1), (2, 300), (150, 5)])
def test_runs_that_ended_early(tmp_path, runs, rows_with, rows_without):
    paths = write_figures(tmp_path, cut(runs[0], rows_with), cut(runs[1], rows_without))
    assert [path.exists() for path in paths] == [True] * 8


@pytest.mark.usefixtures("disturbance_alone")
def test_missing_frames_are_gaps(folder, tmp_path, runs):
    estimate = runs[0].estimate.copy()
    estimate[100:200, 0] = np.nan
    estimate[:, 2] = np.nan
    write_figures(tmp_path, dataclasses.replace(runs[0], estimate=estimate), runs[1])
    whole, gaps = lines_in(folder / "disturbance.svg", ESTIMATE), lines_in(tmp_path / "disturbance.svg", ESTIMATE)
    assert [line.count("M") for line in whole] == [1, 1, 1]
    assert [line.count("M") for line in gaps] == [2, 1]


def test_without_matplotlib(tmp_path, monkeypatch, runs):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'hil\[report\]'"):
        write_figures(tmp_path, *runs)
    assert not list(tmp_path.iterdir())
