"""A run as a trace for Perfetto (ui.perfetto.dev) or chrome://tracing: who is on the bus, who computes, who waits.

The bus is one process, with a track of its cycles, one of the frames on the wire, and a counter of those that wait;
every node is another, with its computing and, as asynchronous events, since they may overlap, its waiting frames.
Arrows go from a frame to the computing that it starts, and on to the answer. A wait ends where the attempt begins that
is acknowledged.

A viewer takes no negative time: 0 is the start of the set-up, and `otherData` says when cycle 0 begins.

Ref: "Trace Event Format" of the Chromium project (docs.google.com/document/d/
1CvAClvFfyA5R-PhYUmn5OOQtYMH4h6I0nSsKchNAySU): JSON object format; complete (X), async (b, e), counter (C), flow
(s, t, f) and metadata (M) events; ts and dur in us.
"""

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from dbc.codec import Codec
from dbc.compiler import load_arm
from hil.scenario import Scenario
from hil.timing.measured import name_of
from hil.timing.timeline import FrameTime, Timeline

Event = dict[str, Any]
BUS = 1
"""Process number of the bus; those of the nodes follow in node order."""
FRAMES, CYCLES = 1, 2
"""Tracks of the bus."""


def write_trace(path: Path, scenario: Scenario, timeline: Timeline) -> Path:
    """Write a run from its set-up on in the Chrome trace event format, every instant to the ns; return the path."""
    trace = _Trace(scenario, timeline, load_arm())
    known = {"scenario": scenario.name, "cycle_0_us": trace.us(0), "period_us": scenario.period_ns / 1e3}
    events = ",\n".join(json.dumps(event, separators=(",", ":")) for event in trace.events())
    path.write_text(f'{{"displayTimeUnit":"ns","otherData":{json.dumps(known)},"traceEvents":[\n{events}\n]}}\n')
    return path


class _Trace:
    """What becomes events. Times of events are us since the start of the set-up."""

    def __init__(self, scenario: Scenario, timeline: Timeline, codec: Codec) -> None:
        self._scenario, self._timeline, self._codec = scenario, timeline, codec
        self._start_ns = -scenario.clock.setup_cycles * scenario.period_ns
        self._process = {name: BUS + 1 + k for k, name in enumerate(scenario.node_names)}

    def us(self, now_ns: int) -> float:
        """Return an instant; three decimals are whole ns."""
        return (now_ns - self._start_ns) / 1e3

    def events(self) -> Iterator[Event]:
        """Yield all events; names first."""
        yield from self._names()
        yield from self._cycles()
        yield from self._frames()
        yield from self._computing()
        yield from self._waiting()
        yield from self._flows()

    # -- tracks --

    def _names(self) -> Iterator[Event]:
        for process, name in ((BUS, "bus"), *((number, name) for name, number in self._process.items())):
            yield _meta("process_name", process, 0, name=name)
            yield _meta("process_sort_index", process, 0, sort_index=process)
        tracks = [(BUS, FRAMES, "frames"), (BUS, CYCLES, "cycles")]
        tracks += [(number, number, "computing") for number in self._process.values()]
        for process, track, name in tracks:
            yield _meta("thread_name", process, track, name=name)
            yield _meta("thread_sort_index", process, track, sort_index=track)

    def _cycles(self) -> Iterator[Event]:
        """Yield the cycles back to back, so that one can be searched for by its number."""
        period_ns, last = self._scenario.period_ns, self._cycle(self._timeline.frames[-1].ends_ns)
        for cycle in range(self._cycle(self._start_ns), last + 1):
            yield self._slice(BUS, CYCLES, f"cycle {cycle}", cycle * period_ns, (cycle + 1) * period_ns)

    def _frames(self) -> Iterator[Event]:
        for frame in self._timeline.frames:
            known = {
                "identifier": f"{frame.identifier:#x}",
                "data": frame.data.hex(),
                "sender": frame.sender,
                "cycle": self._cycle(frame.queued_ns),
                "waited_us": (frame.starts_ns - frame.queued_ns) / 1e3,
            }
            name = name_of(frame.identifier, self._codec)
            yield self._slice(BUS, FRAMES, name, frame.starts_ns, frame.ends_ns) | {"args": known}

    def _computing(self) -> Iterator[Event]:
        """Yield what every node computed; where that took no time, it was only awake."""
        for node, computing in self._timeline.computing.items():
            number = self._process[node]
            for begins_ns, lasts_ns in computing:
                name = "computes" if lasts_ns else "wakes"
                yield self._slice(number, number, name, begins_ns, begins_ns + lasts_ns)

    def _waiting(self) -> Iterator[Event]:
        """Yield every wait between its sender's asking and the wire, and after it how many frames wait."""
        changes: Counter[int] = Counter()
        for k, frame in enumerate(self._timeline.frames):
            if frame.starts_ns == frame.queued_ns:
                continue
            number = self._process[frame.sender]
            name = f"{name_of(frame.identifier, self._codec)} waits"
            common = {"cat": "waiting", "id": f"{k:#x}", "name": name, "pid": number, "tid": number}
            for phase, at_ns, change in (("b", frame.queued_ns, 1), ("e", frame.starts_ns, -1)):
                yield common | {"ph": phase, "ts": self.us(at_ns)}
                changes[at_ns] += change
        waiting = 0
        for at_ns, change in sorted(changes.items()):
            waiting += change
            yield _event("C", "waiting", BUS, FRAMES, self.us(at_ns)) | {"args": {"frames": waiting}}

    def _flows(self) -> Iterator[Event]:
        """Yield an arrow from each frame to the computing that it starts, and on to the frames that answer."""
        frames = self._timeline.frames
        asked = {frame.ends_ns: frame for frame in frames}
        answers: dict[tuple[str, int], list[FrameTime]] = {}
        for frame in frames:
            answers.setdefault((frame.sender, frame.queued_ns), []).append(frame)
        flow = 0
        for node, computing in self._timeline.computing.items():
            for begins_ns, lasts_ns in computing:
                cause, number = asked.get(begins_ns), self._process[node]
                if cause is None or not lasts_ns:
                    continue
                for answer in answers.get((node, begins_ns + lasts_ns), []):
                    flow += 1
                    yield self._arrow("s", flow, BUS, FRAMES, cause.starts_ns)
                    yield self._arrow("t", flow, number, number, begins_ns)
                    yield self._arrow("f", flow, BUS, FRAMES, answer.starts_ns) | {"bp": "e"}

    # -- one event --

    def _cycle(self, now_ns: int) -> int:
        return now_ns // self._scenario.period_ns

    def _slice(self, process: int, track: int, name: str, begins_ns: int, ends_ns: int) -> Event:
        return _event("X", name, process, track, self.us(begins_ns)) | {"dur": (ends_ns - begins_ns) / 1e3}

    def _arrow(self, phase: str, flow: int, process: int, track: int, at_ns: int) -> Event:
        return _event(phase, "answers", process, track, self.us(at_ns)) | {"cat": "flow", "id": flow}


def _event(phase: str, name: str, process: int, track: int, at_us: float) -> Event:
    return {"ph": phase, "name": name, "pid": process, "tid": track, "ts": at_us}


def _meta(what: str, process: int, track: int, **known: Any) -> Event:
    return {"ph": "M", "name": what, "pid": process, "tid": track, "args": known}
