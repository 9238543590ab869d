"""The command `hil quantise`."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hil.options import AsJson, ScenarioName, Settings, new_folder, with_clock
from hil.reported import refuse_faults, reported

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hil.quantise.rest_cases import Found
    from hil.scenario import Scenario

QUANTISATION = "quantisation.json"


@reported
def quantise(
    scenario: ScenarioName = "paper-joint",
    settings: Settings = [],  # noqa: B006 (typer reads the default, nobody writes it)
    out: Annotated[Path | None, typer.Option(help="Folder for the results.")] = None,
    words: Annotated[
        bool, typer.Option("--words", help="Try words of 8 to 32 bits, and tell where the knee is.")
    ] = False,
    as_json: AsJson = False,
    rest: Annotated[bool, typer.Option("--rest", help="At rest, too: limit cycles and dead bands, by format.")] = False,
) -> None:
    """Tell what words do to the joints: ranges, head-room, overflows, and the error beside float64."""
    from rich.console import Console

    from hil import scenario_file, show
    from hil.quantise import rest_cases, rest_show
    from hil.quantise import show as tables
    from hil.quantise.study import study
    from hil.quantise.word_length import word_lengths
    from hil.quantise.words_show import show_words

    chosen = scenario_file.load(scenario, with_clock(settings, "virtual"))
    if out is not None:
        new_folder(out, as_json, chosen.name)
    if rest:
        rest_cases.check(chosen)
    with show.progress(f"{chosen.name}", quiet=as_json) as (step, _notice):
        result = study(chosen, step)
    if words:
        with show.progress(f"{chosen.name}, words", quiet=as_json) as (step, _notice):
            result.found["words"] = word_lengths(chosen, step)
    at_rest = []
    if rest and not result.faults:
        with show.progress(f"{chosen.name}, at rest", quiet=as_json) as (step, _notice):
            at_rest = rest_cases.study(chosen, step)
        result.found.update(rest_cases.to_json(at_rest))
    if out is not None:
        _write(result.found, chosen, at_rest, out)
    if as_json:
        print(json.dumps(result.found, allow_nan=False))
    else:
        console = Console(markup=False, highlight=False)
        tables.show(console, result.found)
        if words:
            show_words(console, result.found["words"])
        if at_rest:
            rest_show.show_rest(console, result.found)
    refuse_faults(result.faults)


def _write(found: dict[str, Any], scenario: "Scenario", at_rest: "Sequence[Found]", path: Path) -> None:
    """Write the folder, whole or not at all."""
    from hil.quantise.rest_figure import write_rest
    from hil.record import SCENARIO, run_folder, to_toml

    with run_folder(path) as folder:
        if at_rest:
            write_rest(folder, at_rest)
        (folder / QUANTISATION).write_text(json.dumps(found, indent=2, allow_nan=False) + "\n")
        (folder / SCENARIO).write_text(to_toml(scenario))
        if "words" in found:
            from hil.quantise.words_figure import write_figure

            write_figure(folder, scenario.name, found["words"])
