"""The command line: `hil run`, `hil paper`, `hil scenarios`, `hil bus`, `hil clock`, `hil node`, `hil doctor`,
`hil timing`, `hil quantise`, `hil sweep`, `hil cpu`.

Exit codes: 0 all well, 2 usage, 3 scenario, 4 channel, 5 node, 6 fault of the emulated system, 7 output, 8 missing
extra, 128 + n for signal n (130 Ctrl-C, 143 SIGTERM).
"""

import atexit
import gc
import json
import os
import sys
import time
from importlib import metadata
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import typer

from hil.doctor.command import doctor
from hil.errors import FaultError, OutputError
from hil.i8086.command import cpu
from hil.options import (
    At,
    BusKwargs,
    ChannelName,
    ClockKind,
    External,
    Interface,
    ScenarioName,
    ScenarioOption,
    Settings,
    channels_of,
    dilated,
    new_folder,
    place_of,
    with_clock,
)
from hil.quantise.command import quantise
from hil.reported import reported
from hil.sweep.command import sweep
from hil.timing.command import timing

if TYPE_CHECKING:
    from hil.rig import Outcome

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)


def _age_s() -> float:
    """Return the wall time since this process started."""
    try:
        started_ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
        return time.clock_gettime(time.CLOCK_BOOTTIME) - started_ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, AttributeError):
        return time.perf_counter() - _IMPORTED


_IMPORTED = time.perf_counter()


@app.command()
@reported
def run(
    scenario: ScenarioName = "paper-joint",
    inline: Annotated[bool, typer.Option("--inline", help="All nodes and the wire in one process.")] = False,
    settings: Settings = [],  # noqa: B006 (typer reads the default, nobody writes it)
    out: Annotated[Path | None, typer.Option(help="Run folder; default: one of its own in runs/.")] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the summary as JSON; no folder without --out.")
    ] = False,
    channel: Annotated[str | None, typer.Option("--channel", "-c", help="Name of the bus, for observers.")] = None,
    patience: Annotated[
        float | None,
        typer.Option(min=0.5, help="Seconds to wait for a node that does not answer; default: 20, by sync no limit."),
    ] = None,
    pace: Annotated[
        float | None,
        typer.Option(min=1e-6, max=1e6, help="Virtual seconds a real second; default: as fast as it goes."),
    ] = None,
    interface: Interface = "hil",
    bus_kwargs: BusKwargs = "{}",
    clock: ClockKind = None,
    external: External = [],  # noqa: B006 (as above)
    at: At = [],  # noqa: B006 (as above)
) -> None:
    """Run an experiment: every node a process, over CAN in virtual time, or on any CAN interface (clock sync, wall)."""
    from hil import scenario_file, show
    from hil.processes import run_processes
    from hil.rig import run_inline
    from hil.warn import warnings

    chosen = scenario_file.load(scenario, with_clock(settings, clock))
    place = place_of(interface, channel, bus_kwargs, chosen.clock.kind)
    if pace is not None and place is not None:
        chosen = dilated(chosen, pace)
    if inline and (pace is not None or place is not None):
        raise typer.BadParameter("--inline with --pace, --interface or another clock than virtual: leave --inline out")
    if place is None and (external or at):
        raise typer.BadParameter("--external and --at need a bus without time of its own: --clock sync or wall")
    out = new_folder(out, as_json, chosen.name)
    age_s = _age_s()
    with show.progress(f"{chosen.name}", quiet=as_json) as (step, notice):
        for text in warnings(chosen):
            notice(f"warning: {text}")
        if place is not None:
            from hil.bus_rig import run_on_bus

            outcome = run_on_bus(chosen, place, external, channels_of(at), step, notice, patience or inf)
        elif inline:
            outcome = run_inline(chosen, step)
        else:
            outcome = run_processes(
                chosen, channel or f"run-{os.getpid()}", step, notice, patience or 20.0, pace or inf
            )
    _conclude(outcome, age_s, as_json, out)


