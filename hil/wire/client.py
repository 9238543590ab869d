"""The client's end of a channel: it introduces itself, and is welcomed or refused."""

import os
from collections.abc import Collection
from typing import Any

from hil.errors import ChannelError
from hil.wire import channel, protocol
from hil.wire.protocol import Connection
from hil.wire.status_page import StatusPage


def join(
    name: str,
    client: str,
    timed: bool,
    start_ns: int | None = None,
    wakes_on: Collection[int] | None = None,
    stores: Collection[int] = (),
    **options: Any,
) -> tuple[Connection, dict[str, Any]]:
    """Join a channel as `client`; return the connection and the bus's welcome.

    timed: time waits for this client. start_ns: the instant at which its time begins (None: the bus's).
    wakes_on: identifiers that wake it (None: what its filters let pass). options: what else hello.py describes. With
    page=True the welcome holds the status page under "page". Raises ChannelError.
    """
    hello = {
        "name": client,
        "role": "timed" if timed else "observer",
        "start_ns": start_ns,
        "wakes_on": None if wakes_on is None else sorted(wakes_on),
        "stores": sorted(stores),
    }
    connection = Connection(channel.connect(name))
    try:
        connection.send(protocol.HELLO, protocol.encode_json(hello | options))
        kind, body, descriptor = connection.receive_with_file()
    except protocol.Closed:
        connection.close()
        raise ChannelError(f"channel {name!r}: the bus closed the connection; is it ending?") from None
    if kind == protocol.WELCOME:
        return connection, protocol.decode_json(body) | {"page": _page(descriptor)}
    connection.close()
    reason = body.decode(errors="replace") if kind == protocol.REFUSED else f"unexpected answer {kind}"
    raise ChannelError(f"channel {name!r} refused {client}: {reason}")


def _page(descriptor: int | None) -> StatusPage | None:
    if descriptor is None:
        return None
    try:
        return StatusPage(descriptor)
    finally:
        os.close(descriptor)


def control(name: str, **command: Any) -> dict[str, Any]:
    """Give the clock of a channel a command (hello.py, Command); return how things stand. Raises ChannelError."""
    connection = Connection(channel.connect(name))
    try:
        connection.stream.settimeout(CONTROL_S)
        connection.send(protocol.HELLO, protocol.encode_json({"name": f"control-{os.getpid()}", "role": "control"}))
        connection.send(protocol.CONTROL, protocol.encode_json(command))
        kind, body = connection.receive()
    except protocol.Closed:
        raise ChannelError(f"channel {name!r}: the bus closed the connection; is its session ending?") from None
    except (BlockingIOError, TimeoutError):
        raise ChannelError(f"channel {name!r}: the bus does not answer within {CONTROL_S:.0f} s") from None
    finally:
        connection.close()
    if kind == protocol.REFUSED:
        raise ChannelError(f"channel {name!r}: {body.decode(errors='replace')}")
    return protocol.decode_json(body)


CONTROL_S = 5.0
"""Wall time to wait for the answer to a command."""
