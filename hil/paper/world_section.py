"""A part of the report: what the arm touches is a disturbance like any other."""

from concurrent.futures import Executor
from dataclasses import asdict, dataclass

import numpy as np

from hil.paper.cells import URAD, listed, urad
from hil.paper.deviation import evaluated
from hil.paper.report import Claim, Folder, Section, Table
from hil.summary import deviations

WORLD_TEXT = (
    "The reaction torque r(q, f) of eq. (1), with walls, a box and payloads of pymunk: the tip is pushed 2 mm behind "
    "a wall of 10 kN/m and slid along it (wall), pushes a box along the floor (box), takes a payload and drops it "
    "(grasp). The command says where the tip shall be; the observer makes the force that this takes."
)
SCENARIOS = ("wall", "box", "grasp")
STEADY = slice(900, 1000)
"""Cycles of `wall` in which the tip stands behind the wall, before it slides."""


@dataclass(frozen=True)
class Touched:
    """A run: deviation, rad, one entry a joint; the largest reaction torque, N m; for `wall` the steady push."""

    scenario: str
    largest_rad: list[float]
    final_rad: list[float]
    reaction_N_m: list[float]
    push_N: float | None = None
    off_spring_N: float | None = None
    """How far the force is from K times depth."""
    chatter_N: float | None = None


def world(executor: Executor, _folder: Folder) -> Section:
    """The scenarios wall, box and grasp."""
    found = list(executor.map(_touch, SCENARIOS))
    wall = found[0]
    assert wall.push_N is not None
    assert wall.off_spring_N is not None
    assert wall.chatter_N is not None
    final = max(max(each.final_rad) for each in found)
    rows = [
        (each.scenario, listed(each.reaction_N_m, ".2f"), urad(each.largest_rad), urad(each.final_rad))
        for each in found
    ]
    return Section(
        "world",
        "The world that the arm touches",
        WORLD_TEXT,
        [
            Claim(
                "the reaction of the environment is one of the disturbances",
                "eqs. (1), (4)",
                f"final deviation at most {final / URAD:.1f} urad against a wall, a box and with a payload",
                final <= 30e-6,
            ),
            Claim(
                "(ours) a steady push is K times depth",
                "eq. (1)",
                f"{wall.push_N:.3f} N for 20 N commanded, {wall.off_spring_N:.1e} N off K times depth, varying by "
                f"{wall.chatter_N:.1e} N",
                wall.off_spring_N <= 1e-5 and wall.chatter_N <= 1e-5 and abs(wall.push_N - 20.0) < 0.2,
            ),
        ],
        [Table("contact", ("scenario", "largest reaction, N m", "largest, urad", "final, urad"), rows)],
        values=[asdict(each) for each in found],
    )


def _touch(name: str) -> Touched:
    run = evaluated(name)
    found = deviations(run)
    reaction = np.max(np.abs(run.disturbance.reaction), axis=0).tolist()
    touched = Touched(name, found["max_deviation_rad"], found["final_deviation_rad"], reaction)
    if name != "wall":
        return touched
    force, depth = run.world["wall1_normal_N"][STEADY], run.world["wall1_depth_m"][STEADY]
    off = float(np.max(np.abs(force - run.scenario.wall[0].stiffness_N_m * depth)))
    chatter = float(np.ptp(force))
    return Touched(name, touched.largest_rad, touched.final_rad, reaction, float(np.mean(force)), off, chatter)
