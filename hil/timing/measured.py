"""What a run's timeline says of every message: its response time, and when it came in every cycle.

A response lasts from when a frame is queued to the end of its intermission, as in the analysis.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from dbc.codec import Codec
from hil.latency import distribution
from hil.scenario import Scenario
from hil.timing.timeline import FrameTime, Timeline
from hil.wire.bits import INTERMISSION_BITS

Array = npt.NDArray[np.float64]
QUEUED, STARTS, ENDS = range(3)


def name_of(identifier: int, codec: Codec) -> str:
    """Return a message's name; what the database does not know goes by its identifier."""
    message = codec.by_identifier.get(identifier)
    return f"{identifier:#x}" if message is None else message.name


def by_message(timeline: Timeline, scenario: Scenario, codec: Codec) -> dict[str, list[FrameTime]]:
    """Return the frames of the run, without its set-up, by message."""
    found: dict[str, list[FrameTime]] = {}
    for frame in timeline.between(0, scenario.duration_ns):
        found.setdefault(name_of(frame.identifier, codec), []).append(frame)
    return found


def response_ns(frame: FrameTime, scenario: Scenario) -> int:
    """Return how long a frame took from being queued to the end of its intermission."""
    return frame.ends_ns + INTERMISSION_BITS * scenario.bit_ns - frame.queued_ns


def responses(timeline: Timeline, scenario: Scenario, codec: Codec) -> dict[str, dict[str, Any]]:
    """Return of every message of the run: its response times [s] as a distribution, and its shortest and longest frame.

    spans_ns: without intermission.
    """
    found = {}
    for name, frames in by_message(timeline, scenario, codec).items():
        spans_ns = [frame.ends_ns - frame.starts_ns for frame in frames]
        response = distribution([response_ns(frame, scenario) / 1e9 for frame in frames], scenario.bit_ns / 1e9)
        found[name] = {"response": response, "spans_ns": (min(spans_ns), max(spans_ns))}
    return found


def by_cycle(timeline: Timeline, scenario: Scenario, codec: Codec, cycles: int) -> dict[str, Array]:
    """Return (cycles, 3) instants of every message that carries its cycle: queued, starts, ends [ns]; nan: none."""
    period_ns = scenario.period_ns
    found: dict[str, Array] = {}
    for frame in timeline.between(0, scenario.duration_ns):
        message = codec.by_identifier.get(frame.identifier)
        fields = None if message is None else message.unpack(frame.data)
        if message is None or fields is None or message.signals[-1:] != ("Cycle",):
            continue
        period = frame.queued_ns // period_ns
        cycle = period - ((period - fields[-1]) & 0xFF)
        if 0 <= cycle < cycles:
            instants = found.setdefault(message.name, np.full((cycles, 3), np.nan))
            instants[cycle] = frame.queued_ns, frame.starts_ns, frame.ends_ns
    return found
