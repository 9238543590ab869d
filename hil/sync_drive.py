"""Driving a node by the Sync frame, on a bus that shares no time: one Sync is one period, nothing else is a clock.

Each drive hears frames and says which ones to send, no more: who owns the socket is elsewhere (hil/can_node.py). Time
is that of the cycle, kT from Sync k to the next, as under `functional`, so the payloads are those of `functional`, too;
what a reaction says of delays and computing does not matter. Order alone counts, and the bus keeps it: AccelRef k-1
goes before Sync k, Encoder k behind it, the answers behind that; the DSP says Sync k+1 when it has all Currents k.
Whoever is slow, or stopped in a debugger, holds the robot still.
"""

from dbc.codec import Codec
from hil.node import Node, Reaction
from hil.scenario import Scenario

Frame = tuple[int, bytes]
"""(identifier, data)"""


class SyncDrive:
    """A node that only answers, a joint for one. `finished`: its part is over."""

    def __init__(self, node: Node, scenario: Scenario, codec: Codec) -> None:
        self.node = node
        self.period_ns = scenario.period_ns
        self.cycle = -scenario.clock.setup_cycles - 1
        self.sync, self.stop = codec["Sync"], codec["Stop"]
        self.listens = {*node.wakes_on, *node.stores, self.sync.identifier, self.stop.identifier}
        self.timer_ns: int | None = None
        self.stopped = False
        self._question: Frame | None = None
        self._answered_with: list[Frame] = []

    @property
    def now_ns(self) -> int:
        """The beginning of the cycle."""
        return self.cycle * self.period_ns

    @property
    def finished(self) -> bool:
        """Whether there is nothing left to hear."""
        return self.stopped or self.node.finished

    def start(self) -> list[Frame]:
        """Begin; return what the node says first."""
        return self._frames(self.node.on_start((self.cycle + 1) * self.period_ns))

    def hear(self, identifier: int, data: bytes) -> list[Frame]:
        """Take a frame of the bus; return those to send."""
        if identifier == self.sync.identifier:
            return self._begin(data)
        if identifier in self.node.wakes_on:
            return self._answer(identifier, data)
        if identifier in self.node.stores:
            self.node.store(identifier, data, self.now_ns)
        return []

    def _answer(self, identifier: int, data: bytes) -> list[Frame]:
        """Wake the node; a frame that comes again gets the same answer, and does not count twice."""
        question = identifier, data
        if question != self._question:
            self._question = question
            self._answered_with = self._frames(self.node.on_frame(identifier, data, self.now_ns))
        return self._answered_with

    def idle(self) -> list[Frame]:
        """Return what to say again while nothing moves, for somebody who was not there when it was said."""
        return []

    def _begin(self, data: bytes) -> list[Frame]:
        """Let a cycle begin; a Sync that comes again begins nothing."""
        ahead = self._ahead(data)
        self.cycle += ahead
        if not ahead or self.timer_ns is None or self.timer_ns > self.now_ns:
            return []
        return self._frames(self.node.on_timer(self.now_ns))

    def _ahead(self, data: bytes) -> int:
        """Return by how many cycles a Sync goes on; it carries the lowest byte of its number."""
        fields = self.sync.unpack(data)
        return 0 if fields is None else (fields[0] - self.cycle) & 0xFF

    def _frames(self, reaction: Reaction) -> list[Frame]:
        _, self.timer_ns, sends = reaction
        return [(identifier, data) for _, identifier, data in sends]


class PlantDrive(SyncDrive):
    """The plant: Sync k+1 carries the arm through period k, and has Encoder k+1 sent."""

    def __init__(self, node: Node, scenario: Scenario, codec: Codec) -> None:
        super().__init__(node, scenario, codec)
        self._last: list[Frame] = []

    def hear(self, identifier: int, data: bytes) -> list[Frame]:
        """Take a frame; a Stop at the end of the run stands for the Sync of its cycle."""
        if identifier != self.stop.identifier:
            return super().hear(identifier, data)
        if self.stop.unpack(data) == (0,):
            self.cycle += 1
            self.node.on_timer(self.now_ns)
        self.node.store(identifier, data, self.now_ns)
        self.stopped = True
        return []

    def _begin(self, data: bytes) -> list[Frame]:
        ahead = self._ahead(data)
        self.cycle += ahead
        if ahead:
            self._last = self._frames(self.node.on_timer(self.now_ns))
        return self._last if ahead or self.now_ns < 0 else []


class DSPDrive(SyncDrive):
    """The DSP, which says when a period is over: it has answered, and holds the Current of every joint."""

    def __init__(self, node: Node, scenario: Scenario, codec: Codec) -> None:
        super().__init__(node, scenario, codec)
        joints = range(1, scenario.joints + 1)
        self.currents = {codec[f"Current_{n}"].identifier: codec[f"Current_{n}"] for n in joints}
        self.encoders = {codec[f"Encoder_{n}"].identifier: codec[f"Encoder_{n}"] for n in joints}
        self.listens |= self.currents.keys()
        self._held: set[int] = set()
        self._later: list[Frame] = []
        self._answered = False
        self._last: list[Frame] = []

    def start(self) -> list[Frame]:
        """Say the first Sync."""
        super().start()
        return self._next_cycle()

    def hear(self, identifier: int, data: bytes) -> list[Frame]:
        """Take a frame; what is no Encoder counts from the end of the cycle on, when all of it is there."""
        if identifier in self.encoders:
            fields = self.encoders[identifier].unpack(data)
            old = fields is not None and fields[-1] != self.cycle & 0xFF  # said again to somebody who came late
            return [] if self._answered or old else self._take_encoder(identifier, data)
        if identifier == self.stop.identifier:
            return super().hear(identifier, data)
        if identifier not in self.currents:
            self._later.append((identifier, data))
            return []
        fields = self.currents[identifier].unpack(data)
        if fields is not None and fields[-1] == self.cycle & 0xFF:
            self._held.add(identifier)
        return self._next_cycle() if self._complete else []

    def idle(self) -> list[Frame]:
        """Say Sync again, before the run."""
        return self._last if self.now_ns < -self.period_ns else []

    def _take_encoder(self, identifier: int, data: bytes) -> list[Frame]:
        if identifier not in self.node.wakes_on:
            self.node.store(identifier, data, self.now_ns)
            return []
        self._answered = True
        frames = self._frames(self.node.on_frame(identifier, data, self.now_ns))
        return frames + (self._next_cycle() if self._complete else [])

    @property
    def _complete(self) -> bool:
        return self._answered and len(self._held) == len(self.currents) and not self.node.finished

    def _next_cycle(self) -> list[Frame]:
        for identifier, data in sorted(self._later):
            if identifier in self.node.stores:
                self.node.store(identifier, data, self.now_ns)
        self._later, self._answered = [], False
        self._held.clear()
        self.cycle += 1
        self._last = self._frames(self.node.on_timer(self.now_ns))
        return self._last


DRIVES = {"plant": PlantDrive, "dsp": DSPDrive}


def make_drive(node: Node, scenario: Scenario, codec: Codec) -> SyncDrive:
    """Return the drive of a node by its part."""
    return DRIVES.get(node.name, SyncDrive)(node, scenario, codec)
