"""How long a frame occupies the bus, and its bits one by one: the bridge from identifiers with flags to bits."""

from hil.wire.bits import frame_bits
from hil.wire.fd_bits import fd_frame_bits
from hil.wire.frame_plan import FramePlan, frame_plan
from hil.wire.identifier import BRS, ESI, EXTENDED, EXTENDED_MASK, FD, REMOTE, STANDARD_MASK
from hil.wire.rates import Rates


def duration_ns(identifier: int, data: bytes, rates: Rates) -> int:
    """Return the time from SOF to the last bit of EOF, without intermission, in ns."""
    if identifier <= STANDARD_MASK:
        return frame_bits(identifier, data) * rates.bit_ns
    extended = identifier & EXTENDED != 0
    number = identifier & EXTENDED_MASK
    if identifier & FD:
        nominal, fast = fd_frame_bits(number, data, extended, identifier & BRS != 0, identifier & ESI != 0)
        return nominal * rates.bit_ns + fast * (rates.data_bit_ns or rates.bit_ns)
    if identifier & REMOTE:
        return frame_bits(number, b"", extended, True, len(data)) * rates.bit_ns
    return frame_bits(number, data, extended) * rates.bit_ns


def plan_of(identifier: int, data: bytes) -> FramePlan:
    """Return the bits of a frame as its sender drives them."""
    remote, fd = identifier & REMOTE != 0, identifier & FD != 0
    return frame_plan(
        identifier & EXTENDED_MASK,
        b"" if remote else data,
        identifier & EXTENDED != 0,
        remote,
        fd,
        identifier & BRS != 0,
        identifier & ESI != 0,
        len(data) if remote else None,
    )
