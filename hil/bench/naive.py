"""The bus that most people write first, as a yardstick for `make bench`: every frame wakes every client.

It knows no time and no filters. The frame with the lowest identifier goes to every client, and every client answers
with what it sends then, be it nothing. All clients are woken before the first is waited for, which is the better way.
"""

import socket
import struct
import subprocess
import sys
import time
from collections.abc import Sequence
from heapq import heappop, heappush

from hil.addresses import fixed_addresses
from hil.bench.nodes import Frame, Timeless
from hil.processes import one_cpu

_RECORD = struct.Struct("<IB8s")
LONGEST = 256
"""Bytes of a message: more than an answer ever has."""


def encode(frames: Sequence[Frame]) -> bytes:
    """Return frames as bytes; their number in front, so that no message is empty."""
    return bytes([len(frames)]) + b"".join([_RECORD.pack(identifier, len(data), data) for identifier, data in frames])


def decode(message: bytes) -> list[Frame]:
    """Return the frames of a message."""
    return [(identifier, data[:length]) for identifier, length, data in _RECORD.iter_unpack(message[1:])]


class NaiveServer:
    """Clients as processes of their own, each at one end of a socket pair."""

    def __init__(self, names: Sequence[str], cycles: int) -> None:
        self.sockets: list[socket.socket] = []
        self.processes: list[subprocess.Popen[bytes]] = []
        with fixed_addresses():
            for name in names:
                self._start(name, cycles)

    def _start(self, name: str, cycles: int) -> None:
        ours, theirs = socket.socketpair()
        command = [sys.executable, "-m", "hil.bench.naive", name, str(cycles), str(theirs.fileno())]
        self.processes.append(subprocess.Popen(command, pass_fds=[theirs.fileno()]))
        self.sockets.append(ours)
        theirs.close()

    def run(self) -> tuple[float, list[int]]:
        """Carry the frames until nobody sends any more; return (wall s, identifiers in their order)."""
        pending = self._collect([])  # what they send first; so all of them are there
        order = []
        with one_cpu([0, *(process.pid for process in self.processes)]):
            began = time.perf_counter()
            while pending:
                frame = heappop(pending)
                order.append(frame[0])
                message = encode([frame])
                for each in self.sockets:
                    each.sendall(message)
                self._collect(pending)
            return time.perf_counter() - began, order

    def _collect(self, pending: list[Frame]) -> list[Frame]:
        for each in self.sockets:
            for frame in decode(each.recv(LONGEST)):
                heappush(pending, frame)
        return pending

    def end(self) -> None:
        """Hang up, and wait until all have gone."""
        for each in self.sockets:
            each.close()
        for process in self.processes:
            process.wait()


def run_naive(names: Sequence[str], cycles: int) -> tuple[float, list[int]]:
    """Return (wall s, identifiers in their order) of these nodes on a naive server."""
    server = NaiveServer(names, cycles)
    try:
        return server.run()
    finally:
        server.end()


def main() -> None:
    """Play one node: `python -m hil.bench.naive NAME CYCLES DESCRIPTOR`."""
    name, cycles, descriptor = sys.argv[1:]
    node = Timeless(name, int(cycles))
    bus = socket.socket(fileno=int(descriptor))
    bus.sendall(encode(node.begin()))
    while message := bus.recv(LONGEST):
        answers = [answer for identifier, _ in decode(message) for answer in node.hear(identifier)]
        bus.sendall(encode(answers))


if __name__ == "__main__":
    main()
