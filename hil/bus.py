"""`hil bus`: the wire as a server, one session after the other, until it is told to end.

With expected clients time waits for them, and a session is over when they have left; the next one begins anew. Without,
whoever joins is served: virtual time goes as fast as the timed clients answer, and at real time while there are none.
"""

from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from math import inf

from hil.drive import RUN_IS_OVER
from hil.errors import NodeError
from hil.pace import Pace
from hil.watchdog import watchdog
from hil.wire.agenda import Agenda
from hil.wire.channel import Listener
from hil.wire.fault import Fault
from hil.wire.faults import FaultScript
from hil.wire.kernel import Kernel
from hil.wire.observer import Observer
from hil.wire.protocol import FAR_NS
from hil.wire.rates import Rates
from hil.wire.server import Bus, Server

POLL_S = 0.02
OPEN_SLICE_NS = 50_000_000
"""Virtual time after which an open bus looks whether it must change its pace."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class BusOptions:
    """pace: virtual seconds a wall second; None: what suits whoever is there. go_on: see Server."""

    rates: Rates
    functional: bool = False
    expect: Sequence[str] = ()
    pace: float | None = None
    go_on: bool = False
    faults: Sequence[Fault] = field(default=())
    seed: int = 0


def serve(channels: Sequence[str], options: BusOptions, say: Say) -> None:
    """Serve channels for ever; raise ChannelError if another bus holds one. Observers stay from session to session."""
    observers: list[tuple[str, Observer]] = []
    with ExitStack() as stack:
        listeners = [stack.enter_context(closing(Listener(channel))) for channel in channels]
        while True:
            server = _server(listeners, options, say, observers)
            reason, go_on = "the bus ends", False
            try:
                _session(server, channels, options, say)
                reason, go_on = RUN_IS_OVER, True
            except NodeError as error:
                reason, go_on = str(error), True
                say(f"session ended at {server.agenda.now_ns * 1e-9:.6f} s: {error}")
            finally:
                observers = server.end(reason, keep_observers=go_on)


def _server(
    listeners: Sequence[Listener], options: BusOptions, say: Say, observers: Sequence[tuple[str, Observer]]
) -> Server:
    agenda, rates = Agenda(), options.rates
    kernels = [Kernel(rates.bit_ns, options.functional, 0, rates.data_bit_ns, agenda) for _ in listeners]
    for kernel in kernels:
        FaultScript(options.faults, options.seed).install(kernel)
    buses = [Bus(listener, kernel) for listener, kernel in zip(listeners, kernels, strict=True)]
    pace = Pace(inf if options.pace is None else options.pace)
    return Server(buses, options.expect, watchdog(say), pace, options.go_on, observers)


def _session(server: Server, channels: Sequence[str], options: BusOptions, say: Say) -> None:
    names = ", ".join(repr(channel) for channel in channels)
    if not options.expect:
        say(f"bus {names}: open to everybody; Ctrl-C ends it")
        server.start()
        _open(server, options)
        return
    _gather(server, names, say)
    say(f"bus {names}: everybody is there, time begins")
    frames = _count_frames(server)
    server.start()
    server.run(FAR_NS)
    say(f"bus {names}: session over at {server.agenda.now_ns * 1e-9:.6f} s, {frames[0]} frames")


def _gather(server: Server, names: str, say: Say) -> None:
    awaited: list[str] = []
    while missing := server.missing():
        if missing != awaited:
            say(f"bus {names}: waiting for {', '.join(missing)}")
            awaited = missing
        server.poll(POLL_S)


def _open(server: Server, options: BusOptions) -> None:
    told, automatic = server.pace.rate, options.pace is None
    while True:
        automatic = automatic and server.pace.rate == told  # until `hil clock` says otherwise
        wanted = inf if server.timed else 1.0
        if automatic and told != wanted:
            server.pace.set(wanted)
            told = wanted
        server.run(server.agenda.now_ns + OPEN_SLICE_NS)
        server.stay_open()


def _count_frames(server: Server) -> list[int]:
    count = [0]

    def watch(_end_ns: int, _identifier: int, _data: bytes, _sender: str) -> None:
        count[0] += 1

    for kernel in server.buses.values():
        kernel.watchers.append(watch)
    return count
