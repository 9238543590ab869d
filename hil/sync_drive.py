"""Driving a node by the Sync frame, on a bus that shares no time: one Sync is one period, nothing else is a clock.

Each drive hears frames and says which ones to send, no more: who owns the socket is elsewhere (hil/can_node.py). Time
is that of the cycle, kT from Sync k to the next, as under `functional`, so the payloads are those of `functional`, too;
what a reaction says of delays and computing does not matter. The DSP says Sync k+1 when it has all Encoders and
Currents k; whoever is slow, or stopped in a debugger, holds the robot still.

Sockets of one bus need not hear its frames in one order: a kernel hands a frame to one socket after the other, and an
answer to it may reach the last of them first (seen on vcan0 with two CPUs). So a node that needs a frame waits for it:
the plant at Sync k+1 for all Currents k and AccelRef k, a joint at Encoder k for AccelRef k-1, the DSP for all.
"""

from collections.abc import Iterable

from dbc.codec import Codec
from hil.exact_constants import reference_of
from hil.node import Node, Reaction
from hil.scenario import Scenario

Frame = tuple[int, bytes]
"""(identifier, data)"""


class SyncDrive:
    """A node that only answers, a joint for one. `finished`: its part is over."""

    def __init__(self, node: Node, scenario: Scenario, codec: Codec) -> None:
        self.node = node
        self.period_ns = scenario.period_ns
        self.setup_cycles = scenario.clock.setup_cycles
        self.cycle = -self.setup_cycles - 1
        self.sync, self.stop = codec["Sync"], codec["Stop"]
        self.codecs = codec.by_identifier
        self.latest: dict[int, int | None] = {}
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
    def begun(self) -> bool:
        """Whether the set-up has begun."""
        return self.cycle >= -self.setup_cycles

    def is_of_another_run(self, identifier: int) -> bool:
        """Return whether a frame is the Stop of another run: before the set-up it can be no other."""
        return identifier == self.stop.identifier and not self.begun

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
        self._keep(identifier, data)
        return []

    def _keep(self, identifier: int, data: bytes) -> None:
        """Hand over a frame that the node stores, and know of which cycle it is."""
        self.latest[identifier] = self._cycle_of(identifier, data)
        if identifier in self.node.stores:
            self.node.store(identifier, data, self._instant())

    def _instant(self) -> int:
        """Return when the frame came that is heard now, in emulated time."""
        return self.now_ns

    def _cycle_of(self, identifier: int, data: bytes) -> int | None:
        """Return the lowest byte of the cycle that a frame belongs to, its last value; None for a damaged one."""
        fields = self.codecs[identifier].unpack(data)
        return None if fields is None else fields[-1]

    def _has(self, identifiers: Iterable[int], cycle: int) -> bool:
        """Return whether the latest of each of these frames is that of a cycle."""
        return all(self.latest.get(each) == cycle & 0xFF for each in identifiers)

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
        """Return by how many cycles a Sync goes on; 0 for one that comes again, or too late."""
        fields = self.sync.unpack(data)
        return 0 if fields is None else max(0, self._nearest(fields[0]) - self.cycle)

    def _nearest(self, byte: int) -> int:
        """Return the cycle next to the present one whose number ends in this byte."""
        return self.cycle + ((byte - self.cycle + 0x80) & 0xFF) - 0x80

    def _frames(self, reaction: Reaction) -> list[Frame]:
        _, self.timer_ns, sends = reaction
        return [(identifier, data) for _, identifier, data in sends]


class JointDrive(SyncDrive):
    """A joint: Encoder k waits for AccelRef k-1, once there are any, and hears of no later one.

    Encoder says which cycle it is, like Sync, which may come behind it.
    """

    def __init__(self, node: Node, scenario: Scenario, codec: Codec) -> None:
        super().__init__(node, scenario, codec)
        number = int(node.name.removeprefix("joint"))
        self.encoder = codec[f"Encoder_{number}"].identifier
        self.reference = codec[reference_of(number)[0]].identifier
        self.listens |= {self.encoder, self.reference}
        self._waiting: bytes | None = None
        self._references: dict[int | None, bytes] = {}

    def hear(self, identifier: int, data: bytes) -> list[Frame]:
        """Take a frame."""
        if identifier == self.encoder:
            self._waiting = data
        elif identifier == self.reference:
            self._references[self._cycle_of(identifier, data)] = data
        else:
            return super().hear(identifier, data)
        return [] if self._waiting is None else self._take_encoder(self._waiting)

    def _take_encoder(self, data: bytes) -> list[Frame]:
        byte = self._cycle_of(self.encoder, data)
        cycle = self.cycle if byte is None else self._nearest(byte)
        reference = self._references.pop((cycle - 1) & 0xFF, None)
        if reference is None and self._waits(cycle) and (self.encoder, data) != self._question:
            return []
        if reference is not None and self.reference in self.node.stores:
            self.node.store(self.reference, reference, self.now_ns)
        self._waiting, self.cycle = None, cycle  # Encoder's, though Sync of a later one may have come before it
        return self._answer(self.encoder, data)

    def _waits(self, cycle: int) -> bool:
        """Return whether Encoder of this cycle waits for the reference of the one before."""
        return cycle >= 0


