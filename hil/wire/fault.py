"""What can go wrong on the wire, as a script says it: which bit of which frame, whose cable, from when to when.

Times are virtual seconds since cycle 0. Bits are counted from SOF (0) or, negative, from the last bit of EOF (-1);
stuff bits count. Identifiers carry the flags of linux/can.h and identifier.py.

Ref: Rufino et al., "Fault-Tolerant Broadcasts in CAN" (FTCS 1998), for the last-but-one bit of EOF: who sees it
inverted misses a frame that the others have, or they get it twice.
"""

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from hil.errors import ScenarioError
from hil.wire.identifier import is_identifier, refusal

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


class Interval(_Fault):
    """A fault of one node, from then until then (None: until the end)."""

    node: str
    from_s: Seconds
    to_s: Seconds | None = None


class Overrun(Interval):
    """A node takes no frame out of its controller: what comes is lost, and counted."""

    kind: Literal["receive overrun"] = "receive overrun"


class Babble(Interval):
    """A node sends a frame again and again, as fast as the bus lets it (a babbling idiot)."""

    kind: Literal["babble"] = "babble"
    identifier: Annotated[int, Field(ge=0)] = 0
    data: Annotated[str, Field(pattern=r"^([0-9A-Fa-f]{2})*$")] = ""


class StuckDominant(Interval):
    """A node's transceiver holds the bus dominant."""

    kind: Literal["stuck dominant"] = "stuck dominant"


class CutOff(Interval):
    """A node's cable is broken, and mended."""

    kind: Literal["cut off"] = "cut off"


class QueueDelay(Interval):
    """A node's frames wait longer in its controller before they take part in arbitration."""

    kind: Literal["queue delay"] = "queue delay"
    delay_us: Annotated[float, Field(gt=0.0, le=1e6)]


Fault = Annotated[
    BitError | BitErrorRate | Overrun | Babble | StuckDominant | CutOff | QueueDelay, Field(discriminator="kind")
]

NEEDS_BITS = (BitError, BitErrorRate, Babble, StuckDominant, CutOff)


def check_faults(faults: Sequence[Fault], names: Sequence[str], functional: bool, fd: bool) -> None:
    """Raise ScenarioError for a fault that cannot be: of nobody, of no frame, backwards, where bits cost nothing.

    names: of the participants; none: anybody.
    """
    for number, fault in enumerate(faults, 1):
        reason = _objection(fault, names, functional, fd)
        if reason:
            raise ScenarioError(f"fault {number} ({fault.kind}): {reason}")


def _objection(fault: Fault, names: Sequence[str], functional: bool, fd: bool) -> str | None:
    concerned = [fault.node] if isinstance(fault, Interval) else list(fault.at)
    for name in concerned if names else []:
        if name not in names:
            return f"no node {name!r}; there are {', '.join(names)}"
    if functional and isinstance(fault, NEEDS_BITS):
        return "it needs fidelity 'bits': with 'functional' a frame has none"
    if isinstance(fault, Interval) and fault.to_s is not None and fault.to_s <= fault.from_s:
        return f"to_s = {fault.to_s} is not after from_s = {fault.from_s}"
    if isinstance(fault, BitError) and not is_identifier(fault.identifier):
        return f"identifier {fault.identifier:#x} is none; flags as in linux/can.h"
    if isinstance(fault, Babble):
        return refusal(fault.identifier, len(fault.data) // 2, fd)
    return None
