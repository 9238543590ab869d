"""Faults on the wire, carried out: by script and by seed, the same every time."""

import random
from collections.abc import Callable, Sequence
from math import log

from hil.wire.agenda import ARBITRATE, FAULT
from hil.wire.bit_play import Flips
from hil.wire.duration import plan_of
from hil.wire.fault import Babble, BitError, BitErrorRate, CutOff, Fault, Interval, Overrun, QueueDelay, StuckDominant
from hil.wire.identifier import FD
from hil.wire.kernel import Kernel
from hil.wire.port import Port


class FaultScript:
    """The faults of one run."""

    def __init__(self, faults: Sequence[Fault], seed: int = 0) -> None:
        self.faults = tuple(faults)
        self._seen = [0] * len(self.faults)
        self._random = random.Random(seed)
        self._next_bit = [self._gap(fault) for fault in self.faults]
        self._kernel: Kernel

    def install(self, kernel: Kernel) -> None:
        """Let the faults act on a bus."""
        self._kernel = kernel
        if any(isinstance(fault, BitError | BitErrorRate) for fault in self.faults):
            kernel.medium.faults = self
            kernel.medium.assess()
        for fault in self.faults:
            if isinstance(fault, Interval):
                self._at(fault.from_s, self._begin, fault)
                if fault.to_s is not None:
                    self._at(fault.to_s, self._end, fault)

    def _at(self, t_s: float, action: Callable[[Fault], None], fault: Fault) -> None:
        self._kernel.agenda.at(round(t_s * 1e9), FAULT, -1, action, fault)

    # -- bits of frames --

    def flips(self, sender: str, identifier: int, data: bytes) -> Flips:  # noqa: ARG002 (whoever sends it)
        """Return the bits of this frame that are inverted, and for whom."""
        flips: Flips = {}
        length = 0
        for index, fault in enumerate(self.faults):
            if isinstance(fault, BitError | BitErrorRate):
                length = length or len(plan_of(identifier, data).levels)
                for bit in self._bits(index, fault, identifier, length):
                    flips[bit] = frozenset(fault.at) or None
        return flips

    def _bits(self, index: int, fault: BitError | BitErrorRate, identifier: int, length: int) -> list[int]:
        if isinstance(fault, BitErrorRate):
            return self._random_bits(index, fault, length)
        if fault.identifier != (identifier if fault.identifier >= FD else identifier & 0xFFFFFFFF):
            return []
        self._seen[index] += 1
        meant = self._seen[index] == fault.occurrence or (fault.every and self._seen[index] > fault.occurrence)
        bit = fault.bit + length if fault.bit < 0 else fault.bit
        return [bit] if meant and 0 <= bit < length else []

    def _random_bits(self, index: int, fault: BitErrorRate, length: int) -> list[int]:
        """Return the bits of this frame that the next errors hit; the gaps between errors are geometric."""
        bits = []
        while self._next_bit[index] < length:
            bits.append(self._next_bit[index])
            self._next_bit[index] += 1 + self._gap(fault)
        self._next_bit[index] -= length
        return bits

    def _gap(self, fault: Fault) -> int:
        """Return how many good bits come before the next error."""
        if not isinstance(fault, BitErrorRate):
            return 0
        return int(log(1.0 - self._random.random()) / log(1.0 - fault.rate))

    # -- nodes --

    def _port(self, name: str) -> Port | None:
        return next((port for port in self._kernel.ports if port.name == name), None)

    def _begin(self, fault: Fault) -> None:
        self._switch(fault, True)

    def _end(self, fault: Fault) -> None:
        self._switch(fault, False)

    def _switch(self, fault: Fault, on: bool) -> None:
        """Let a fault of a node begin or end; who is not there has none."""
        port = self._port(fault.node) if isinstance(fault, Interval) else None
        if port is None:
            return
        if isinstance(fault, Overrun):
            port.controller.overrun = on
        elif isinstance(fault, QueueDelay):
            port.controller.queue_delay_ns = round(fault.delay_us * 1e3) if on else 0
        elif isinstance(fault, CutOff):
            (self._kernel.cut_off if on else self._kernel.rejoin)(port)
        elif isinstance(fault, StuckDominant):
            # The bits that end now are past: it acts on those that begin.
            self._kernel.agenda.at(self._kernel.now_ns, ARBITRATE, -2, self._stick, (port, on))
        elif isinstance(fault, Babble):
            self._babble(fault, port, on)

    @staticmethod
    def _stick(switch: tuple[Port, bool]) -> None:
        port, on = switch
        port.medium.disturb()
        (port.medium.stuck.add if on else port.medium.stuck.discard)(port)
        port.medium.assess()

    def _babble(self, fault: Babble, port: Port, on: bool) -> None:
        """Keep one such frame in the queue: the end of each begins the next."""
        data = bytes.fromhex(fault.data)
        port.controller.babbles = (fault.identifier, data) if on else None
        if on:
            port.queue((fault.identifier, data))
