"""The command `hil timing`."""

from decimal import Decimal

import typer

from hil.options import (
    AsJson,
    At,
    BusKwargs,
    External,
    Interface,
    Settings,
    channels_of,
    dilated,
    new_folder,
    place_of,
    with_clock,
)
from hil.reported import reported
from hil.timing import options

NOMINAL_BITRATE, FAST_BITRATE = 1_000_000, 4_000_000
ERROR_INTERVAL_MS = 10.0


@reported
def timing(
    scenario: options.ScenarioArgument = None,
    dbc: options.Database = None,
    bitrate: options.Bitrate = None,
    data_bitrate: options.DataBitrate = None,
    period: options.Periods = [],  # noqa: B006 (typer reads the default, nobody writes it)
    jitter: options.Jitters = [],  # noqa: B006 (as above)
    deadline: options.Deadlines = [],  # noqa: B006 (as above)
    fifo: options.Fifo = [],  # noqa: B006 (as above)
    depth: options.Depth = None,
    burst: options.Burst = None,
    error_interval: options.ErrorInterval = None,
    settings: Settings = [],  # noqa: B006 (as above)
    interface: Interface = "hil",
    channel: options.WallChannel = None,
    bus_kwargs: BusKwargs = "{}",
    pace: options.Pace = None,
    external: External = [],  # noqa: B006 (as above)
    at: At = [],  # noqa: B006 (as above)
    bus_only: options.BusOnly = False,
    jobs: options.Jobs = None,
    out: options.Out = None,
    as_json: AsJson = False,
) -> None:
    """Bound and measure when every frame arrives and every current acts, and how much delay the loops bear."""
    from hil import scenario_file, show
    from hil.timing import scenario_command as report
    from hil.timing.database import Given
    from hil.timing.database_command import analyse_database, by_name, errors_of, rates_of

    if burst is None:
        refuse("no errors: say how many with --burst", **{"error-interval": error_interval})
    errors = errors_of(burst, ERROR_INTERVAL_MS if error_interval is None else error_interval)
    if (dbc is None) == (scenario is None):
        raise typer.BadParameter("name a scenario, for example paper-joint, or a database with --dbc; one of both")
    if dbc is not None:
        refuse("--dbc", set=settings, channel=channel, external=external, at=at, bus=bus_only, jobs=jobs, out=out)
        jitters = by_name("--jitter", jitter, Decimal(0))
        given = Given(by_name("--period", period), jitters, by_name("--deadline", deadline))
        analyse_database(dbc, rates_of(bitrate or NOMINAL_BITRATE, data_bitrate), given, errors, fifo, depth, as_json)
    elif scenario is not None:
        own = "a scenario, which has its own: see --set"
        refuse(own, bitrate=bitrate, period=period, jitter=jitter, deadline=deadline, fifo=fifo, depth=depth)
        clock = "virtual" if interface == "hil" and channel is None else "wall"
        if clock == "virtual":
            refuse("the rig's own bus: name another with --channel", pace=pace, external=external, at=at)
        scenario_file.load(scenario, settings)  # whose clock is another's matter, but must be one
        chosen = scenario_file.load(scenario, with_clock(settings, clock))
        fast_ns = rates_of(chosen.bus.bitrate, data_bitrate or FAST_BITRATE).data_bit_ns or chosen.bit_ns
        place = place_of(interface, channel, bus_kwargs, clock)
        if out is not None:
            new_folder(out, as_json, chosen.name)
        with show.progress(f"{chosen.name}", quiet=as_json) as (step, notice):
            if place is None:
                found = report.in_virtual_time(chosen, fast_ns, errors, bus_only, jobs, step)
            else:
                where = place, external, channels_of(at)
                found = report.by_the_clock(dilated(chosen, pace or 1.0), *where, fast_ns, errors, step, notice)
        report.conclude(found, as_json, out)


def refuse(what: str, **given: object) -> None:
    """Refuse options that would mean nothing."""
    for name, value in given.items():
        if value not in (None, [], False):
            raise typer.BadParameter(f"--{name} does not go with {what}")
