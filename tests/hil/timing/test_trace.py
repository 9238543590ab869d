"""The trace of a run, parsed back: every frame to the ns, tracks that never overlap, and the documented format.

Ref: "Trace Event Format" of the Chromium project; the table below is its.
"""

import json
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil import scenario_file
from hil.scenario import Scenario
from hil.timing.timeline import Computing, FrameTime, Timeline, run_with_timeline
from hil.timing.trace import write_trace

SHORT = ("duration_s=0.09", "trajectory.time_s=0.08", "trajectory.by_rad=[0.01, -0.01, 0.01]")
ODD = ("bus.bitrate=800000", "clock.period_s=0.0015", "joint.g_rad_s=300", "joint.compute_s=98.763e-6")
"""Bits of 1250 ns, and computing that is no whole number of them."""
TIMED = {"name": str, "pid": int, "tid": int, "ts": float}
REQUIRED: dict[str, dict[str, type]] = {
    "X": TIMED | {"dur": float},
    "b": TIMED | {"id": str, "cat": str},
    "e": TIMED | {"id": str, "cat": str},
    "C": TIMED | {"args": dict},
    "s": TIMED | {"id": int, "cat": str},
    "t": TIMED | {"id": int, "cat": str},
    "f": TIMED | {"id": int, "cat": str, "bp": str},
    "M": {"name": str, "pid": int, "tid": int, "args": dict},
}
"""What an event of a phase must have, beside `ph`."""
METADATA = {"process_name": "name", "thread_name": "name"}
METADATA |= {"process_sort_index": "sort_index", "thread_sort_index": "sort_index"}
Events = list[dict[str, Any]]


def parse(path: Path) -> dict[str, Any]:
    """Parse as a viewer does, which knows no NaN."""

    def refuse(text):
        pytest.fail(f"{text} is not JSON")

    found: dict[str, Any] = json.loads(path.read_text(), parse_constant=refuse)
    return found


def of_phase(trace: dict[str, Any], phases: str) -> Events:
    return [event for event in trace["traceEvents"] if event["ph"] in phases]


def ns(us: float) -> int:
    """Three decimals are whole ns; a float carries them for 104 days (2^53 ns)."""
    return round(us * 1000)


def named_tracks(trace: dict[str, Any]) -> dict[tuple[int, int], str]:
    """Return the names of tracks, "process/thread"."""
    meta = of_phase(trace, "M")
    processes = {event["pid"]: event["args"]["name"] for event in meta if event["name"] == "process_name"}
    return {
        (event["pid"], event["tid"]): f"{processes[event['pid']]}/{event['args']['name']}"
        for event in meta
        if event["name"] == "thread_name"
    }


def slices(trace: dict[str, Any], track: str) -> Events:
    names = named_tracks(trace)
    return [event for event in of_phase(trace, "X") if names[event["pid"], event["tid"]] == track]


def read_frames(path: Path) -> list[FrameTime]:
    """Rebuild the frames of a run from its trace."""
    trace = parse(path)
    start_ns = ns(trace["otherData"]["cycle_0_us"])
    frames = []
    for event in slices(trace, "bus/frames"):
        known, starts_ns = event["args"], ns(event["ts"]) - start_ns
        times = starts_ns - ns(known["waited_us"]), starts_ns, starts_ns + ns(event["dur"])
        data = bytes.fromhex(known["data"])
        frames.append(FrameTime(*times, int(known["identifier"], 16), data, known["sender"]))
    return frames


@pytest.fixture(scope="module", params=[SHORT, SHORT + ODD], ids=["paper-joint", "odd"])
def run(request) -> tuple[Scenario, Timeline]:
    scenario = scenario_file.load("paper-joint", request.param)
    return scenario, run_with_timeline(scenario)[1]


@pytest.fixture(scope="module")
def path(run, tmp_path_factory) -> Path:
    return write_trace(tmp_path_factory.mktemp("trace") / "trace.json", *run)


@pytest.fixture(scope="module")
def trace(path) -> dict[str, Any]:
    return parse(path)


def test_every_frame_comes_back_to_the_ns(path, run):
    assert read_frames(path) == run[1].frames


def test_every_event_has_what_the_format_asks_for(trace):
    assert trace["displayTimeUnit"] == "ns"
    assert {event["ph"] for event in trace["traceEvents"]} == REQUIRED.keys()
    for event in trace["traceEvents"]:
        for key, kind in REQUIRED[event["ph"]].items():
            assert isinstance(event[key], kind), (event, key)
        assert event.get("ts", 0) >= 0
        assert event.get("dur", 0) >= 0
        assert event.get("bp", "e") == "e"
    for event in of_phase(trace, "M"):
        assert event["args"].keys() == {METADATA[event["name"]]}


def test_every_track_has_a_name(trace, run):
    names = named_tracks(trace)
    assert {(event["pid"], event["tid"]) for event in trace["traceEvents"] if event["ph"] != "M"} <= names.keys()
    nodes = [f"{node}/computing" for node in run[0].node_names]
    assert sorted(names.values()) == sorted(["bus/frames", "bus/cycles", *nodes])


def test_slices_of_a_track_never_overlap(trace):
    """Perfetto moves what overlaps without nesting to another track; so it says in "Visualizing external formats"."""
    for track in named_tracks(trace).values():
        found = sorted((ns(event["ts"]), ns(event["ts"]) + ns(event["dur"])) for event in slices(trace, track))
        assert len(found) > 10
        assert all(before[1] <= after[0] for before, after in pairwise(found)), track


