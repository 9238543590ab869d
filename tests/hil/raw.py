"""Clients that say whatever they like to a bus, and what a bus that is attacked must still do."""

import os
import select
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hil.errors import ChannelError
from hil.wire import channel as channels
from hil.wire import client, protocol
from hil.wire.port import Arrival
from hil.wire.protocol import Closed, Connection

GUARD_S = 20.0
"""For what must happen at all; it says nothing about speed."""

YIELD_NOTHING = protocol.encode_yield((0, None, []))


def wait_for(condition: Callable[[], Any], what: str = "it") -> Any:
    """Return the condition's first true value."""
    deadline = time.monotonic() + GUARD_S
    while time.monotonic() < deadline:
        if value := condition():
            return value
        time.sleep(0.005)
    raise AssertionError(f"{what} never happened")


class Raw:
    """One connection to a bus, of no particular manners."""

    def __init__(self, channel: str = "arm") -> None:
        self.connection = Connection(channels.connect(channel))
        self.stream: socket.socket = self.connection.stream
        self.stream.settimeout(GUARD_S)
        self.name = ""

    @classmethod
    def joined(cls, name: str, role: str = "observer", channel: str = "arm", **options: Any) -> "Raw":
        """Return one that has been let in."""
        raw = cls(channel)
        raw.hello(name, role, **options)
        kind, body = raw.receive()
        assert kind == protocol.WELCOME, body
        return raw

    def hello(self, name: str, role: str = "observer", **options: Any) -> None:
        """Introduce itself."""
        self.name = name
        self.say(protocol.HELLO, protocol.encode_json({"name": name, "role": role} | options))

    def say(self, kind: int, body: bytes = b"") -> None:
        """Send one message."""
        self.stream.sendall(protocol.message(kind, body))

    def send(self, *frames: tuple[int, bytes]) -> None:
        """Send frames as an observer does."""
        self.say(protocol.SEND, protocol.encode_frames([(0, identifier, data) for identifier, data in frames]))

    def configure(self, **change: Any) -> None:
        """Change something of its controller."""
        self.say(protocol.CONFIGURE, protocol.encode_json(change))

    def yields(self, timer_ns: int | None = None, *sends: Arrival, busy_ns: int = 0) -> None:
        """End its turn."""
        self.say(protocol.YIELD, protocol.encode_yield((busy_ns, timer_ns, list(sends))))

    def receive(self) -> tuple[int, bytes]:
        """Return the next message."""
        return self.connection.receive()

    def reason(self) -> str:
        """Return why it was refused; whatever else comes first is passed over."""
        while True:
            kind, body = self.receive()
            if kind in (protocol.REFUSED, protocol.END):
                return body.decode()

    def frame(self) -> Arrival:
        """Return the next frame."""
        while True:
            kind, body = self.receive()
            assert kind == protocol.FRAMES, (kind, body)
            (arrival,) = protocol.decode_frames(body)
            return arrival

    def readable(self) -> bool:
        """Return whether something waits to be read."""
        return bool(select.select([self.stream], [], [], 0)[0])

    def drain(self) -> bytes:
        """Read what is there without waiting; Closed if nobody is there."""
        data = b""
        while self.readable():
            try:
                part = self.stream.recv(1 << 16)
            except OSError as error:
                raise Closed from error
            if not part:
                raise Closed
            data += part
        return data

    def close(self) -> None:
        """Hang up."""
        self.stream.close()


def status(channel: str = "arm") -> dict[str, Any]:
    """Return how a bus stands; asked again where it is between two sessions."""
    while True:
        try:
            return client.control(channel, command="status")
        except ChannelError as error:
            if "closed the connection" not in str(error):
                raise


def descriptors(pid: int) -> int:
    """Return how many files and sockets a process has open."""
    return len(os.listdir(f"/proc/{pid}/fd"))


def resident_mib(pid: int) -> float:
    """Return the memory that a process really has."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    raise AssertionError(f"process {pid} has no VmRSS")
