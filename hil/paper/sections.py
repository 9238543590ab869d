"""All parts of the report on the paper, in the order of the paper."""

from collections.abc import Callable
from concurrent.futures import Executor

from hil.paper import cost_sections, motion_sections, observer_sections
from hil.paper.report import Folder, Section

SECTIONS: dict[str, Callable[[Executor, Folder], Section]] = {
    "fig. 8": observer_sections.fig8,
    "table 1": cost_sections.table1,
    "computed torque": cost_sections.rivals,
    "fig. 15": motion_sections.fig15,
    "fig. 16": motion_sections.fig16,
    "steps": motion_sections.steps,
    "inertia and payload": observer_sections.tolerance,
    "noise": observer_sections.noise_claim,
    "shorter period": motion_sections.shorter_period,
}
