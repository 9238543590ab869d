"""Runs of the rig in the lab: what is sent, by identifier, and what an inline run of the same scenario sends."""

import functools
import hashlib
import json
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from hil import experiment, scenario_file
from hil.rig import Outcome, run_inline
from hil.scenario import Scenario

SETUP = "clock.setup_cycles=60"
"""Cycles before the run: what the set-up needs, so that the lab's time goes into the run."""
DURATION_S = 0.3
OF_THE_WALL = ("wall_s", "startup_s", "processes", "clock", "mode", "frame_log_sha256")
"""What two runs with the same payloads may differ in: the machine's time, and in which order sockets heard a cycle."""

Payloads = dict[int, list[bytes]]


def scenario(name: str, duration_s: float = DURATION_S) -> Scenario:
    """Return a built-in scenario, cut."""
    return scenario_file.load(name, settings(duration_s))


def settings(duration_s: float = DURATION_S) -> list[str]:
    """Return how a scenario is cut for the lab."""
    return [f"duration_s={duration_s}", SETUP, "bus.fidelity=functional"]


def payloads(frames: Iterable[tuple[int, bytes]]) -> Payloads:
    """Return the data of every identifier, in order."""
    found: Payloads = defaultdict(list)
    for identifier, data in frames:
        found[identifier].append(data)
    return dict(found)


def of(outcome: Outcome) -> Payloads:
    """Return what was sent from cycle 0 on."""
    return payloads((identifier, data) for _, identifier, data, _ in outcome.log.frames)


def sha256(found: Payloads) -> str:
    """Return one hash over the payloads of every identifier, in order."""
    digest = hashlib.sha256()
    for identifier in sorted(found):
        digest.update(b"%03x %d " % (identifier, len(found[identifier])) + b" ".join(found[identifier]) + b"\n")
    return digest.hexdigest()


@functools.cache
def functional(name: str, duration_s: float = DURATION_S) -> Outcome:
    """Return the inline run that others are compared with."""
    return run_inline(scenario(name, duration_s))


@functools.cache
def functional_summary(name: str, duration_s: float = DURATION_S) -> dict[str, Any]:
    """Return its summary without what the machine's time has a part in."""
    return summary(functional(name, duration_s))


def summary(outcome: Outcome) -> dict[str, Any]:
    """Return what a run was worth, without what the machine's time has a part in."""
    return comparable(json.loads(json.dumps(experiment.examine(outcome, 0.0).summary)))


def comparable(found: dict[str, Any]) -> dict[str, Any]:
    """Return a summary without what two equal runs may differ in."""
    kept = {key: value for key, value in found.items() if key not in OF_THE_WALL}
    assert sum(kept.pop("lost_frames_by_cause").values()) == kept["lost_frames"]
    kept.pop("wire")
    return kept


def children(pid: int) -> list[int]:
    """Return the process ids of the children."""
    return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
