"""Driving a node: one loop where it is called directly, one where the bus is another process.

Both hand a node its stored frames, then what wakes it, in the same order: so its frames cannot differ.
"""

from hil.errors import NodeError
from hil.node import Node, Reaction
from hil.wire import protocol, wakeup
from hil.wire.port import Arrival
from hil.wire.protocol import Connection

RUN_IS_OVER = "the run is over"
"""What a bus says at the end of a run; any other reason is an end in the middle."""


class Direct:
    """A node as the kernel's participant, called in the same process."""

    def __init__(self, node: Node) -> None:
        self.node = node
        self.name = node.name
        self.wakes_on = frozenset(node.wakes_on)
        self.stores = frozenset(node.stores)

    def start(self, now_ns: int) -> Reaction:
        """Start the node."""
        return self.node.on_start(now_ns)

    def wake(self, now_ns: int, stored: list[Arrival], cause: Arrival | None) -> Reaction:
        """Hand over what was stored, then the frame or the timer."""
        node = self.node
        for at_ns, identifier, data in stored:
            node.store(identifier, data, at_ns)
        if cause is None:
            return node.on_timer(now_ns)
        return node.on_frame(cause[1], cause[2], now_ns)


def over(connection: Connection, node: Node) -> None:
    """Drive a node whose bus is at the other end, until its part or the run is over.

    Raises NodeError if the bus ends for another reason, protocol.Closed if it goes away without a word.
    """
    direct = Direct(node)
    data = b""
    while True:
        granted = wakeup.decode_grant(data)
        if granted is not None:
            reaction = direct.wake(*granted)
        else:
            connection.give_back(data)
            unusual = _react(direct, *connection.receive())
            if unusual is None:
                return
            reaction = unusual
        if node.finished:
            connection.send(protocol.LEAVE, protocol.encode_yield(reaction))
            return
        data = connection.exchange(wakeup.encode_yield(reaction), _wait_on)


def _wait_on() -> None:
    """Wait for a bus that does not read yet."""


def _react(direct: Direct, kind: int, body: bytes) -> Reaction | None:
    """Return the reaction to any message of a bus, None if the run is over."""
    if kind == protocol.GRANT:
        return direct.wake(*protocol.decode_grant(body))
    if kind == protocol.START:
        return direct.start(protocol.decode_time(body))
    if kind != protocol.END:
        raise protocol.ProtocolError(f"message of kind {kind} where a grant was due")
    reason = body.decode(errors="replace")
    if reason == RUN_IS_OVER:
        return None
    raise NodeError(f"{direct.name}: the bus ended in the middle of the run: {reason}")
