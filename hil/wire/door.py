"""Who knocks at a channel: connections from the first byte to a valid HELLO, and those that control the clock.

It is looked after even while the bus waits for a timed client's answer, so that a halted bus still says what it waits
for. Strangers are few and short: a bounded number of connections, short first messages, a time limit.
"""

import selectors
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from hil.wire import protocol
from hil.wire.channel import Listener
from hil.wire.hello import Command, Hello, check
from hil.wire.protocol import Closed, Connection, ProtocolError

STRANGERS = 64
"""Connections that have not yet said who they are."""
CONTROLS = 64
"""Connections that control the clock."""
FIRST_MESSAGE_BYTES = 1 << 18
PATIENCE_S = 5.0
"""Wall time within which a connection must have introduced itself."""

Admit = Callable[[str, Hello, Connection], None]
"""Called with (channel, HELLO, connection) of somebody who wants in."""
Answer = Callable[[Command], dict[str, Any]]


class Door:
    """The way into the channels of a server. admit: takes a client; answer: carries out a command to the clock."""

    def __init__(self, listeners: Sequence[Listener], admit: Admit, answer: Answer) -> None:
        self._admit = admit
        self._answer = answer
        self._since: dict[Connection, float] = {}
        self._controls: set[Connection] = set()
        self._selector = selectors.DefaultSelector()
        for listener in listeners:
            self._selector.register(
                listener.socket, selectors.EVENT_READ, lambda listener=listener: self._accept(listener)
            )

    def fileno(self) -> int:
        """Return a descriptor that is readable when somebody is there."""
        descriptor: int = self._selector.fileno()
        return descriptor

    def attend(self) -> None:
        """Look after whoever is there."""
        deadline = time.monotonic() - PATIENCE_S
        for connection in [stranger for stranger, since in self._since.items() if since < deadline]:
            refuse(connection, f"no HELLO within {PATIENCE_S:.0f} s")
            self._forget(connection)
        for key, _ in self._selector.select(0):
            key.data()

    def close(self) -> None:
        """Send everybody away who is not in."""
        for connection in [*self._since, *self._controls]:
            connection.close()
        self._selector.close()

    def _accept(self, listener: Listener) -> None:
        try:
            stream, _ = listener.socket.accept()
        except OSError:
            return
        stream.setblocking(False)
        connection = Connection(stream, FIRST_MESSAGE_BYTES)
        if len(self._since) >= STRANGERS:
            refuse(connection, f"{STRANGERS} others wait at the door: try again")
            connection.close()
            return
        self._since[connection] = time.monotonic()
        self._selector.register(connection, selectors.EVENT_READ, lambda: self._greet(listener.channel, connection))

    def _greet(self, channel: str, connection: Connection) -> None:
        """Take the client's HELLO; a stranger that says anything else is shown out."""
        try:
            connection.fill()
            message = connection.next_message()
            if message is None:
                return
            kind, body = message
            if kind != protocol.HELLO:
                raise ProtocolError(f"message {kind} where HELLO was due")
            hello = check(Hello, body)
        except (Closed, BlockingIOError):
            self._forget(connection)
            return
        except ProtocolError as error:
            refuse(connection, str(error))
            self._forget(connection)
            return
        self._selector.unregister(connection)
        del self._since[connection]
        if hello.role == "control" and len(self._controls) >= CONTROLS:
            refuse(connection, f"{CONTROLS} others control the clock: try again")
            connection.close()
        elif hello.role == "control":
            self._controls.add(connection)
            self._selector.register(connection, selectors.EVENT_READ, lambda: self._read_command(connection))
            self._obey(connection)  # what came together with HELLO
        else:
            connection.longest = protocol.LONGEST_FROM_CLIENT
            self._admit(channel, hello, connection)

    def _read_command(self, connection: Connection) -> None:
        try:
            connection.fill()
        except BlockingIOError:
            return
        except Closed:
            self._forget(connection)
            return
        self._obey(connection)

    def _obey(self, connection: Connection) -> None:
        """Carry out what a controlling client wants, and say how things stand."""
        try:
            while (message := connection.next_message()) is not None:
                if message[0] != protocol.CONTROL:
                    raise ProtocolError(f"message {message[0]} where CONTROL was due")
                answer = self._answer(check(Command, message[1]))
                connection.send(protocol.STATUS, protocol.encode_json(answer))
        except ProtocolError as error:
            refuse(connection, str(error))
            self._forget(connection)
        except Closed:
            self._forget(connection)

    def _forget(self, connection: Connection) -> None:
        self._since.pop(connection, None)
        self._controls.discard(connection)
        self._selector.unregister(connection)
        connection.close()


def refuse(connection: Connection, reason: str) -> None:
    """Say no, and why."""
    with suppress(Closed):
        connection.send(protocol.REFUSED, reason.encode())
