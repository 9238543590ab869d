"""Trivial nodes with the traffic of the paper's rig, for `make bench`: what is left is what the wire costs.

A cycle is eight frames in four phases, each of which waits for the one before: Sync; three Encoders; three Currents,
each in answer to its Encoder; AccelRef in answer to the last Current. So the same nodes keep step on a bus that knows
no time. A sixth node only listens. On `hil` that is seven wake-ups a cycle: the DSP's timer, and one an answer.
"""

import sys
from typing import Any

from hil.drive import over
from hil.node import SILENT, Reaction
from hil.wire import client

PERIOD_NS = 1_000_000
SYNC, ACCELREF = 0x080, 0x130
ENCODERS = (0x101, 0x102, 0x103)
CURRENTS = (0x121, 0x122, 0x123)
LENGTHS = {SYNC: 1, ACCELREF: 8} | dict.fromkeys(ENCODERS, 4) | dict.fromkeys(CURRENTS, 6)
"""Bytes of data, as in dbc/arm.dbc."""
FRAMES_A_CYCLE = len(LENGTHS)

ANSWERS: dict[str, dict[int, tuple[int, ...]]] = {
    "plant": {SYNC: ENCODERS},
    "dsp": {CURRENTS[-1]: (ACCELREF,)},
    **{f"joint{n}": {ENCODERS[n - 1]: (CURRENTS[n - 1],)} for n in (1, 2, 3)},
    "listener": {ACCELREF: ()},
}
"""By node, in node order, and by the identifier that wakes it: the frames with which it answers.

The DSP sends Sync too, at the beginning of each cycle.
"""
STORES: dict[str, tuple[int, ...]] = {"plant": CURRENTS, "dsp": CURRENTS[:-1], "listener": ()}
STORED_BY_JOINTS = (ACCELREF,)

Frame = tuple[int, bytes]


class Trivial:
    """A node that answers as its table says, with a count as data."""

    finished = False

    def __init__(self, name: str) -> None:
        self.name = name
        self.answers = ANSWERS[name]
        self.wakes_on = frozenset(self.answers)
        self.stores = frozenset(STORES.get(name, STORED_BY_JOINTS))
        self.count = 0

    def answer(self, identifier: int) -> list[tuple[int, int, bytes]]:
        """Return the frames with which it answers a frame."""
        self.count += 1
        return [(0, sent, payload(sent, self.count)) for sent in self.answers[identifier]]

    def on_start(self, now_ns: int) -> Reaction:
        """Let the DSP begin a cycle."""
        return (0, now_ns + PERIOD_NS, []) if self.name == "dsp" else SILENT

    def on_frame(self, identifier: int, _data: bytes, now_ns: int) -> Reaction:
        """Answer; the DSP keeps its timer on the next cycle."""
        timer_ns = now_ns - now_ns % PERIOD_NS + PERIOD_NS if self.name == "dsp" else None
        return 0, timer_ns, self.answer(identifier)

    def on_timer(self, now_ns: int) -> Reaction:
        """Send Sync."""
        return 0, now_ns + PERIOD_NS, [(0, SYNC, payload(SYNC, self.count))]

    def store(self, _identifier: int, _data: bytes, _at_ns: int) -> None:
        """Take no notice."""

    def report(self) -> dict[str, Any]:
        """Return how often it answered."""
        return {"count": self.count}


class Timeless:
    """The same node on a bus that knows no time, no order and no filters: it is handed every frame.

    The DSP counts the Currents, begins a cycle when it hears its own AccelRef, and has finished after `cycles`.
    """

    def __init__(self, name: str, cycles: int) -> None:
        self.name = name
        self.finished = False
        self._node = Trivial(name)
        self._left = cycles
        self._currents = 0

    def begin(self) -> list[Frame]:
        """Return what it sends before it has heard anything."""
        return [(SYNC, payload(SYNC, self._node.count))] if self.name == "dsp" else []

    def hear(self, identifier: int) -> list[Frame]:
        """Return the frames with which it answers a frame."""
        if self.name == "dsp":
            return self._hear_as_dsp(identifier)
        return self._answer(identifier) if identifier in self._node.answers else []

    def _hear_as_dsp(self, identifier: int) -> list[Frame]:
        if identifier == ACCELREF:
            self._left -= 1
            self.finished = self._left == 0
            return [] if self.finished else self.begin()
        self._currents += identifier in CURRENTS
        if self._currents < len(CURRENTS):
            return []
        self._currents = 0
        return self._answer(CURRENTS[-1])

    def _answer(self, identifier: int) -> list[Frame]:
        return [(sent, data) for _, sent, data in self._node.answer(identifier)]


def payload(identifier: int, count: int) -> bytes:
    """Return data of a frame's length that changes from one cycle to the next."""
    length = LENGTHS[identifier]
    return (count * 0x9E3779B97F4A7C15 & (1 << 8 * length) - 1).to_bytes(length, "little")


def main() -> None:
    """Play one node as a process of its own: `python -m hil.bench.nodes NAME CHANNEL`."""
    name, channel = sys.argv[1:]
    node = Trivial(name)
    connection, _ = client.join(channel, name, True, 0, node.wakes_on, node.stores)
    over(connection, node)


if __name__ == "__main__":
    main()
