"""Walls, a box and a payload in whole runs: what the hand feels, where things go, what is refused or warned of."""

import re
import subprocess
import sys
from functools import cache

import numpy as np
import pytest
from typer.testing import CliRunner

from hil import scenario_file, show
from hil.assemble import build_nodes
from hil.cli import app
from hil.errors import ScenarioError
from hil.evaluate import Evaluation, evaluate
from hil.experiment import Result
from hil.record import signal_columns
from hil.rig import Outcome, run_inline
from hil.scenario import QuinticMove, Scenario
from hil.summary import summarise
from hil.warn import warnings

G = 9.80665
K, C, MU = 1e4, 100.0, 0.2
WALL_X = 0.47


@cache
def ran(name: str) -> tuple[Outcome, Evaluation]:
    outcome = run_inline(scenario_file.load(name), compiled=False)
    evaluation = evaluate(outcome)
    assert evaluation is not None
    return outcome, evaluation


def test_a_steady_push_of_20_newton_is_stiffness_times_depth() -> None:
    """2 mm behind the wall. What is left of the position, an encoder's count or so (8 urad, 3 um), is worth 0.03 N."""
    _, run = ran("wall")
    force, depth = run.world["wall1_normal_N"][-100:], run.x[-100:, 0] - WALL_X
    np.testing.assert_allclose(force, K * depth + C * run.v[-100:, 0], rtol=0, atol=1e-5)
    assert abs(np.mean(force) - 20.0) <= 0.2


def test_the_push_does_not_chatter() -> None:
    """Touched once, the wall is never left; before the slide the joints stand, but for a slip now and then."""
    _, run = ran("wall")
    force = run.world["wall1_normal_N"]
    touched = np.argmax(force > 0.0)
    assert 0.4 <= run.t_s[touched] <= 0.6
    assert np.all(force[touched:] > 0.0)
    assert np.ptp(force[900:1000]) <= 0.1
    assert np.mean(np.abs(np.diff(force[900:1000])) <= 1e-5) >= 0.9
    assert np.max(np.abs(np.diff(force[700:]))) <= 1.0


def test_along_the_wall_friction_is_mu_times_the_normal_force() -> None:
    _, run = ran("wall")
    normal, tangential = run.world["wall1_normal_N"], run.world["wall1_tangential_N"]
    slides = (np.abs(run.v[:, 1]) > 1.01e-3) & (normal > 0.0)
    assert np.count_nonzero(slides) > 700
    # the tangent of a wall that faces -x points down: friction on a tip that moves up is positive
    np.testing.assert_allclose(tangential[slides], MU * normal[slides] * np.sign(run.v[slides, 1]), rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["wall", "box", "grasp"])
def test_the_identity_of_the_disturbance_holds(name: str) -> None:
    """t_dis = Ktn i - Jn q" to rounding: in contact, with the payload, in the air."""
    outcome, run = ran(name)
    rows, columns = np.array(outcome.reports["plant"]["rows"]), outcome.reports["plant"]["columns"]
    acceleration = rows[:, [columns.index(f"a_rad_s2_{n}") for n in (1, 2, 3)]][: len(run.t_s)]
    joint = outcome.scenario.joint
    expected = run.current * joint.torque_constant_N_m_A - acceleration * joint.inertia_kg_m2
    np.testing.assert_allclose(run.disturbance.total(), expected, atol=1e-9)


def test_the_reaction_is_the_force_by_the_jacobian() -> None:
    """r = -Jac^T f, the columns of Jac being the ways from the joints to the tip, turned by a right angle."""
    outcome, run = ran("wall")
    lengths, theta = np.array(outcome.scenario.arm.lengths_m), np.cumsum(run.q, axis=1)
    to_tip_x = np.cumsum((lengths * np.cos(theta))[:, ::-1], axis=1)[:, ::-1]
    to_tip_y = np.cumsum((lengths * np.sin(theta))[:, ::-1], axis=1)[:, ::-1]
    force_x, force_y = -run.world["wall1_normal_N"], -run.world["wall1_tangential_N"]
    torque = to_tip_x * force_y[:, None] - to_tip_y * force_x[:, None]
    np.testing.assert_allclose(run.disturbance.reaction, -torque, atol=1e-9)
    assert np.max(np.abs(run.disturbance.reaction)) > 5.0


