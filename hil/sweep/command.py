"""The command `hil sweep`."""

import json
import os
import tempfile
from contextlib import nullcontext
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from hil.options import Settings
from hil.reported import reported


@reported
def sweep(
    file: Annotated[str, typer.Argument(help="A built-in sweep's name, or a .toml file.")],
    settings: Settings = [],  # noqa: B006 (typer reads the default, nobody writes it)
    out: Annotated[
        Path | None, typer.Option(help="Folder of the results; that of the same sweep, interrupted, goes on.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the summary as JSON; no folder without --out.")
    ] = False,
    jobs: Annotated[int | None, typer.Option(min=1, max=256, help="Runs at a time; default: one a CPU.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="HOST:PORT", help="Run on the Dask cluster of this scheduler.")
    ] = None,
) -> None:
    """Run a scenario at many points: grids, lists, Latin hypercubes, Monte Carlo, into one table (Parquet)."""
    from rich.console import Console

    from hil import show
    from hil.sweep import crew, sweep_file
    from hil.sweep import show as tables
    from hil.sweep.folder import sweep_folder
    from hil.sweep.run import carry_out, plan

    if jobs is not None and scheduler is not None:
        raise typer.BadParameter(f"--jobs {jobs} with --scheduler: a cluster has as many workers as it has")
    read = sweep_file.load(file, settings)
    found = plan(read)
    hands = partial(crew.processes, jobs) if scheduler is None else partial(crew.cluster, scheduler)
    if out is None and not as_json:
        out = Path("runs") / f"sweep-{Path(file).stem}-{datetime.now():%Y%m%d-%H%M%S}-{os.getpid()}"
    with (
        show.counting(Path(file).stem, len(found.points), quiet=as_json) as (step, notice),
        tempfile.TemporaryDirectory() if out is None else nullcontext(out) as path,
        sweep_folder(Path(path), sweep_file.to_toml(read)) as folder,
    ):
        told = lambda done: step(sum(done.values()), tables.status(done))  # noqa: E731
        try:
            summary = carry_out(found, folder, hands, told, notice)
        except BaseException:
            if out is not None and folder.has_rows:
                notice(f"what is done is in {out}: the same command with --out {out} goes on")
            raise
    if as_json:
        print(json.dumps(summary, allow_nan=False))
    else:
        tables.show(Console(markup=False, highlight=False), summary, out)