class PlantDrive(SyncDrive):
    """The plant: Sync k+1 carries the arm through period k, and has Encoder k+1 sent."""

    def __init__(self, node: Node, scenario: Scenario, codec: Codec) -> None:
        super().__init__(node, scenario, codec)
        self.currents = [codec[f"Current_{n}"].identifier for n in range(1, scenario.joints + 1)]
        self.reference = codec["AccelRef"].identifier
        self._waiting: Frame | None = None
        self._last: list[Frame] = []

    def hear(self, identifier: int, data: bytes) -> list[Frame]:
        """Take a frame; a Stop at the end of the run stands for the Sync of its cycle."""
        if identifier == self.sync.identifier:
            if not self._ahead(data):
                return self._last if self.now_ns < 0 else []
            self._waiting = identifier, data
        elif identifier == self.stop.identifier:
            self._waiting = identifier, data
            if self.stop.unpack(data) != (0,):
                return self._end(data)
        else:
            self._keep(identifier, data)
        return self._go_on() if self._waiting is not None and self._complete else []

    @property
    def _complete(self) -> bool:
        """Whether all of this cycle is there; before the first Sync nothing is."""
        needs = [*self.currents, self.reference] if self.cycle >= -1 else self.currents
        return not self.begun or self._has(needs, self.cycle)

    def _go_on(self) -> list[Frame]:
        assert self._waiting is not None
        (identifier, data), self._waiting = self._waiting, None
        self._last = self._advance(identifier, data)
        return self._end(data) if identifier == self.stop.identifier else self._last

    def _advance(self, _identifier: int, _data: bytes) -> list[Frame]:
        """Carry the arm to the beginning of the next cycle."""
        self.cycle += 1
        return self._frames(self.node.on_timer(self.now_ns))

    def _end(self, data: bytes) -> list[Frame]:
        self.node.store(self.stop.identifier, data, self._instant())
        self.stopped = True
        return []


class DSPDrive(SyncDrive):
    """The DSP, which says when a period is over: it has answered, and holds the Current of every joint."""

    def __init__(self, node: Node, scenario: Scenario, codec: Codec) -> None:
        super().__init__(node, scenario, codec)
        joints = range(1, scenario.joints + 1)
        self.currents = [codec[f"Current_{n}"].identifier for n in joints]
        self.encoders = [codec[f"Encoder_{n}"].identifier for n in joints]
        self.listens |= {*self.currents}
        self._positions: dict[int, bytes] = {}
        self._later: list[Frame] = []
        self._answered = False
        self._last: list[Frame] = []

    def start(self) -> list[Frame]:
        """Say the first Sync."""
        super().start()
        return self._next_cycle()

    def hear(self, identifier: int, data: bytes) -> list[Frame]:
        """Take a frame; what is no Encoder counts from the end of the cycle on, when all of it is there."""
        frames: list[Frame] = []
        if identifier == self.stop.identifier:
            return super().hear(identifier, data)
        if identifier in self.encoders:
            self._positions[identifier] = data
            self.latest[identifier] = self._cycle_of(identifier, data)
            if not self._answered and self._has(self._awaited(), self.cycle):
                frames = self._answer_encoders()
        elif identifier in self.currents:
            self.latest[identifier] = self._cycle_of(identifier, data)
        else:
            self._later.append((identifier, data))
        return frames + self._next_cycle() if self._over() else frames

    def _over(self) -> bool:
        """Return whether the cycle is over."""
        return self._answered and not self.node.finished and self._has(self.currents, self.cycle)

    def _awaited(self) -> list[int]:
        """Return the Encoders that it needs before it answers."""
        return self.encoders

    def idle(self) -> list[Frame]:
        """Say Sync again, before the run."""
        return self._last if self.now_ns < -self.period_ns else []

    def _answer_encoders(self) -> list[Frame]:
        self._answered = True
        *others, last = self.encoders
        for each in others:
            if each in self._positions:
                self.node.store(each, self._positions[each], self.now_ns)
        return self._frames(self.node.on_frame(last, self._positions[last], self.now_ns))

    def _next_cycle(self) -> list[Frame]:
        for identifier, data in sorted(self._later):
            if identifier in self.node.stores:
                self.node.store(identifier, data, self.now_ns)
        self._later, self._answered = [], False
        self.cycle += 1
        self._last = self._frames(self.node.on_timer(self.now_ns))
        return self._last


DRIVES = {"plant": PlantDrive, "dsp": DSPDrive}


def make_drive(node: Node, scenario: Scenario, codec: Codec) -> SyncDrive:
    """Return the drive of a node by its part."""
    return DRIVES.get(node.name, JointDrive)(node, scenario, codec)
