"""Commands to the clock of a server, and how it stands."""

from math import inf
from typing import TYPE_CHECKING, Any

from hil.wire.hello import Command

if TYPE_CHECKING:
    from hil.wire.server import Server

STEP_NS = 1_000_000
"""A step of which nobody says how long it is."""


def obey(server: "Server", command: Command) -> dict[str, Any]:
    """Carry out a command; return how things stand then."""
    now_ns, pace = server.agenda.now_ns, server.pace
    if command.command == "pause":
        pace.pause(now_ns)
    elif command.command == "continue":
        pace.resume()
    elif command.command == "step":
        pace.step(now_ns, command.step_ns or STEP_NS)
    elif command.command == "pace":
        pace.set(command.pace or inf)
    return status(server)


def status(server: "Server") -> dict[str, Any]:
    """Return time, pace, whom the bus waits for and for how long, and what every controller counted."""
    pace, waiting = server.pace, server.waiting
    return {
        "now_ns": server.agenda.now_ns,
        "pace": None if pace.unlimited else pace.rate,
        "paused": pace.paused,
        "waiting_for": None if waiting is None else {"name": waiting[0], "seconds": waiting[1]},
        "missing": [] if server.started else server.missing(),
        "died": list(server.died),
        "nodes": {
            port.name: port.controller.counts() | {"channel": channel}
            for channel, kernel in server.buses.items()
            for port in kernel.ports
        },
    }
