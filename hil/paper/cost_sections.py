"""Parts of the report: table 1, and computed torque as the rival."""

from concurrent.futures import Executor
from dataclasses import asdict

import numpy as np

from hil import scenario_file
from hil.paper import rivals as study
from hil.paper.cells import URAD
from hil.paper.report import Claim, Folder, Section, Table
from hil.paper.table1 import AS_READ, DIFFERENCE, newton_euler_ledger, observer_steps, table_1

TABLE1_TEXT = (
    "Counted on running code: the observer's step in 16-bit words, in every cycle of a run; and the recursive Newton-"
    "Euler dynamics of a general arm, as Luh, Walker and Paul print it, against MuJoCo in the tests. The paper gives "
    "totals alone; the lines beside ours are one reading that yields exactly its 132 n and 111 n. An arm whose zeros "
    "are known takes less: the planar one's dynamics, as the DSP computes them below, are counted, too."
)
RIVALS_TEXT = (
    "Computed torque on the same arm, joints, wire and gains: the DSP sends torques of its model of the arm, and the "
    "joints' observers are off. All parameters of the model, or Jn of the observer, are wrong by 20 %, or the hand "
    "holds 2 kg. With an exact model computed torque starts better, since it knows of gravity before it is felt. What"
    " is left to it is the delay of its torques (1.5 ms times the commanded jerk over K2: 22 urad at both ends of the"
    " motion), and friction at rest, whose direction nobody knows."
)


def table1(executor: Executor, _folder: Folder) -> Section:
    """Table 1: the cost of a sample."""
    steps = executor.submit(observer_steps).result()
    ((multiplications, additions),) = steps
    rows = list(table_1((multiplications, additions)))
    by_line = newton_euler_ledger(1).lines
    return Section(
        "table1",
        "Table 1: computation per sample",
        TABLE1_TEXT,
        [
            Claim(
                "the observer takes 3 n multiplications and 6 n additions",
                "table 1",
                f"{multiplications} and {additions} a joint in every one of {sum(steps.values())} steps",
                (multiplications, additions) == (3, 6),
            ),
            Claim(
                "Newton-Euler inverse dynamics takes some 40 and 20 times as many: 132 n and 111 n - 4",
                "table 1",
                f"134 n and 111 n. {DIFFERENCE}",
                all(row.explained for row in rows),
            ),
        ],
        [
            Table(
                "multiplications, additions a sample",
                ("joints", "Newton-Euler", "paper", "observer", "paper", "planar arm, viscosity and friction in"),
                [(str(row.joints), *(f"{m}, {a}" for m, a in row.costs)) for row in rows],
            ),
            Table(
                "Newton-Euler a link: multiplications, additions",
                ("line", "counted", "as we read the paper"),
                [(name, *(f"{m}, {a}" for m, a in (cost, AS_READ[name]))) for name, cost in by_line.items()],
            ),
        ],
        values=[asdict(row) for row in rows],
    )


def rivals(executor: Executor, folder: Folder) -> Section:
    """Computed torque beside the observer."""
    found = study.compare_rivals(scenario_file.load("paper-joint"), executor)
    if folder is not None:
        from hil.paper.plots import draw_bars

        bars = {f"joint {n + 1}": [row.largest_rad[n] / URAD for row in found] for n in range(3)}
        title = "largest deviation of paper-joint under the observer and under computed torque."
        draw_bars(folder / "rivals", title, "largest deviation, µrad", [row.name for row in found], bars)
    largest = {row.name: np.array(row.largest_rad) / URAD for row in found}
    final = {row.name: max(row.final_rad) / URAD for row in found}
    errors = [(f"observer, {o}", f"computed torque, {c}") for o, c in study.SAME_ERROR]
    worse = [float(np.min(largest[rival] / largest[observer])) for observer, rival in errors]
    rows = [
        (
            row.name,
            *(f"{a / URAD:.0f} / {b / URAD:.1f}" for a, b in zip(row.largest_rad, row.final_rad, strict=True)),
            row.fault or str(row.saturations),
        )
        for row in found
    ]
    joints = [f"joint {n + 1}" for n in range(len(found[0].largest_rad))]
    return Section(
        "rivals",
        "The rival: computed torque",
        RIVALS_TEXT,
        [
            Claim(
                "inverse dynamics needs the parameters of the arm; the observer does not",
                "table 1, eqs. (4), (9)",
                f"with the same error the rival's largest deviation is {', '.join(f'{x:.0f}' for x in worse)} times "
                f"the observer's and more, its final one {max(final[rival] for _, rival in errors):.0f} urad against "
                f"{max(final[observer] for observer, _ in errors):.0f}",
                min(worse) > 3 and max(final[observer] for observer, _ in errors) < 30,
            )
        ],
        [Table("joint deviation, urad, largest / final", ("controller", *joints, "saturations"), rows)],
        [("rivals", "largest deviation of every controller")],
        [asdict(row) for row in found],
    )
