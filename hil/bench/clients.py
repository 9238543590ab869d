"""One sender and any number of clients, for `make bench`: a bus whose load, clients and acceptance can be chosen.

The sender gives the bus an exact load with frames of eight bytes, whose identifiers take turns. Either each client
accepts one of the identifiers, so that a frame has one client that accepts it, or all accept all.
"""

import selectors
import sys
from typing import Any, NamedTuple

from hil.node import SILENT, Reaction
from hil.wire import client, protocol
from hil.wire.bits import INTERMISSION_BITS, frame_bits
from hil.wire.identifier import STANDARD_MASK
from hil.wire.protocol import Connection

BIT_NS = 1000
FIRST = 0x200
"""Identifier of the first frame; the others follow."""
DATA = bytes(range(8))
A_BATCH = 4
"""Frames that the sender queues at once."""


class Case(NamedTuple):
    """kind: `inline`, `observers` or `timed`; everyone: whether all clients accept all frames; load: 0 to 1."""

    kind: str
    clients: int
    everyone: bool
    load: float

    def accepts(self, number: int) -> list[int]:
        """Return the identifiers that a client accepts."""
        return [FIRST + each for each in range(self.clients) if self.everyone or each == number]

    @property
    def acceptors(self) -> int:
        """How many clients accept a frame."""
        return self.clients if self.everyone else 1

    def batch(self, sent: int) -> tuple[list[int], int]:
        """Return the identifiers of the batch behind `sent` frames, and the ns that it may take."""
        identifiers = [FIRST + (sent + each) % self.clients for each in range(A_BATCH)]
        bits = sum(frame_bits(identifier, DATA) + INTERMISSION_BITS for identifier in identifiers)
        return identifiers, round(bits * BIT_NS / self.load)


class Node:
    """A node that does nothing, whatever happens."""

    finished = False

    def __init__(self, name: str, wakes_on: frozenset[int] = frozenset()) -> None:
        self.name = name
        self.wakes_on = wakes_on
        self.stores = frozenset[int]()

    def on_start(self, _now_ns: int) -> Reaction:
        """Do nothing."""
        return SILENT

    def on_frame(self, _identifier: int, _data: bytes, _now_ns: int) -> Reaction:
        """Do nothing."""
        return SILENT

    def on_timer(self, _now_ns: int) -> Reaction:
        """Do nothing."""
        return SILENT

    def store(self, _identifier: int, _data: bytes, _at_ns: int) -> None:
        """Do nothing."""

    def report(self) -> dict[str, Any]:
        """Return nothing."""
        return {}


class Sender(Node):
    """Gives the bus its load: batches of frames, as far apart as the load says."""

    def __init__(self, case: Case) -> None:
        super().__init__("sender")
        self.case = case
        self.sent = 0

    def on_start(self, now_ns: int) -> Reaction:
        """Begin at the next instant."""
        return 0, now_ns + 1, []

    def on_timer(self, now_ns: int) -> Reaction:
        """Queue a batch."""
        identifiers, lasts_ns = self.case.batch(self.sent)
        self.sent += A_BATCH
        return 0, now_ns + lasts_ns, [(0, identifier, DATA) for identifier in identifiers]


def acceptors(case: Case) -> list[Node]:
    """Return the clients as nodes that are woken by what they accept."""
    return [Node(name_of(number), frozenset(case.accepts(number))) for number in range(case.clients)]


def name_of(number: int) -> str:
    """Return the name of a client."""
    return f"client{number}"


# -- clients at sockets, all in one process --


def join_all(case: Case, channel: str) -> list[Connection]:
    """Join a channel with all clients of a case."""
    return [_join(case, number, channel) for number in range(case.clients)]


def _join(case: Case, number: int, channel: str) -> Connection:
    name, accepted = name_of(number), case.accepts(number)
    if case.kind == "timed":
        return client.join(channel, name, True, None, accepted)[0]
    filters = [{"can_id": each, "can_mask": STANDARD_MASK, "extended": False} for each in accepted]
    return client.join(channel, name, False, filters=filters)[0]


def serve_all(connections: list[Connection]) -> None:
    """Yield at every grant, throw away what observers are shown, until the bus has hung up on all."""
    selector = selectors.DefaultSelector()
    for connection in connections:
        selector.register(connection, selectors.EVENT_READ, connection)
    while selector.get_map():
        for key, _ in selector.select():
            try:
                _answer(key.data)
            except protocol.Closed:
                selector.unregister(key.data)


def _answer(connection: Connection) -> None:
    connection.fill()
    while (message := connection.next_message()) is not None:
        if message[0] in (protocol.START, protocol.GRANT):
            connection.send(protocol.YIELD, protocol.encode_yield(SILENT))


def main() -> None:
    """Play all clients of a case: `python -m hil.bench.clients KIND CLIENTS EVERYONE LOAD CHANNEL`."""
    kind, clients, everyone, load, channel = sys.argv[1:]
    serve_all(join_all(Case(kind, int(clients), bool(int(everyone)), float(load)), channel))


if __name__ == "__main__":
    main()
