"""A fuzzer on the protocol of the bus: `python -m tests.hil.fuzzer --seconds 600 --seed 1` (make fuzz).

It attacks a real `hil bus` over its real socket, while two well-behaved clients send each other frames and must get on.
Prints, and returns, what was done and what it cost the bus: memory and descriptors.
"""

import argparse
import json
import os
import random
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import can

from hil.errors import ChannelError
from hil.wire import channel, client, protocol

PATIENCE_S = 20.0
"""Wall time within which a frame must cross the bus between the well-behaved clients."""
HELD = 30
"""Connections that are held open with half a message in them."""


class Attacker:
    """Somebody who means no good, by a seed."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.done: Counter[str] = Counter()
        self.held: list[socket.socket] = []
        self.attacks: list[Callable[[socket.socket], None]] = [
            self.noise,
            self.odd_hello,
            self.guest,
            self.guest,
            self.flood,
            self.half,
            self.controller,
            self.dead_timed,
        ]

    def strike(self) -> None:
        """Make one connection and misuse it."""
        attack = self.random.choice(self.attacks)
        self.done[attack.__name__] += 1
        try:
            stream = channel.connect("fuzz")
        except ChannelError:
            self.done["turned away"] += 1
            return
        stream.settimeout(0.2)
        with suppress(OSError):
            attack(stream)
        if stream not in self.held:
            stream.close()
        if attack == self.controller:  # a paused bus stands still by right
            client.control("fuzz", command="pace", pace=1.0)
            client.control("fuzz", command="continue")

    def release(self) -> None:
        for stream in self.held:
            stream.close()
        self.held.clear()

    # -- material --

    def number(self) -> int:
        return self.random.choice((0, 1, -1, 127, 255, 1 << 31, 1 << 32, 1 << 35, 1 << 62, 1 << 63, -(1 << 63), 10**30))

    def value(self, depth: int = 0) -> Any:
        kinds: list[Callable[[], Any]] = [
            self.number,
            lambda: None,
            lambda: True,
            lambda: self.random.random() * 1e9,
            lambda: "x" * self.random.choice((0, 1, 101, 5000)),
            lambda: [] if depth > 3 else [self.value(depth + 1) for _ in range(self.random.randrange(4))],
            lambda: {} if depth > 3 else {"can_id": self.value(depth + 1), "task": self.value(depth + 1)},
        ]
        return self.random.choice(kinds)()

    def hello(self, **changes: Any) -> bytes:
        name = f"fool-{self.random.randrange(1 << 40)}"
        role = self.random.choice(("observer", "observer", "timed", "control"))
        return self.message(protocol.HELLO, {"name": name, "role": role} | changes)

    def message(self, kind: int, body: Any) -> bytes:
        self.done["messages"] += 1
        return protocol.message(kind, json.dumps(body).encode())

    def frames(self, count: int) -> bytes:
        frames = []
        for _ in range(count):
            odd = (0x123, 0x80000123, 0x7FF, 1 << 32 | 5, 0x20000004, 0xFFFFFFFF, (1 << 64) - 1)
            identifier = self.random.choice(odd)
            frames.append((0, identifier, self.random.randbytes(self.random.choice((0, 3, 8, 8, 8, 9, 64)))))
        self.done["messages"] += 1
        self.done["frames"] += count
        return protocol.message(protocol.SEND, protocol.encode_frames(frames))

    def mutated(self, data: bytes) -> bytes:
        """Cut, lengthen, or change some bytes."""
        spoilt = bytearray(data)
        for _ in range(self.random.randrange(1, 6)):
            spoilt[self.random.randrange(len(spoilt))] = self.random.randrange(256)
        cut = self.random.randrange(len(spoilt) + 1) if self.random.random() < 0.3 else len(spoilt)
        return bytes(spoilt[:cut]) + self.random.randbytes(self.random.choice((0, 0, 0, 7)))

    # -- attacks --

    def noise(self, stream: socket.socket) -> None:
        stream.sendall(self.random.randbytes(self.random.choice((1, 4, 5, 100, 70_000))))

    def odd_hello(self, stream: socket.socket) -> None:
        keys = ("name", "role", "start_ns", "wakes_on", "stores", "filters", "fd", "bit_ns", "depth", "page", "more")
        odd = self.hello(**{self.random.choice(keys): self.value()})
        stream.sendall(self.mutated(odd) if self.random.random() < 0.5 else odd)
        stream.recv(4096)

    def guest(self, stream: socket.socket) -> None:
        """Come in politely as an observer, then say anything."""
        stream.sendall(self.hello(role="observer", page=self.random.random() < 0.5))
        stream.recv(4096)
        for _ in range(self.random.randrange(1, 12)):
            frame = {"identifier": self.number(), "data": "00" * self.random.randrange(10)}
            task = {"task": self.random.randrange(5), "frames": [frame], "period_ns": self.number()}
            good = {"task": self.random.randrange(400), "frames": [{"identifier": 5, "data": ""}], "period_ns": 10**6}
            filters = [{"can_id": 1, "can_mask": 2}] * self.random.choice((1, 100, 5000))
            messages = (
                self.message(protocol.CONFIGURE, {"periodic": task}),
                self.message(protocol.CONFIGURE, {"periodic": good}),
                self.message(protocol.CONFIGURE, {"set_filters": True, "filters": filters}),
                self.message(protocol.CONFIGURE, {"listen_only": self.value()}),
                self.message(protocol.CONFIGURE, self.value()),
                self.frames(self.random.choice((1, 20))),
                self.mutated(self.frames(3)),
                protocol.message(self.random.randrange(256), self.random.randbytes(20)),
            )
            stream.sendall(self.random.choice(messages))

    def flood(self, stream: socket.socket) -> None:
        """Send as much as the socket takes, and read nothing."""
        stream.sendall(self.hello(role="observer"))
        stream.recv(4096)
        frames = protocol.message(protocol.SEND, protocol.encode_frames([(0, 0x7FF, bytes(8))] * 50))
        for _ in range(100):
            self.done["messages"] += 1
            stream.sendall(frames)

    def half(self, stream: socket.socket) -> None:
        """Say half a message, and stay."""
        stream.sendall(self.hello()[: self.random.randrange(1, 20)])
        self.held.append(stream)
        if len(self.held) > HELD:
            self.held.pop(0).close()

    def controller(self, stream: socket.socket) -> None:
        stream.sendall(self.hello(role="control"))
        for _ in range(self.random.randrange(1, 20)):
            command = self.random.choice(("pause", "step", "status", "pace", "stop", ""))
            stream.sendall(self.message(protocol.CONTROL, {"command": command, "pace": self.value()}))

    def dead_timed(self, stream: socket.socket) -> None:
        """Join as a timed client, answer once or twice with nonsense or not, and die."""
        stream.sendall(self.hello(role="timed"))
        stream.recv(4096)
        for _ in range(self.random.randrange(3)):
            sends = [(self.random.choice((0, 5, -1, 1 << 40)), 0x100, bytes(8))] * self.random.choice((0, 1, 40))
            fields = struct.pack("<qqI", self.random.choice((0, 7, -5, 1 << 61)), self.limited(), len(sends))
            body = fields + b"".join(struct.pack("<qQB", delay, number, 8) + data for delay, number, data in sends)
            answer = protocol.message(self.random.choice((protocol.YIELD, protocol.YIELD, protocol.LEAVE)), body)
            self.done["messages"] += 1
            stream.sendall(self.mutated(answer) if self.random.random() < 0.3 else answer)
            stream.recv(4096)

    def limited(self) -> int:
        return self.random.choice((0, -1, 10**9, 1 << 61, 1 << 62, (1 << 63) - 1, -(1 << 63)))


def resources(pid: int) -> tuple[int, int]:
    """Return (resident memory in kB, open descriptors) of a process."""
    status = Path(f"/proc/{pid}/status").read_text()
    resident = next(line for line in status.splitlines() if line.startswith("VmRSS"))
    return int(resident.split()[1]), len(os.listdir(f"/proc/{pid}/fd"))


def exchange(first: can.BusABC, second: can.BusABC, number: int) -> None:
    """Send a frame one way; TimeoutError if it does not come."""
    deadline = time.monotonic() + PATIENCE_S
    data = number.to_bytes(8, "big")
    while time.monotonic() < deadline:
        with suppress(can.CanOperationError):  # ENOBUFS while the bus is flooded
            first.send(can.Message(arbitration_id=0x1, data=data, is_extended_id=False), timeout=1.0)
            break
    while time.monotonic() < deadline:
        heard = second.recv(0.5)
        if heard is not None and heard.data == data:
            return
    raise TimeoutError(f"frame {number} did not cross the bus within {PATIENCE_S:.0f} s")


def fuzz(seconds: float, seed: int) -> dict[str, Any]:
    """Attack a bus for so long; return what was done, and what it cost."""
    command = [sys.executable, "-m", "hil", "bus", "fuzz", "--pace", "1", "--go-on"]
    attacker = Attacker(seed)
    with tempfile.TemporaryFile() as said, subprocess.Popen(command, stdout=said, stderr=said) as bus:
        try:
            pair = [_join(name) for name in ("left", "right")]
            exchange(*pair, 0)
            before = resources(bus.pid)
            deadline, crossed = time.monotonic() + seconds, 0
            while time.monotonic() < deadline:
                for _ in range(20):
                    attacker.strike()
                crossed += 1
                exchange(*pair, crossed)
            attacker.release()
            for number in range(1, 30):  # the bus sees that they are gone
                exchange(*pair, crossed + number)
                time.sleep(0.05)
            after = resources(bus.pid)
            for each in pair:
                each.shutdown()
        finally:
            bus.send_signal(signal.SIGINT)
            bus.wait(20)
        said.seek(0)
        text = said.read().decode(errors="replace")
    return {
        "done": dict(attacker.done),
        "crossed": crossed,
        "memory_kB": (before[0], after[0]),
        "descriptors": (before[1], after[1]),
        "exit_code": bus.returncode,
        "said": text,
    }


def _join(name: str) -> can.BusABC:
    return can.Bus(interface="hil", channel="fuzz", name=name, wait_s=20, error_frames="none", can_filters=[
        {"can_id": 0x1, "can_mask": 0x7FF, "extended": False}
    ])  # fmt: skip


def main() -> int:
    """Fuzz from the command line; 1 if the bus did not stand it."""
    parser = argparse.ArgumentParser(description="Attack a bus of its own.")
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    found = fuzz(options.seconds, options.seed)
    text = found.pop("said")
    print(json.dumps(found, indent=2))
    if "Traceback" in text or found["exit_code"]:
        print(text[-5000:])
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
