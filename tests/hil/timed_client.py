"""A timed client as a process, whose frames hang on all that it has heard, and when.

`python -m tests.hil.timed_client NAME IDENTIFIER PERIOD_US`: it sends by its timer, answers some of what it hears, and
leaves when it has sent `--rounds` times; then it comes again, `--sessions` times. `--die-at N`: its process is killed
in the middle of its N-th turn.
"""

import argparse
import os
import signal
import sys
import time
import zlib

from hil.errors import ChannelError
from hil.node import Reaction
from hil.wire import client, protocol
from hil.wire.identifier import EXTENDED
from hil.wire.port import Arrival

WAIT_S = 30.0
"""Wall time for which it asks again to be let in."""


class Talker:
    """What it does, wherever it runs: a node by `hil.node`'s agreement, without storing."""

    def __init__(self, name: str, identifier: int, period_ns: int, rounds: int) -> None:
        self.name = name
        self.identifier, self.period_ns, self.rounds = identifier, period_ns, rounds
        self.round = self.heard = 0

    @property
    def finished(self) -> bool:
        """Whether it has sent all its rounds."""
        return self.round == self.rounds

    def start(self, now_ns: int) -> Reaction:
        """Begin with the first period."""
        return 0, now_ns + self.period_ns, []

    def wake(self, now_ns: int, stored: list[Arrival], cause: Arrival | None) -> Reaction:
        """Send each period; now and then compute, and answer what was heard."""
        for end_ns, identifier, data in [*stored, *([cause] if cause else [])]:
            self.heard = zlib.crc32(b"%d %d %s" % (end_ns, identifier, data), self.heard)
        timer_ns = (now_ns // self.period_ns + 1) * self.period_ns
        if cause is None:
            self.round += 1
            sends = [(0, self.identifier, self.heard.to_bytes(4, "big") + bytes([self.round & 0xFF]))]
            return 0, timer_ns, sends * (1 + self.heard % 2)
        busy_ns = 1000 * (self.heard % 40)
        timer_ns = max(timer_ns, now_ns + busy_ns + 1)
        if self.heard % 3 or cause[1] & EXTENDED:
            return busy_ns, timer_ns, []
        return busy_ns, timer_ns, [(busy_ns, EXTENDED | self.identifier << 18, bytes(self.heard % 9))]


def play(name: str, talker: Talker, channel: str, die_at: int) -> None:
    """Take part in one session."""
    connection = join(name, channel)
    turns = 0
    while True:
        kind, body = connection.receive()
        if kind == protocol.END:
            print(f"{name}: the bus has ended: {body.decode()}", flush=True)
            sys.exit(1)
        turns += 1
        if turns == die_at:
            os.kill(os.getpid(), signal.SIGKILL)
        if kind == protocol.START:
            reaction = talker.start(protocol.decode_time(body))
        else:
            reaction = talker.wake(*protocol.decode_grant(body))
        connection.send(protocol.LEAVE if talker.finished else protocol.YIELD, protocol.encode_yield(reaction))
        if talker.finished:
            connection.close()
            return


def join(name: str, channel: str) -> protocol.Connection:
    """Join at the beginning of a session: of one that runs already, its time is not that of this client."""
    deadline = time.monotonic() + WAIT_S
    while True:
        try:
            return client.join(channel, name, True, start_ns=0)[0]
        except ChannelError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.005)


def main() -> None:
    """Be the process."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name")
    parser.add_argument("identifier", type=int)
    parser.add_argument("period_us", type=int)
    parser.add_argument("--channel", default="arm")
    parser.add_argument("--rounds", type=int, default=1 << 60)
    parser.add_argument("--sessions", type=int, default=1)
    parser.add_argument("--die-at", type=int, default=0)
    given = parser.parse_args()
    for _ in range(given.sessions):
        talker = Talker(given.name, given.identifier, given.period_us * 1000, given.rounds)
        play(given.name, talker, given.channel, given.die_at)


if __name__ == "__main__":
    main()
