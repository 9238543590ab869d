"""Who gets a frame of one bus: those that accept it, and whoever watches."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from hil.wire.identifier import OWN
from hil.wire.port import IGNORES, Port, route_key

if TYPE_CHECKING:
    from hil.wire.medium import Medium

Watcher = Callable[[int, int, bytes, str], None]
"""Called with (end of frame in ns, identifier, data, sender) for every frame on the bus."""

ROUTES = 4096
"""Identifiers whose acceptance is remembered; random ones must not fill the memory."""


class Delivery:
    """Hands frames over. watchers: told of every frame that its sender holds sent."""

    def __init__(self, medium: "Medium") -> None:
        self.watchers: list[Watcher] = []
        self._medium = medium
        self._routes: dict[int, list[tuple[Port, int]]] = {}

    def forget(self) -> None:
        """Ask everybody anew what they accept."""
        self._routes.clear()

    def deliver(self, sender: Port, now_ns: int, identifier: int, data: bytes) -> None:
        """Hand a frame that ends now to everybody who accepts it."""
        arrival = (now_ns, identifier, data)
        route = self._routes.get(identifier)
        for receiver, how in self._route(identifier) if route is None else route:
            if receiver is not sender:
                receiver.take(arrival, how)
            elif sender.echo:
                sender.take((now_ns, identifier | OWN, data), how)
        for watcher in self.watchers:
            watcher(now_ns, identifier, data, sender.name)

    def confirm(self, sender: Port, now_ns: int, identifier: int, data: bytes) -> None:
        """Confirm a frame that was played bit by bit; receivers read it themselves."""
        if sender.echo:
            self.receive(sender, now_ns, identifier | OWN, data)
        for watcher in self.watchers:
            watcher(now_ns, identifier, data, sender.name)

    def receive(self, port: Port, now_ns: int, identifier: int, data: bytes) -> None:
        """Hand over a frame that one participant read bit by bit."""
        how = port.accepts(route_key(identifier & ~OWN))
        if how != IGNORES:
            port.take((now_ns, identifier, data), how)

    def _route(self, identifier: int) -> list[tuple[Port, int]]:
        """Find who accepts an identifier, and what it does with it; found once, kept."""
        key = route_key(identifier)
        acceptances = [(port, port.accepts(key)) for port in self._medium.ports if not port.controller.confinement.off]
        route = [(port, how) for port, how in acceptances if how != IGNORES]
        if len(self._routes) >= ROUTES:
            self._routes.clear()
        self._routes[identifier] = route
        return route
