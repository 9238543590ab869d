"""Whole runs by the clock `wall`, every node a process: on a paced `hil` bus, whose observers share no virtual time."""

import json
import os
import signal
from collections import defaultdict
from pathlib import Path
from typing import Any

import can
import pytest

from hil import scenario_file
from hil.can_port import CanPort
from hil.rig import run_inline
from tests.hil.test_sync_rig import LIMIT_S, node_of, wait_for

PACE = "0.005"
"""One period in 200 ms: a node answers in some 5 ms, and in 100 ms on a machine with three times too much to do."""
CYCLES = 40
SHORT = ("--set", f"duration_s={CYCLES / 1000}", "--set", "bus.fidelity=functional")


@pytest.fixture
def street(hil: Any) -> str:
    hil.bus("street", "--pace", "1")
    return "street"


def command(*words: str) -> list[str]:
    return ["run", "-i", "hil", "-c", "street", "--clock", "wall", "--pace", PACE, "--json", *words]


@pytest.mark.usefixtures("street")
def test_on_time_the_payloads_are_those_of_functional(hil: Any, tmp_path: Any) -> None:
    """On a machine that has no time at all whoever is late is counted, and may even end the run."""
    out, err = hil.start(*command(*SHORT, "--out", str(tmp_path / "run"))).communicate(timeout=LIMIT_S)
    summary = json.loads(out)
    expected = run_inline(scenario_file.load("paper-joint", [word for word in SHORT if word != "--set"]))
    assert (summary["clock"], summary["mode"], summary["deterministic"]) == ("wall", "wall", False)
    if summary["deadline_misses"] or summary["real_time"]["overruns"]:
        pytest.skip(f"this machine had no time: {summary['deadline_misses_by_cause']}")
    found = payloads((m.arbitration_id, bytes(m.data)) for m in can.LogReader(tmp_path / "run" / "frames.log"))
    assert found == payloads((identifier, data) for _, identifier, data, _ in expected.log.frames)
    assert summary["faults"] == [], err
    check_figures(summary["real_time"])
    drawn = (tmp_path / "run" / "latency.svg").read_text()
    assert all(f"{name}, behind Sync" in drawn for name in ("Encoder_1", "Current_2", "AccelRef"))
    assert (tmp_path / "run" / "latency.png").stat().st_size > 10_000


def payloads(frames: Any) -> dict[int, list[bytes]]:
    found = defaultdict(list)
    for identifier, data in frames:
        found[identifier].append(data)
    return found


def check_figures(figures: dict[str, Any]) -> None:
    assert figures["pace"] == float(PACE)
    assert figures["foreign_stamps"] > 0  # those of the wire are virtual
    late, interval = figures["sync_late"], figures["sync_interval"]
    assert late["count"] == CYCLES
    assert 0 <= late["min_s"] <= late["p50_s"] <= late["p99_s"] <= late["p99.9_s"] <= late["max_s"]
    assert sum(late["counts"]) == late["count"]
    assert interval["p50_s"] == pytest.approx(0.2, rel=0.5)
    assert {"Encoder_1", "Current_3", "AccelRef", "State"} <= figures["since_sync"].keys()


@pytest.mark.parametrize(("name", "says"), [("joint2", "joint2 was killed by SIGKILL"), ("dsp", "dsp was killed")])
@pytest.mark.usefixtures("street")
def test_a_killed_node_brakes_the_arm_and_is_named(hil: Any, name: str, says: str) -> None:
    rig = hil.start(*command("--set", "duration_s=30"))
    with_stop = CanPort("hil", "street", {0x010})
    in_run(name, rig.pid)
    os.kill(node_of(rig.pid, name), signal.SIGKILL)
    _, err = rig.communicate(timeout=LIMIT_S)
    assert rig.returncode == 5
    assert says in err
    assert "Stop with reason" in err
    assert with_stop.receive(1.0) in [(0x010, b"\x08"), (0x010, b"\x02")]
    with_stop.close()


@pytest.mark.usefixtures("street")
def test_a_dsp_that_sleeps_finds_the_arm_braked_and_the_run_over(hil: Any) -> None:
    rig = hil.start(*command("--set", "duration_s=30"))
    in_run("dsp", rig.pid)
    pid = node_of(rig.pid, "dsp")
    with_stop = CanPort("hil", "street", {0x010})
    os.kill(pid, signal.SIGSTOP)
    assert wait_for(lambda: with_stop.receive(1.0)) in [(0x010, b"\x08"), (0x010, b"\x02")]
    os.kill(pid, signal.SIGCONT)
    with_stop.close()
    out, err = rig.communicate(timeout=LIMIT_S)
    assert rig.returncode == 6
    assert "no Sync for 3 periods: brakes engaged" in err or "encoder lost" in err
    assert json.loads(out)["faults"]


@pytest.mark.usefixtures("street")
def test_nodes_of_a_rig_that_was_killed_end(hil: Any, children_of: Any) -> None:
    rig = hil.start(*command("--set", "duration_s=30"))
    in_run("dsp", rig.pid)
    children = children_of(rig.pid)
    rig.kill()
    wait_for(lambda: not any(alive(pid) for pid in children))


def alive(pid: int) -> bool:
    try:
        return "State:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


def in_run(name: str, rig: int) -> None:
    """Wait until the arm has moved for some cycles."""
    listener = CanPort("hil", "street", {0x121})
    while wait_for(lambda: listener.receive(1.0))[1][:2] == b"\0\0":
        pass
    assert wait_for(lambda: node_of(rig, name))
    listener.close()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--clock", "wall", "--pace", "2"), "of at most 1"),
        (("--clock", "sync", "--pace", "0.5"), "only --clock wall has one"),
        (("--clock", "wall", "--inline"), "leave --inline out"),
        (("--clock", "wall", "--set", "clock.stamps=hardware", "--set", "duration_s=0.1"), "SocketCAN only"),
    ],
)
@pytest.mark.usefixtures("street")
def test_what_cannot_be_is_refused(hil: Any, words: tuple[str, ...], says: str) -> None:
    rig = hil.start("run", "-i", "hil", "-c", "street", *words)
    _, err = rig.communicate(timeout=LIMIT_S)
    assert rig.returncode in (2, 4, 5)
    assert says in " ".join(err.replace("│", " ").split())
    assert "Traceback" not in err
