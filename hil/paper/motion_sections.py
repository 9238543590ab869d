"""Parts of the report: figs. 15 and 16, steps, a shorter period. Each measures, judges and, given a folder, draws."""

from concurrent.futures import Executor
from dataclasses import asdict

import numpy as np

from hil.paper import deviation
from hil.paper.cells import URAD, listed, made, mrad, small, times, urad
from hil.paper.report import Claim, Folder, Section, Table
from hil.summary import deviations


def fig15(executor: Executor, folder: Folder) -> Section:
    """Fig. 15: joint space, without and with the observer."""
    on, off = executor.map(deviation.evaluated, ["paper-joint"] * 2, ["joint.observer=true", deviation.OFF])
    if folder is not None:
        from hil.figures import write_figures

        write_figures(made(folder / "fig15"), on, off)
    found = [deviations(run) for run in (on, off)]
    largest, final = ([np.array(each[key]) for each in found] for key in ("max_deviation_rad", "final_deviation_rad"))
    ratios = largest[1] / largest[0], final[1] / final[0]
    rows = [
        (str(n + 1), *(f"{values[n] / URAD:.1f}" for pair in (largest, final) for values in pair))
        for n in range(len(largest[0]))
    ]
    return Section(
        "fig15",
        "Fig. 15: position control in joint space",
        "Every joint by half a radian in 1 s; (a) without the observer a deviation remains, from gravity and friction; "
        "(b) with it nearly nothing does. The largest deviation of (b) is the start: the brakes let go at cycle 0, "
        "before the first current.",
        [
            Claim(
                "without the observer a deviation remains",
                "fig. 15a",
                f"{mrad(final[1])} mrad",
                bool(np.all(final[1] > 5e-4)),
            ),
            Claim(
                "with the observer it becomes fairly small, at equal gains",
                "fig. 15b",
                f"{urad(final[0])} urad: {times(ratios[1])} times less; the largest {times(ratios[0])} times less",
                bool(np.all(ratios[0] > 10) and np.all(ratios[1] > 50)),
            ),
        ],
        [Table("joint deviation, urad", ("joint", "largest, on", "largest, off", "final, on", "final, off"), rows)],
        [("fig15/deviation", "joint deviation"), ("fig15/disturbance", "what the observers estimate, and the truth")],
        {"largest_rad": [x.tolist() for x in largest], "final_rad": [x.tolist() for x in final]},
    )


def fig16(executor: Executor, folder: Folder) -> Section:
    """Fig. 16: task space."""
    on, off = executor.map(deviation.evaluated, ["paper-task"] * 2, ["joint.observer=true", deviation.OFF])
    if folder is not None:
        from hil.figures import write_figures

        write_figures(made(folder / "fig16"), on, off)
    found = [deviations(run) for run in (on, off)]
    velocity = [np.array(each["max_velocity_deviation_m_s"]) * 100 for each in found]
    position = [np.array(each["max_position_deviation_m"]) * 1000 for each in found]
    peak = found[0]["peak_command_speed_m_s"] * 100
    lines = deviation.interference(executor)
    across_mm = max(line.across_m for line in lines) * 1000
    rows = [
        (line.axis, *(f"{m * 1000:.3f}" for m in (line.along_m, line.across_m, line.across_without_observer_m)))
        for line in lines
    ]
    return Section(
        "fig16",
        "Fig. 16: continuous-path control in task space",
        f"Once round a circle of 5 cm radius in 1 s, {peak:.0f} cm/s at its fastest; and straight lines of 10 cm in "
        "0.5 s along one axis, to see what the other does.",
        [
            Claim(
                "the position coincides with the command",
                "fig. 16",
                f"within {listed(position[0], '.2f')} mm (x, y)",
                bool(np.all(position[0] < 0.3)),
            ),
            Claim(
                "the largest velocity deviation is about 2 cm/s",
                "fig. 16",
                f"{listed(velocity[0], '.2f')} cm/s (x, y); without the observer {listed(velocity[1], '.1f')}",
                bool(np.all(velocity[0] <= 1.2)),
            ),
            Claim(
                "little interference from the other direction",
                "fig. 16",
                f"{across_mm:.3f} mm across a line of 100 mm",
                across_mm <= 0.3,
            ),
        ],
        [
            Table(
                "a line along an axis: largest deviation, mm", ("axis", "along", "across", "across, observer off"), rows
            )
        ],
        [("fig16/task-space", "the tip, command and deviation")],
        {
            "max_velocity_deviation_cm_s": [x.tolist() for x in velocity],
            "max_position_deviation_mm": [x.tolist() for x in position],
            "interference": [asdict(line) for line in lines],
        },
    )


def steps(executor: Executor, _folder: Folder) -> Section:
    """Eqs. (18)-(19) and (25)-(26): step disturbances."""
    found = deviation.steps(executor)
    worst = {unit: max(max(step.left) for step in found if step.unit == unit) for unit in ("rad", "m")}
    rows = [(step.what, small(step.left, step.unit), small(step.left_without_observer, step.unit)) for step in found]
    return Section(
        "steps",
        "Step disturbances",
        "What is left at the end, 0.9 s after the step (rms of the last 100 ms).",
        [
            Claim(
                "a step leaves no final deviation in joint space",
                "(18), (19)",
                f"{worst['rad'] / URAD:.1f} urad",
                worst["rad"] <= 30e-6,
            ),
            Claim("nor in task space", "(25), (26)", f"{worst['m'] * 1e6:.1f} um", worst["m"] <= 30e-6),
        ],
        [Table("what is left of a step", ("step", "observer on", "observer off"), rows)],
        values=[asdict(step) for step in found],
    )


def shorter_period(executor: Executor, _folder: Folder) -> Section:
    """The paper's last paragraph on joint space."""
    found = deviation.shortest_periods(executor)
    offline, task = found
    return Section(
        "period",
        "A shorter period in joint space",
        "With the path known beforehand, inverse kinematics is done offline, and the DSP computes less in a "
        "period. The computing times are parameters (dsp.compute_s); the arm of one joint leaves room on the bus, "
        "so they decide.",
        [
            Claim(
                "joint-space control can hold a shorter period",
                "text on joint space",
                f"{offline.period_s * 1e3:g} ms against {task.period_s * 1e3:g} ms",
                offline.period_s < task.period_s,
            )
        ],
        [
            Table(
                "the shortest period that holds",
                ("control", "DSP computes, us", "period, ms", "largest deviation, urad"),
                [
                    (
                        each.what,
                        f"{each.compute_s * 1e6:g}",
                        f"{each.period_s * 1e3:g}",
                        f"{each.largest_rad / URAD:.0f}",
                    )
                    for each in found
                ],
            )
        ],
        values=[asdict(each) for each in found],
    )
