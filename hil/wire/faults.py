"""Faults on the wire, by script and by seed: what disturbs which frames, and whose cable breaks when.

Times are virtual seconds since cycle 0, bits are counted from SOF (0) or, negative, from the last bit of EOF (-1);
stuff bits count. The same script and seed give the same run.

Ref: Rufino et al., "Fault-Tolerant Broadcasts in CAN" (FTCS 1998), for the last-but-one bit of EOF: who sees it
inverted misses a frame that the others have, or they get it twice.
"""

import random
from collections.abc import Callable, Sequence
from math import log
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from hil.errors import ScenarioError
from hil.wire.agenda import FAULT
from hil.wire.bit_play import Flips
from hil.wire.duration import plan_of
from hil.wire.identifier import FD, is_identifier, refusal
from hil.wire.kernel import Kernel
from hil.wire.port import Port

Seconds = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]


class _Fault(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class BitError(_Fault):
    """One bit of a frame is inverted for some (at; none: for everybody): the occurrence-th frame of this identifier.

    every: of every frame from that one on.
    """

    kind: Literal["bit error"] = "bit error"
    identifier: Annotated[int, Field(ge=0)]
    bit: int
    occurrence: Annotated[int, Field(ge=1)] = 1
    every: bool = False
    at: tuple[str, ...] = ()


class BitErrorRate(_Fault):
    """Bits of frames are inverted at random, each with this probability, for some (at; none: for everybody)."""

    kind: Literal["bit error rate"] = "bit error rate"
    rate: Annotated[float, Field(gt=0.0, le=0.1)]
    at: tuple[str, ...] = ()


class _Interval(_Fault):
    node: str
    from_s: Seconds
    to_s: Seconds | None = None


class Overrun(_Interval):
    """A node takes no frame out of its controller: what comes is lost, and counted."""

    kind: Literal["receive overrun"] = "receive overrun"


class Babble(_Interval):
    """A node sends a frame again and again, as fast as the bus lets it (a babbling idiot)."""

    kind: Literal["babble"] = "babble"
    identifier: Annotated[int, Field(ge=0)] = 0
    data: Annotated[str, Field(pattern=r"^([0-9A-Fa-f]{2})*$")] = ""


class StuckDominant(_Interval):
    """A node's transceiver holds the bus dominant."""

    kind: Literal["stuck dominant"] = "stuck dominant"


class CutOff(_Interval):
    """A node's cable is broken, and mended."""

    kind: Literal["cut off"] = "cut off"


class QueueDelay(_Interval):
    """A node's frames wait longer in its controller before they take part in arbitration."""

    kind: Literal["queue delay"] = "queue delay"
    delay_us: Annotated[float, Field(gt=0.0, le=1e6)]


Fault = Annotated[
    BitError | BitErrorRate | Overrun | Babble | StuckDominant | CutOff | QueueDelay, Field(discriminator="kind")
]

NEEDS_BITS = (BitError, BitErrorRate, StuckDominant, CutOff)


def check_faults(faults: Sequence[Fault], names: Sequence[str], functional: bool, fd: bool) -> None:
    """Raise ScenarioError for a fault that cannot be: of nobody, of no frame, backwards, where bits cost nothing.

    names: of the participants; none: anybody.
    """
    for number, fault in enumerate(faults, 1):
        reason = _objection(fault, names, functional, fd)
        if reason:
            raise ScenarioError(f"fault {number} ({fault.kind}): {reason}")


def _objection(fault: Fault, names: Sequence[str], functional: bool, fd: bool) -> str | None:
    concerned = [fault.node] if isinstance(fault, _Interval) else list(fault.at)
    for name in concerned if names else []:
        if name not in names:
            return f"no node {name!r}; there are {', '.join(names)}"
    if functional and isinstance(fault, NEEDS_BITS):
        return "it needs fidelity 'bits': with 'functional' a frame has none"
    if isinstance(fault, _Interval) and fault.to_s is not None and fault.to_s <= fault.from_s:
        return f"to_s = {fault.to_s} is not after from_s = {fault.from_s}"
    if isinstance(fault, BitError) and not is_identifier(fault.identifier):
        return f"identifier {fault.identifier:#x} is none; flags as in linux/can.h"
    if isinstance(fault, Babble):
        return refusal(fault.identifier, len(fault.data) // 2, fd)
    return None


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
            if isinstance(fault, _Interval):
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
        port = self._port(fault.node) if isinstance(fault, _Interval) else None
        if port is None:
            return
        medium = self._kernel.medium
        if isinstance(fault, Overrun):
            port.controller.overrun = on
        elif isinstance(fault, QueueDelay):
            port.controller.queue_delay_ns = round(fault.delay_us * 1e3) if on else 0
        elif isinstance(fault, CutOff):
            (self._kernel.cut_off if on else self._kernel.rejoin)(port)
        elif isinstance(fault, StuckDominant):
            (medium.stuck.add if on else medium.stuck.discard)(port)
            medium.assess()
            medium.disturb()
        elif isinstance(fault, Babble):
            self._babble(fault, port, on)

    def _babble(self, fault: Babble, port: Port, on: bool) -> None:
        """Keep one such frame in the queue: the end of each begins the next."""
        data = bytes.fromhex(fault.data)
        port.controller.babbles = (fault.identifier, data) if on else None
        if on:
            port.queue((fault.identifier, data))
