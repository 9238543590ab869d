"""A wake-up's two messages, whole and in one step, for the usual ones; protocol.py says what is in them.

A process that takes turns with others on one CPU finds its caches cold, and then every call counts: taken apart into
prefix, header and frames, the same two messages take a quarter of the whole round trip. What is not usual is left to
protocol.py: other messages, several at once, parts of one, more than one frame to send, unusual frames.
"""

import struct

from hil.node import Reaction
from hil.wire.identifier import LONGEST_CLASSIC, STANDARD_MASK
from hil.wire.port import Arrival
from hil.wire.protocol import FAR_NS, GRANT, NO_TIMER, PREFIX_BYTES, YIELD

_GRANT = struct.Struct("<IBqBI")
_YIELD = struct.Struct("<IBqqI")
_FRAME = struct.Struct("<qQB")
_GRANT_BYTES, _YIELD_BYTES, _FRAME_BYTES = _GRANT.size, _YIELD.size, _FRAME.size
_UNCOUNTED = PREFIX_BYTES - 1
"""Bytes of a message that its length does not count."""

Granted = tuple[int, list[Arrival], Arrival | None]
"""(now in ns, stored frames, waking frame or None for the timer)"""


def encode_grant(now_ns: int, stored: list[Arrival], cause: Arrival | None) -> bytes:
    """Return GRANT, whole."""
    pack = _FRAME.pack
    count = len(stored)
    frames = b"".join([pack(end_ns, identifier, len(data)) + data for end_ns, identifier, data in stored])
    if cause is not None:
        end_ns, identifier, data = cause
        frames += pack(end_ns, identifier, len(data)) + data
        count += 1
    return _GRANT.pack(_GRANT_BYTES - _UNCOUNTED + len(frames), GRANT, now_ns, cause is not None, count) + frames


def decode_yield(data: bytes) -> Reaction | None:
    """Return the reaction of a YIELD with one usual frame or none; None for anything else."""
    if len(data) < _YIELD_BYTES:
        return None
    length, kind, busy_ns, timer, count = _YIELD.unpack_from(data)
    if kind != YIELD or length + _UNCOUNTED != len(data) or timer > FAR_NS or not 0 <= busy_ns <= FAR_NS:
        return None
    timer_ns = None if timer == NO_TIMER else timer
    if length + _UNCOUNTED == _YIELD_BYTES and count == 0:
        return busy_ns, timer_ns, []
    if count != 1 or len(data) < _YIELD_BYTES + _FRAME_BYTES:
        return None
    delay_ns, identifier, size = _FRAME.unpack_from(data, _YIELD_BYTES)
    payload = data[_YIELD_BYTES + _FRAME_BYTES :]
    if len(payload) != size or size > LONGEST_CLASSIC or identifier > STANDARD_MASK or delay_ns > FAR_NS:
        return None
    return busy_ns, timer_ns, [(delay_ns, identifier, payload)]


def decode_grant(data: bytes) -> Granted | None:
    """Return what a GRANT with usual frames brings; None for anything else."""
    if len(data) < _GRANT_BYTES:
        return None
    length, kind, now_ns, by_frame, count = _GRANT.unpack_from(data)
    if kind != GRANT or length + _UNCOUNTED != len(data):
        return None
    unpack = _FRAME.unpack_from
    frames = []
    start, end = _GRANT_BYTES, len(data)
    while start + _FRAME_BYTES <= end:
        end_ns, identifier, size = unpack(data, start)
        if size > LONGEST_CLASSIC or identifier > STANDARD_MASK or end_ns > FAR_NS:
            return None
        start += _FRAME_BYTES
        frames.append((end_ns, identifier, data[start : start + size]))
        start += size
    if start != end or len(frames) != count or by_frame > count:
        return None
    return now_ns, frames, frames.pop() if by_frame else None


def encode_yield(reaction: Reaction) -> bytes:
    """Return YIELD, whole."""
    busy_ns, timer_ns, sends = reaction
    pack = _FRAME.pack
    frames = b"".join([pack(delay_ns, identifier, len(data)) + data for delay_ns, identifier, data in sends])
    timer = NO_TIMER if timer_ns is None else timer_ns
    return _YIELD.pack(_YIELD_BYTES - _UNCOUNTED + len(frames), YIELD, busy_ns, timer, len(sends)) + frames
