"""The clients of a channel as the bus keeps them: those that time waits for, and observers."""

import socket
import struct
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from hil.errors import NodeError
from hil.node import SILENT, Reaction
from hil.wire import protocol
from hil.wire.kernel import Arrival, Port
from hil.wire.protocol import Closed, Connection, ProtocolError

WAIT_S = 0.25
"""Wall time after which a waiting bus says so, and looks whether it should go on."""
OBSERVER_BYTES = 64 << 20
"""What is kept for an observer that reads too slowly; more is lost, and counted."""
FRAMES_A_CHUNK = 4096
FAR_NS = 1 << 62

OnWait = Callable[[str, float], None]
"""Called with (name of the timed client, wall seconds waited)."""


class _Everything(frozenset[int]):
    """The identifiers of a client that is woken by every frame."""

    def __contains__(self, _: object) -> bool:
        return True


class TimedClient:
    """A timed client as the kernel's participant."""

    def __init__(self, hello: dict[str, Any], connection: Connection, on_wait: OnWait) -> None:
        self.name: str = hello["name"]
        self.start_ns: int | None = hello["start_ns"]
        self.wakes_on = _Everything() if hello["wakes_on"] is None else frozenset(hello["wakes_on"])
        self.stores = frozenset(hello["stores"])
        self.connection = connection
        self.left = False
        self._on_wait = on_wait
        seconds, rest = divmod(WAIT_S, 1.0)
        limit = struct.pack("@ll", int(seconds), int(rest * 1e6))
        connection.stream.setblocking(True)
        # Not settimeout: that polls before every receive, one more system call a wake-up.
        connection.stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, limit)

    def start(self, now_ns: int) -> Reaction:
        """Start the client's time."""
        return self._exchange(protocol.START, protocol.encode_time(now_ns))

    def wake(self, now_ns: int, stored: list[Arrival], cause: Arrival | None) -> Reaction:
        """Grant an instant."""
        return self._exchange(protocol.GRANT, protocol.encode_grant(now_ns, stored, cause))

    def _exchange(self, kind: int, body: bytes) -> Reaction:
        if self.left:
            return SILENT
        try:
            with suppress(Closed):  # it may have left already, with its last words in the stream
                self.connection.send(kind, body)
            kind, body = self._receive()
            reaction = protocol.decode_yield(body)
        except Closed:
            raise NodeError(f"{self.name} is gone: its connection to the bus broke") from None
        except ProtocolError as error:
            raise NodeError(f"{self.name} does not keep to the protocol: {error}") from None
        if kind == protocol.LEAVE:
            self.left = True
            return reaction[0], None, reaction[2]
        if kind != protocol.YIELD:
            raise NodeError(f"{self.name} does not keep to the protocol: message {kind} where a yield was due")
        return reaction

    def _receive(self) -> tuple[int, bytes]:
        since = None
        while True:
            try:
                return self.connection.receive()
            except BlockingIOError:
                since = time.monotonic() - WAIT_S if since is None else since
                self._on_wait(self.name, time.monotonic() - since)


class Bystander:
    """An observer's participant: it sends, and is handed nothing by the kernel."""

    wakes_on: frozenset[int] = frozenset()
    stores: frozenset[int] = frozenset()

    def __init__(self, name: str) -> None:
        self.name = name

    def start(self, _now_ns: int) -> Reaction:
        """Do nothing."""
        return SILENT

    def wake(self, _now_ns: int, _stored: list[Arrival], _cause: Arrival | None) -> Reaction:
        """Do nothing."""
        return SILENT


class Observer:
    """A client that is never waited for: frames are kept for it, up to a bound, and sent as its socket takes them."""

    def __init__(self, name: str, connection: Connection) -> None:
        self.name = name
        self.connection = connection
        self.port = Port(Bystander(name))
        self.frames: list[Arrival] = []
        self.early: list[Arrival] = []
        self.lost = 0
        self._chunks: deque[tuple[bytes, int]] = deque()
        self._bytes = 0

    @property
    def unsent(self) -> int:
        """Frames that it has not got yet."""
        return len(self.frames) + sum(count for _, count in self._chunks)

    def flush(self) -> None:
        """Hand over what the socket takes without waiting; raise Closed if nobody is there."""
        self._pack()
        with suppress(BlockingIOError):
            while self._chunks:
                chunk, count = self._chunks[0]
                sent = self._send(chunk)
                self._bytes -= sent
                if sent == len(chunk):
                    self._chunks.popleft()
                else:
                    self._chunks[0] = chunk[sent:], count

    def _pack(self) -> None:
        """Make chunks of the frames: each frame a message, so that the socket is readable while there are more."""
        for first in range(0, len(self.frames), FRAMES_A_CHUNK):
            frames = self.frames[first : first + FRAMES_A_CHUNK]
            if self._bytes > OBSERVER_BYTES:
                self.lost += len(frames)
                continue
            chunk = b"".join([protocol.message(protocol.FRAMES, protocol.encode_frames([frame])) for frame in frames])
            self._chunks.append((chunk, len(frames)))
            self._bytes += len(chunk)
        self.frames.clear()

    def _send(self, chunk: bytes) -> int:
        try:
            return self.connection.stream.send(chunk)
        except BlockingIOError:
            raise
        except OSError as error:
            raise Closed from error