def _conclude(outcome: "Outcome", age_s: float, as_json: bool, out: Path | None) -> None:
    """Evaluate a run, write and show it; a run that stopped itself is an error."""
    from hil import experiment, show

    result = experiment.examine(outcome, age_s + outcome.setup_wall_s)
    if out is not None:
        experiment.write(result, out)
    print(json.dumps(result.summary, allow_nan=False)) if as_json else show.result(result, out)
    for fault in result.summary["faults"]:
        raise FaultError(
            f"the run stopped at {fault['time_s']:.3f} s: {fault['node']}: {fault['reason']} ({fault['cause']})"
        )


@app.command()
@reported
def scenarios() -> None:
    """List the built-in scenarios."""
    from hil import scenario_file

    for name in scenario_file.builtin_names():
        print(f"{name:14}{scenario_file.load(name).title}")


@app.command()
@reported
def bus(
    channels: Annotated[list[str] | None, typer.Argument(help="Names of the buses; default: arm.")] = None,
    expect: Annotated[str, typer.Option(help="Timed clients to wait for: plant,dsp,joint1,...")] = "",
    bitrate: Annotated[int, typer.Option(min=10_000, max=1_000_000, help="Bits per second.")] = 1_000_000,
    data_bitrate: Annotated[
        int | None, typer.Option(min=10_000, max=20_000_000, help="CAN FD: bits per second of the data phase.")
    ] = None,
    fidelity: Annotated[Literal["bits", "functional"], typer.Option(help="What a frame costs.")] = "bits",
    pace: Annotated[
        float | None,
        typer.Option(min=1e-6, max=1e6, help="Virtual seconds a real second; default: as fast as it goes."),
    ] = None,
    go_on: Annotated[bool, typer.Option("--go-on", help="Go on without a timed client that dies.")] = False,
    faults: Annotated[Path | None, typer.Option(help="Faults on the wire: a TOML file of [[fault]] tables.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of random bit errors.")] = 0,
) -> None:
    """Serve buses until Ctrl-C; several share one virtual time."""
    from hil.bus import BusOptions, serve
    from hil.wire import fault_file, rates

    try:
        bits = rates.of_bitrates(bitrate, data_bitrate)
    except ValueError as error:
        given = f"--bitrate {bitrate}" + ("" if data_bitrate is None else f" --data-bitrate {data_bitrate}")
        raise typer.BadParameter(f"{given}: {error}") from None
    names = list(dict.fromkeys(channels or ["arm"]))
    functional = fidelity == "functional"
    script = () if faults is None else fault_file.load(faults, functional, bits.fd)
    awaited = tuple(dict.fromkeys(name.strip() for name in expect.split(",") if name.strip()))
    try:
        serve(names, BusOptions(bits, functional, awaited, pace, go_on, script, seed), _say)
    except KeyboardInterrupt:
        _say(f"bus {', '.join(repr(name) for name in names)}: ended")