def test_pushing_the_box_takes_mu_m_g_and_what_accelerates_it() -> None:
    """Recorded each ms, the box's acceleration is a difference; over its motion only friction is left of the mean."""
    _, run = ran("box")
    force, x = run.world["box_normal_N"], run.world["box_x_m"]
    speed = np.gradient(x, 1e-3)
    left = force - 2.0 * np.gradient(speed, 1e-3)
    moving = speed > 0.02
    assert np.count_nonzero(moving) > 800
    assert np.mean(left[moving]) == pytest.approx(0.4 * 2.0 * G, rel=2e-3)
    # it begins 14.8 mm ahead of the tip, which goes 110 mm and ends 0.8 mm deep, at mu m g at most
    assert x[-1] - x[0] == pytest.approx(0.11 - 0.0148 - force[-1] / K, abs=1e-4)
    assert 0.0 < force[-1] <= 0.4 * 2.0 * G


def test_the_grasped_payload_moves_with_the_hand_and_then_falls() -> None:
    """Free fall from rest in y; pymunk is above the parabola by g t h / 2 at most (`plant.world`)."""
    outcome, run = ran("grasp")
    x, y = run.world["payload1_x_m"], run.world["payload1_y_m"]
    held = slice(900, 1900)
    np.testing.assert_allclose(np.stack([x, y], axis=1)[held], run.x[held], rtol=0, atol=1e-15)
    report = outcome.reports["plant"]
    payload_kg = np.array(report["rows"])[: len(run.t_s), report["columns"].index("payload_kg")]
    assert set(payload_kg[held]) == {1.5}
    assert set(payload_kg[:900]) == set(payload_kg[1900:]) == {0.0}

    t = np.arange(140) * 1e-3
    (x0, y0), (vx, vy) = run.x[1900], run.v[1900]
    assert vx > 0.15
    np.testing.assert_allclose(x[1900:2040], x0 + vx * t, atol=1e-9)
    above = y[1900:2040] - (y0 + vy * t - G * t * t / 2)
    assert np.all(above >= -1e-9)
    assert np.all(above <= G * t * 100e-6 / 2 + 1e-9)
    assert y[-1] == pytest.approx(-0.08, abs=1e-3)
    assert np.all(run.deviation[run.final_rows] < 50e-6)


def test_an_arm_of_one_joint_meets_a_wall_too() -> None:
    """Its move of half a radian ends a little behind a wall across the way of its tip."""
    start = scenario_file.load("one-joint")
    (x, y), (nx, ny) = _tip_after(start, 0.9)
    wall = f"wall=[{{point_m = [{x}, {y}], normal = [{nx}, {ny}], stiffness_N_m = 1e4, damping_N_s_m = 50.0}}]"
    run = evaluate(run_inline(scenario_file.load("one-joint", [wall]), compiled=False))
    assert run is not None
    force = run.world["wall1_normal_N"]
    assert np.max(force) > 1.0
    depth = np.array([nx, ny]) @ (np.array([x, y])[:, None] - run.x.T)
    settled = np.abs(run.w[:, 0]) == 0.0
    np.testing.assert_allclose(force[settled], K * np.maximum(depth, 0.0)[settled], atol=1e-5)


