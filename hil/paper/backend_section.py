"""A part of the report: the closed form of the arm, which all else stands on, beside pymunk's arm of constraints."""

from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from dbc.compiler import load_arm
from hil import scenario_file
from hil.assemble import arm_parameters
from hil.backends import BackendComparison, Difference, compare_backends
from hil.paper.report import Claim, Folder, Section, Table
from plant.robot import Robot

BACKENDS_TEXT = (
    "The arm is computed twice: by the closed form with Runge-Kutta steps, and by pymunk as bodies with pivots, in "
    "steps of 100 us. pymunk carries direct drives only (a geared rotor turns with the joint, not with the link). A "
    "free swing says how far the two are apart. In a closed loop every count matters: where the edge of a count falls"
    " between two angles, one frame differs, and from there on each loop answers counts of its own. The control is "
    "the closed form against itself with 1 mg on the hand."
)
HANGING_RAD = (-1.3, 0.2, -0.1)
SWING_S = 2.0
MS = 1_000_000


def backends(executor: Executor, _folder: Folder) -> Section:
    """Both backends: a free swing, and the scenario direct-drive."""
    swing, loops = executor.submit(swing_apart), list(executor.map(_compare, ("true", "false")))
    apart, (on, off) = swing.result(), loops
    rows = [
        (what, f"{each.counts.size:.0f}", f"{each.angle.size:.1e}", _first(each))
        for name, loop in zip(("on", "off"), loops, strict=True)
        for what, each in ((f"observer {name}", loop.backends), (f"observer {name}, control", loop.control))
    ]
    return Section(
        "backends",
        "The arm, computed twice",
        BACKENDS_TEXT,
        [
            Claim(
                "(ours) two independent arms agree",
                "eq. (1)",
                f"within {apart:.1e} rad in a free swing of 2 s",
                apart <= 3e-6,
            ),
            Claim(
                "(ours) and so do closed loops on them",
                "eq. (1)",
                f"angles within {on.backends.angle_before.size:.1e} rad up to the first other count "
                f"({_first(on.backends)}); by the end at most {on.backends.counts.size:.0f} counts, the control "
                f"{on.control.counts.size:.0f}; without the observer {off.backends.counts.size:.0f}",
                on.backends.angle_before.size < 1e-6 and off.backends.counts.size <= 1,
            ),
        ],
        [
            Table(
                "direct-drive for 1.5 s: pymunk against the closed form",
                ("loop", "counts", "rad", "first other frame"),
                rows,
            )
        ],
        values={"swing_rad": apart, "observer_on": _values(on), "observer_off": _values(off)},
    )


def _compare(observer: str) -> BackendComparison:
    return compare_backends(scenario_file.load("direct-drive", [f"joint.observer={observer}"]))


def swing_apart() -> float:
    """Return how far apart [rad] the two are, at most, while the arm of direct-drive swings without friction."""
    arm = replace(arm_parameters(scenario_file.load("direct-drive"), load_arm()), viscosity_Nms=(0.0, 0.0, 0.0))
    paths = []
    for backend in ("closed", "pymunk"):
        robot = Robot(arm, HANGING_RAD, backend=backend)
        robot.release_brakes(0)
        path = []
        for k in range(1, round(SWING_S * 1000) + 1):
            robot.advance_to(k * MS)
            path.append(robot.q)
        paths.append(np.array(path))
    return float(np.max(np.abs(paths[0] - paths[1])))


def _first(found: Difference) -> str:
    return "none" if found.first is None else f"cycle {found.first.cycle}, joint {found.first.joint}"


def _values(found: BackendComparison) -> dict[str, object]:
    return {
        name: {"counts": each.counts.size, "angle_rad": each.angle.size, "angle_before_rad": each.angle_before.size}
        for name, each in (("backends", found.backends), ("control", found.control))
    }
