"""All parts of the report on the paper, by name, in their order."""

from collections.abc import Callable
from concurrent.futures import Executor

from hil.paper import backend_section, cost_sections, motion_sections, observer_sections, world_section
from hil.paper.report import Folder, Section

SECTIONS: dict[str, Callable[[Executor, Folder], Section]] = {
    "fig8": observer_sections.fig8,
    "table1": cost_sections.table1,
    "fig15": motion_sections.fig15,
    "fig16": motion_sections.fig16,
    "steps": motion_sections.steps,
    "tolerance": observer_sections.tolerance,
    "noise": observer_sections.noise_claim,
    "period": motion_sections.shorter_period,
    "rivals": cost_sections.rivals,
    "world": world_section.world,
    "backends": backend_section.backends,
}