def test_computing_comes_back_to_the_ns(trace, run):
    start_ns = ns(trace["otherData"]["cycle_0_us"])
    for node, computing in run[1].computing.items():
        events = slices(trace, f"{node}/computing")
        assert [(ns(event["ts"]) - start_ns, ns(event["dur"])) for event in events] == computing
        assert all((event["name"] == "wakes") == (event["dur"] == 0) for event in events)


def test_every_wait_begins_and_ends_at_its_sender(trace, run):
    start_ns = ns(trace["otherData"]["cycle_0_us"])
    processes = {number: name.partition("/")[0] for (number, _), name in named_tracks(trace).items()}
    begun = {event["id"]: event for event in of_phase(trace, "b")}
    ended = {event["id"]: event for event in of_phase(trace, "e")}
    assert len(begun) == len(ended) == len(of_phase(trace, "be")) / 2
    assert begun.keys() == ended.keys()
    for number, event in begun.items():
        assert {**event, "ph": "e", "ts": ended[number]["ts"]} == ended[number]
    waits = Counter(
        (processes[event["pid"]], ns(event["ts"]) - start_ns, ns(ended[number]["ts"]) - start_ns)
        for number, event in begun.items()
    )
    frames = run[1].frames
    assert waits == Counter((f.sender, f.queued_ns, f.starts_ns) for f in frames if f.queued_ns < f.starts_ns)


def test_the_counter_says_how_many_frames_wait(trace, run):
    start_ns = ns(trace["otherData"]["cycle_0_us"])
    found = [(ns(event["ts"]) - start_ns, event["args"]["frames"]) for event in of_phase(trace, "C")]
    assert [at_ns for at_ns, _ in found] == sorted({at_ns for at_ns, _ in found})
    for at_ns, waiting in found[::7]:  # a sample: counting by hand is quadratic
        assert waiting == sum(frame.queued_ns <= at_ns < frame.starts_ns for frame in run[1].frames)
    assert found[-1][1] == 0
    assert max(waiting for _, waiting in found) == 3  # three Encoders behind Sync


def test_arrows_go_from_encoder_to_current(trace, run):
    """Each Current answers its Encoder, through the computing of its joint; in every cycle."""
    scenario = run[0]
    bus = {ns(event["ts"]): event for event in slices(trace, "bus/frames")}
    names = named_tracks(trace)
    steps: dict[int, Events] = {}
    for event in of_phase(trace, "stf"):
        steps.setdefault(event["id"], []).append(event)
    found = Counter()
    for asks, computes, answers in steps.values():
        assert [asks["ph"], computes["ph"], answers["ph"]] == ["s", "t", "f"]
        cause, answer = bus[ns(asks["ts"])], bus[ns(answers["ts"])]
        assert ns(cause["ts"]) + ns(cause["dur"]) == ns(computes["ts"])
        if cause["args"]["cycle"] >= 0:
            found[cause["name"], names[computes["pid"], computes["tid"]], answer["name"]] += 1
    chains = {(f"Encoder_{n}", f"joint{n}/computing", f"Current_{n}") for n in (1, 2, 3)}
    assert found == dict.fromkeys([*chains, ("Encoder_3", "dsp/computing", "AccelRef")], scenario.cycles)


def test_cycles_lie_back_to_back(trace, run):
    scenario = run[0]
    cycles = slices(trace, "bus/cycles")
    numbers = range(-scenario.clock.setup_cycles, scenario.cycles + 1)
    assert [event["name"] for event in cycles] == [f"cycle {number}" for number in numbers]
    assert [ns(event["ts"]) for event in cycles] == [k * scenario.period_ns for k in range(len(cycles))]
    for event in slices(trace, "bus/frames"):
        assert event["args"]["cycle"] == numbers[ns(event["ts"] - event["args"]["waited_us"]) // scenario.period_ns]


def test_the_same_bytes_twice(path, run, tmp_path):
    assert write_trace(tmp_path / "trace.json", *run).read_bytes() == path.read_bytes()


times_ns = st.tuples(st.integers(1, 10**11), st.integers(0, 10**9), st.integers(1, 10**9))


@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(times_ns, min_size=1, max_size=20), st.binary(max_size=8))
def test_any_ns_comes_back(tmp_path, drawn, data):
    """Gaps, waits and lengths of any number of ns, up to half an hour after the start."""
    scenario = scenario_file.load("paper-joint", ["clock.period_s=1.0", "joint.g_rad_s=0.5", "duration_s=2.0"])
    timeline, free_ns = Timeline(), -scenario.clock.setup_cycles * scenario.period_ns
    for gap_ns, waits_ns, lasts_ns in drawn:
        starts_ns = free_ns + gap_ns
        queued_ns = max(starts_ns - waits_ns, free_ns)
        free_ns = starts_ns + lasts_ns
        timeline.frames.append(FrameTime(queued_ns, starts_ns, free_ns, 0x7FF, data, "dsp"))
    timeline.computing["dsp"] = [Computing(timeline.frames[0].queued_ns, 1)]
    assert read_frames(write_trace(tmp_path / "trace.json", scenario, timeline)) == timeline.frames
