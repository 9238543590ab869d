"""The command `hil cpu`."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hil.options import AsJson, ScenarioName, Settings, new_folder
from hil.reported import refuse_faults, reported

if TYPE_CHECKING:
    from hil.i8086.study import Study

CPU = "cpu.json"


@reported
def cpu(
    scenario: ScenarioName = "paper-joint",
    settings: Settings = [],  # noqa: B006 (typer reads the default, nobody writes it)
    out: Annotated[Path | None, typer.Option(help="Folder for the results, with a figure.")] = None,
    as_json: AsJson = False,
) -> None:
    """Count what the joints' step takes as 8086 machine code, and say what that means at 5, 8 and 10 MHz."""
    from rich.console import Console

    from hil import show
    from hil.i8086.show import show_cpu
    from hil.i8086.study import study, with_machine_code

    chosen = with_machine_code(scenario, settings)
    if out is not None:
        new_folder(out, as_json, chosen.name)
    with show.progress(f"{chosen.name}", quiet=as_json) as (step, _notice):
        result = study(chosen, step)
    console = Console(markup=False, highlight=False)
    if as_json:
        print(json.dumps(result.found, allow_nan=False))
    else:
        show_cpu(console, result.found)
    if out is not None:
        _write(result, out)
        if not as_json:
            console.print(f"results: {out}", soft_wrap=True)
    refuse_faults(result.faults)


def _write(result: "Study", path: Path) -> None:
    """Write the folder, whole or not at all."""
    from hil.i8086.figure import write_figure
    from hil.record import SCENARIO, run_folder, to_toml

    with run_folder(path) as folder:
        if result.found["cost"] is not None:
            write_figure(folder, result.found)
        (folder / CPU).write_text(json.dumps(result.found, indent=2, allow_nan=False) + "\n")
        (folder / SCENARIO).write_text(to_toml(result.scenario))
