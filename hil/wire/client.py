"""The client's end of a channel: it introduces itself, and is welcomed or refused."""

from collections.abc import Collection
from typing import Any

from hil.errors import ChannelError
from hil.wire import channel, protocol
from hil.wire.protocol import Connection


def join(
    name: str,
    client: str,
    timed: bool,
    start_ns: int | None = None,
    wakes_on: Collection[int] | None = None,
    stores: Collection[int] = (),
) -> tuple[Connection, dict[str, Any]]:
    """Join a channel as `client`; return the connection and the bus's welcome.

    timed: time waits for this client. start_ns: the instant at which its time begins (None: the bus's).
    wakes_on: identifiers that wake it (None: every frame). Raises ChannelError.
    """
    connection = Connection(channel.connect(name))
    hello = {
        "name": client,
        "timed": timed,
        "start_ns": start_ns,
        "wakes_on": None if wakes_on is None else sorted(wakes_on),
        "stores": sorted(stores),
    }
    try:
        connection.send(protocol.HELLO, protocol.encode_json(hello))
        kind, body = connection.receive_one()
    except protocol.Closed:
        connection.close()
        raise ChannelError(f"channel {name!r}: the bus closed the connection; is it ending?") from None
    if kind == protocol.WELCOME:
        return connection, protocol.decode_json(body)
    connection.close()
    reason = body.decode(errors="replace") if kind == protocol.REFUSED else f"unexpected answer {kind}"
    raise ChannelError(f"channel {name!r} refused {client}: {reason}")