@app.command()
@reported
def clock(
    channel: Annotated[str, typer.Argument(help="Name of the bus.")] = "arm",
    command: Annotated[
        Literal["status", "pause", "step", "continue", "pace"], typer.Argument(help="What the bus shall do.")
    ] = "status",
    value: Annotated[
        float | None,
        typer.Argument(help="step: virtual seconds; pace: virtual seconds a real second (none: no limit)."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the answer as JSON.")] = False,
) -> None:
    """Pause a bus, step it, let it go on, set its pace, or ask how it stands."""
    from hil import show
    from hil.wire import client

    if value is not None and (command not in ("step", "pace") or not 1e-9 <= value <= 1e6):
        raise typer.BadParameter(f"{command} {value}: step and pace take a number from 1e-9 to 1e6, the others none")
    detail: dict[str, Any] = {}
    if command == "step":
        detail = {"step_ns": round((value or 1e-3) * 1e9)}
    elif command == "pace":
        detail = {"pace": value}
    status = client.control(channel, command=command, **detail)
    print(json.dumps(status)) if as_json else show.bus_status(channel, status)


@app.command()
@reported
def paper(
    out: Annotated[Path | None, typer.Option(help="Folder of the page; default: one of its own in runs/.")] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the figures as JSON; no folder without --out.")
    ] = False,
    only: Annotated[
        list[str],
        typer.Option("--only", metavar="PART", help="Only this part, with its tables: table1, fig8, .. (repeatable)."),
    ] = [],  # noqa: B006 (as above)
    jobs: Annotated[int | None, typer.Option(min=1, max=256, help="Runs at a time; default: one a CPU.")] = None,
) -> None:
    """Reproduce the paper: every table, figure and claim beside what the rig does."""
    from hil import show
    from hil.paper import reproduce
    from hil.paper.report import to_json

    out = new_folder(out, as_json, "paper")
    with show.progress("paper", quiet=as_json) as (step, _notice):
        found = reproduce.reproduce(out, jobs, step, only)
    print(json.dumps(to_json(found), allow_nan=False)) if as_json else show.report(found, bool(only), out)


@app.command()
@reported
def node(
    role: Annotated[str, typer.Argument(help="plant, dsp or joint.")],
    number: Annotated[int | None, typer.Argument(help="Which joint, from 1.", metavar="N")] = None,
    interface: Interface = "hil",
    bus_kwargs: BusKwargs = "{}",
    channel: ChannelName = "arm",
    scenario: ScenarioOption = "paper-joint",
    settings: Settings = [],  # noqa: B006 (as above)
    clock: ClockKind = None,
    pace: Annotated[float | None, typer.Option(min=1e-6, max=1.0, help="Of the clock wall, as the rig's.")] = None,
) -> None:
    """Play one participant, in its own terminal, until the run ends."""
    from hil import scenario_file, show
    from hil.assemble import check_node_name
    from hil.before_run import check_place
    from hil.bus_rig import for_bus
    from hil.can_node import play
    from hil.node_process import run_node

    if (role == "joint") != (number is not None):
        raise typer.BadParameter("write plant, dsp, or joint N")
    name = role if number is None else f"{role}{number}"
    chosen = scenario_file.load(scenario, with_clock(settings, clock))
    check_node_name(chosen, name)
    place = place_of(interface, channel, bus_kwargs, chosen.clock.kind)
    if pace is not None:
        chosen = dilated(chosen, pace)
    print(f"{name} of {chosen.name} on channel {channel}", flush=True)
    if place is not None:
        check_place(place, chosen)
    report = run_node(chosen, name, channel) if place is None else play(for_bus(chosen), name, place)
    for line in report.get("refused", []):
        print(f"{name}: {line}")
    print(f"{name}: the run is over; {show.counters(report)}")
    if report["fault"]:
        raise FaultError(f"{name}: {report['fault']}")


app.command()(doctor)
app.command()(timing)
app.command()(quantise)
app.command()(sweep)
app.command()(cpu)


def _say(text: str) -> None:
    print(text, flush=True)


@app.callback(invoke_without_command=True)
def version(
    show_version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False,
) -> None:
    """Test the distributed controllers of a robot over CAN, without the robot."""
    if show_version:
        print(metadata.version("hil"))
        raise typer.Exit


def main() -> None:
    """Be the command `hil`; output that nobody can take is an error of its own."""
    atexit.register(gc.freeze)  # or the interpreter searches all that is imported for garbage before it ends
    sys.stdout = sys.stdout or Path(os.devnull).open("w")  # noqa: SIM115 (for the whole process)
    sys.stderr = sys.stderr or Path(os.devnull).open("w")  # noqa: SIM115 (as above)
    try:
        try:
            app()
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        _leave(1)
    except OSError as error:
        print(f"hil: standard output: {error.strerror}: send it elsewhere", file=sys.stderr)
        _leave(OutputError.exit_code)


def _leave(exit_code: int) -> NoReturn:
    """End without another try to write what is still buffered."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(exit_code)