def _tip_after(scenario: Scenario, share: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the tip of a one-joint arm after that share of its move, and the direction against its way."""
    assert isinstance(scenario.trajectory, QuinticMove)
    (start,), (by,), (length,) = scenario.start_rad, scenario.trajectory.by_rad, scenario.arm.lengths_m
    angle, sign = start + share * by, np.sign(by)
    return (length * np.cos(angle), length * np.sin(angle)), (sign * np.sin(angle), -sign * np.cos(angle))


@pytest.mark.parametrize("name", ["wall", "box", "grasp"])
def test_the_same_scenario_gives_the_same_bytes(name: str) -> None:
    again = run_inline(scenario_file.load(name), compiled=False)
    assert again.log.sha256() == ran(name)[0].log.sha256()
    assert again.reports["plant"]["rows"] == ran(name)[0].reports["plant"]["rows"]


def test_the_summary_and_the_signals_have_the_world() -> None:
    summary = summarise(*ran("wall"), 0.0)
    contact = summary["contact"]["wall1"]
    assert contact["largest_normal_N"] == pytest.approx(np.max(ran("wall")[1].world["wall1_normal_N"]))
    assert contact["final_normal_N"] == pytest.approx(K * contact["final_depth_m"], rel=1e-6)
    assert {"wall1_depth_m", "wall1_normal_N", "wall1_tangential_N"} <= signal_columns(ran("wall")[1]).keys()
    assert summarise(*ran("box"), 0.0)["bodies"].keys() == {"box"}
    assert summarise(*ran("grasp"), 0.0)["missed_grasps"] == 0


def test_a_person_sees_the_largest_and_the_final_force(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("wall", "grasp"):
        outcome, evaluation = ran(name)
        show.result(Result(outcome, evaluation, summarise(outcome, evaluation, 0.0), None), None)
    shown = capsys.readouterr().out
    assert re.search(
        r"observer on: wall1: largest contact force 2\d\.\d\d N \(friction 4\.\d\d N\), final 19\.9\d\d N", shown
    )
    assert re.search(r"observer on: payload1: moved by \(\d\d\.\d\d, -?0\.0\d\) mm", shown)


def test_without_a_world_nothing_of_it_is_there() -> None:
    """Neither in the results nor, asked of a fresh interpreter, pymunk in the process."""
    program = (
        "import sys; from hil import scenario_file, experiment; from hil.rig import run_inline\n"
        "result = experiment.examine(run_inline(scenario_file.load('paper-joint', ['duration_s=0.05'])), 0.0)\n"
        "assert 'contact' not in result.summary and result.evaluation.world == {}\n"
        "assert result.outcome.reports['plant']['columns'][-1] == 'payload_kg'\n"
        "assert not {'pymunk', 'plant.world'} & sys.modules.keys()"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


WALL = "wall=[{point_m = [%s, 0.0], normal = [%s, 0.0], stiffness_N_m = 1e4, damping_N_s_m = 0.0}]"
BOX = (
    "box={position_m = [%s, %s], size_m = [0.1, 0.1], mass_kg = 1.0, friction = 0.4, stiffness_N_m = 1e4, "
    "damping_N_s_m = 0.0}"
)
GRASP = "{mass_kg = %s, position_m = [0.36, %s], at_s = %s, until_s = %s}"

REFUSED = [
    (
        "wall",
        WALL % (0.44, -1.0),
        r"wall.0: at start_rad the tip is at \(0.4477, 0.4653\) m, 0.0077 m behind it, .*move",
    ),
    ("wall", WALL % (0.30, -1.0), r"wall.0: at start_rad joint 3 is at \(0.3432, 0.3577\) m, 0.0432 m behind it"),
    ("wall", WALL % (0.1, 1.0), r"wall.0: at start_rad the base is at \(0.0000, 0.0000\) m, 0.1000 m behind it"),
    ("wall", WALL % (0.47, 0.0), r"wall.0.normal = \[0, 0\] has no direction"),
    ("wall", (WALL % (0.47, -1.0)).replace("1e4", "0"), r"wall.0.stiffness_N_m = 0: Input should be greater than 0"),
    ("wall", (WALL % (0.47, -1.0)).replace("normal", "norm"), r"wall.0.normal is missing"),
    ("box", BOX % (0.41, -0.06), r"box.position_m = \[0.41, -0.06\]: it lies 0.0100 m inside wall.0"),
    ("box", BOX % (0.36, -0.05), r"at start_rad link 3 from \(.*\) m touches the box, but it must be clear of it"),
    ("grasp", f"grasp=[{GRASP % (1.5, -0.09, 0.9, 1.9)}]", r"grasp.0.position_m = .*: it lies 0.0100 m inside wall.0"),
    ("grasp", f"grasp=[{GRASP % (1.5, -0.08, 1.9, 0.9)}]", r"grasp.0 from 1.9 s until 0.9 s: it must begin before"),
    (
        "grasp",
        f"grasp=[{GRASP % (1.5, -0.08, 0.9, 1.9)}, {GRASP % (1.5, -0.03, 1.2, 2.0)}]",
        r"grasp.1.at_s = 1.2: the hand holds another payload until 1.9 s, and one at a time",
    ),
    (
        "grasp",
        f"grasp=[{GRASP % (1.5, -0.08, 0.9, 1.9)}, {GRASP % (1.5, -0.06, 2.0, 2.2)}]",
        r"grasp.0 and grasp.1 overlap by 0.0200 m: move one of them",
    ),
]


@pytest.mark.parametrize(("name", "setting", "message"), REFUSED)
def test_a_world_that_cannot_be_is_refused(name: str, setting: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        scenario_file.load(name, [setting])


def test_a_world_around_an_arm_that_feels_no_contact_is_refused() -> None:
    wall = WALL % (5.0, -1.0)
    with pytest.raises(
        ScenarioError, match=r"plant.backend = 'pymunk': it feels no contact, .* take the backend closed"
    ):
        build_nodes(scenario_file.load("direct-drive", ["plant.backend=pymunk", wall]))


def test_one_value_of_one_of_several_is_set_by_its_number() -> None:
    wall = scenario_file.load("wall", ["wall.0.stiffness_N_m=2e4", "trajectory.legs.2.time_s=0.7"])
    assert (wall.wall[0].stiffness_N_m, wall.wall[0].damping_N_s_m) == (2e4, 100.0)
    assert wall.trajectory.time_s == pytest.approx(1.7)
    with pytest.raises(ScenarioError, match=r"entry 1 of 1: they are numbered from 0"):
        scenario_file.load("wall", ["wall.1.stiffness_N_m=2e4"])
    with pytest.raises(ScenarioError, match=r"wall is no table in this scenario"):
        scenario_file.load("wall", ["wall.0=3"])
    with pytest.raises(ScenarioError, match=r"wall.0.point_m is no table in this scenario: choose one of its keys"):
        scenario_file.load("wall", ["wall.0.point_m.x=3"])


def test_a_payload_that_the_drives_cannot_hold_is_warned_of_with_the_torque() -> None:
    """At the start of the grasp joint 2 carries m g times 0.25 m or so; its drive gives 8 A x 6 N m/A."""
    heavy = scenario_file.load("grasp", [f"grasp=[{GRASP % (30, -0.08, 0.9, 1.9)}]"])
    texts = list(warnings(heavy))
    assert any("grasp.0: with 30 kg joint 1 must hold up to 1" in text for text in texts)
    assert all("lighten the load, or raise limit_A" in text for text in texts)
    assert list(warnings(scenario_file.load("grasp"))) == []
    assert list(warnings(scenario_file.load("load-step"))) == []


def test_a_warning_goes_to_stderr_and_the_run_goes_on() -> None:
    settings = ["load=[{mass_kg = 40.0, at_s = 0.05, until_s = 0.06}]", "duration_s=0.06"]
    options = [word for setting in settings for word in ("--set", setting)]
    result = CliRunner().invoke(app, ["run", "paper-joint", "--inline", "--json", *options])
    assert "warning: load.0: with 40 kg joint 1 must hold up to" in result.stderr
    assert result.stdout.startswith('{"scenario": "paper-joint"')


def test_a_grasp_that_misses_is_counted_and_shown() -> None:
    settings = [f"grasp=[{GRASP % (1.5, -0.08, 0.01, 0.05)}]", "duration_s=0.06"]
    options = [word for setting in settings for word in ("--set", setting)]
    result = CliRunner().invoke(app, ["run", "grasp", "--inline", "--json", *options])
    assert '"missed_grasps": 1' in result.stdout
