"""Every node a process of its own: the same frames as inline, whatever the machine does meanwhile; no orphan."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import can
import pytest

from hil import assemble, scenario_file
from hil.errors import ChannelError, FaultError, NodeError
from hil.frame_log import FrameLog
from hil.processes import run_processes
from hil.rig import Outcome, run_inline
from hil.scenario import Scenario
from hil.wire import channel, client
from hil.wire.channel import Listener

LIMIT_S = 60.0
"""For what must happen at all; it says nothing about speed."""


def wait_for(condition: Callable[[], Any]) -> Any:
    """Return the condition's first true value."""
    deadline = time.monotonic() + LIMIT_S
    while time.monotonic() < deadline:
        if value := condition():
            return value
        time.sleep(0.005)
    raise AssertionError("it never happened")


def name_of(pid: int) -> str:
    """Return the node that a child process plays."""
    words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    return words[3].decode() if b"hil.node_process" in words else ""


def nodes_of(pid: int) -> dict[str, int]:
    """Return the node processes of a rig by name."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        return {name: int(child) for child in children if (name := name_of(int(child)))}
    except FileNotFoundError:
        return {}


def waits(pid: int) -> int:
    """Return how often a process has waited: a node once or twice a cycle, hardly ever while it starts."""
    status = Path(f"/proc/{pid}/status").read_text()
    (count,) = re.findall(r"^voluntary_ctxt_switches:\s*(\d+)$", status, re.M)
    return int(count)


def in_the_middle(pid: int) -> bool:
    """Return whether a node is past the set-up's 200 cycles."""
    return waits(pid) > 600


@cache
def inline(name: str, *settings: str) -> Outcome:
    """Return the run of a scenario that several tests compare with, which none of them changes."""
    return run_inline(scenario_file.load(name, settings))


EVERY_WAY = [
    *(("bits", name) for name in scenario_file.builtin_names()),
    *(("functional", name) for name in ("five-joints", "load-step", "paper-joint", "paper-task")),
]


@pytest.mark.parametrize(("fidelity", "name"), EVERY_WAY)
def test_processes_and_inline_make_the_same_frames(fidelity: str, name: str) -> None:
    expected = inline(name, f"bus.fidelity={fidelity}")
    assert run_processes(expected.scenario, "arm").log.frames == expected.log.frames


@pytest.mark.parametrize("name", scenario_file.builtin_names())
def test_numba_changes_no_frame_and_no_record(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(assemble, "NUMBA_PAYS_FROM_S", 0.0)
    scenario = scenario_file.load(name)
    compiled, python = (run_inline(scenario, compiled=on) for on in (True, False))
    assert compiled.log.frames == python.log.frames
    assert compiled.reports == python.reports


def test_only_a_plant_that_runs_imports_numba() -> None:
    """The rig checks a scenario by building its nodes, and the other processes know the plant's module: unburdened."""
    code = "import sys; from hil import scenario_file as s; from hil.assemble import build_nodes as b; "
    code += "b(s.load('paper-joint')); assert not {'numba', 'llvmlite', 'numpy'} & sys.modules.keys()"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(("module", "unburdened"), [("hil.node_process", "can cantools"), ("hil.can_node", "cantools")])
def test_a_node_takes_the_codec_over_and_reads_no_database(module: str, unburdened: str) -> None:
    """Reading it is a quarter of a node's start."""
    code = f"import sys, {module}; assert not set('{unburdened}'.split()) & sys.modules.keys()"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_twenty_runs_make_the_same_frames(short: Scenario) -> None:
    expected = run_inline(short).log.sha256()
    assert {run_processes(short, f"arm{k}").log.sha256() for k in range(10)} == {expected}
    assert {run_inline(short).log.sha256() for _ in range(10)} == {expected}


def test_a_busy_machine_changes_nothing(short: Scenario) -> None:
    burners = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(os.cpu_count() or 1)]
    try:
        assert run_processes(short, "arm").log.sha256() == run_inline(short).log.sha256()
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()


@pytest.mark.parametrize("name", ["plant", "dsp", "joint2"])
def test_a_node_that_is_stopped_for_a_second_changes_nothing(name: str, hil: Any) -> None:
    long = "duration_s=6"
    rig = hil.start("run", "--json", "--set", long)
    pid = wait_for(lambda: nodes_of(rig.pid).get(name))
    wait_for(lambda: len(nodes_of(rig.pid)) == 5 and in_the_middle(pid))
    os.kill(pid, signal.SIGSTOP)
    time.sleep(1.0)  # the second of the title; nothing is judged by it
    assert rig.poll() is None
    os.kill(pid, signal.SIGCONT)
    out, err = rig.communicate(timeout=LIMIT_S)
    assert rig.returncode == 0, err
    assert json.loads(out)["frame_log_sha256"] == inline("paper-joint", long).log.sha256()


@pytest.mark.parametrize("name", ["plant", "dsp", "joint1", "joint2", "joint3"])
def test_a_killed_node_ends_the_run_with_its_name(name: str, hil: Any) -> None:
    rig = hil.start("run", "--set", "duration_s=30")
    nodes = wait_for(lambda: (found := nodes_of(rig.pid)) and len(found) == 5 and found)
    wait_for(lambda: in_the_middle(nodes[name]))
    os.kill(nodes[name], signal.SIGKILL)
    out, err = rig.communicate(timeout=LIMIT_S)
    assert rig.returncode == NodeError.exit_code
    assert re.search(rf"hil: {name} was killed by SIGKILL", err)
    assert "Traceback" not in out + err
    assert_all_ended(nodes.values())
    assert not list(hil.folder.glob("runs/*"))


@pytest.mark.parametrize(("number", "exit_code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_interrupting_the_rig_ends_every_node(number: int, exit_code: int, hil: Any) -> None:
    rig = hil.start("run", "--set", "duration_s=30")
    nodes = wait_for(lambda: (found := nodes_of(rig.pid)) and len(found) == 5 and found)
    wait_for(lambda: in_the_middle(nodes["plant"]))
    rig.send_signal(number)
    out, err = rig.communicate(timeout=LIMIT_S)
    assert rig.returncode == exit_code
    assert "Traceback" not in out + err
    assert_all_ended(nodes.values())


def test_killing_the_rig_itself_leaves_no_orphan(hil: Any) -> None:
    """With a plant in machine code, as a run of 40 s and more has it; the other runs that are cut off are shorter."""
    rig = hil.start("run", "--set", "duration_s=60")
    nodes = wait_for(lambda: (found := nodes_of(rig.pid)) and len(found) == 5 and found)
    wait_for(lambda: in_the_middle(nodes["plant"]))
    rig.kill()
    rig.communicate(timeout=LIMIT_S)
    assert_all_ended(nodes.values())


def assert_all_ended(pids: Any) -> None:
    wait_for(lambda: not any(name_of_or_none(pid) for pid in pids))


def name_of_or_none(pid: int) -> str:
    try:
        return name_of(pid)
    except (FileNotFoundError, ProcessLookupError):
        return ""


def test_a_node_that_hangs_is_named_when_the_patience_is_over(hil: Any) -> None:
    rig = hil.start("run", "--patience", "1.5", "--set", "duration_s=30")
    nodes = wait_for(lambda: (found := nodes_of(rig.pid)) and len(found) == 5 and found)
    wait_for(lambda: in_the_middle(nodes["joint3"]))
    os.kill(nodes["joint3"], signal.SIGSTOP)
    out, err = rig.communicate(timeout=LIMIT_S)
    assert rig.returncode == NodeError.exit_code
    assert "hil: joint3 has not answered for" in err
    assert "--patience" in err
    assert "waiting for joint3" in err
    assert "Traceback" not in out + err
    assert_all_ended(nodes.values())


def test_each_process_has_cpu_time_of_its_own(short: Scenario) -> None:
    reports = run_processes(short, "arm").reports
    assert len({report["process"]["pid"] for report in reports.values()} - {os.getpid()}) == 5
    assert all(report["process"]["cpu_s"] > 0.0 for report in reports.values())


def test_an_independent_logger_records_the_same_frames(tmp_path: Path) -> None:
    """python-can's own logger, unchanged, on the bus from before cycle 0 until the bus ends."""
    log = tmp_path / "logger.log"
    words = ["-i", "hil", "-c", "arm", "-f", str(log), "--bus-kwargs", "wait_s=30", "name=logger"]
    logger = subprocess.Popen(
        [sys.executable, "-m", "can.logger", *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        scenario = scenario_file.load("paper-joint")
        outcome = _run_with_observer(scenario, "logger")
        logger.wait(LIMIT_S)
    finally:
        logger.kill()
        logger.wait()
    assert outcome.lost_frames == 0
    with can.CanutilsLogReader(str(log)) as reader:
        recorded = [(m.timestamp, m.arbitration_id, bytes(m.data)) for m in reader if m.timestamp >= 0.0]
    in_run = [frame for frame in recorded if frame[0] > 0.0]
    assert [frame[1:] for frame in in_run] == [(number, data) for _, number, data, _ in outcome.log.frames]
    # candump's stamps are microseconds
    stamps = [
        abs(stamp - end_ns * 1e-9) for (stamp, _, _), (end_ns, _, _, _) in zip(in_run, outcome.log.frames, strict=True)
    ]
    assert max(stamps) <= 0.51e-6


def _run_with_observer(scenario: Scenario, name: str) -> Any:
    """Run it once the observer of that name is there: the nodes start, and time waits for them."""
    from hil import processes

    gather = processes._gather

    def gather_all(server: Any, nodes: Any) -> None:
        wait_for(lambda: (server.poll(0.05), any(observer.name == name for observer in server.observers))[1])
        gather(server, nodes)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(processes, "_gather", gather_all)
        return run_processes(scenario, "arm")


def test_a_busy_channel_is_refused_and_the_bus_on_it_goes_on(short: Scenario) -> None:
    listener = Listener("arm")
    try:
        with pytest.raises(ChannelError, match="'arm' is in use by another bus: take another name"):
            run_processes(short, "arm")
        assert channel.names() == ["arm"]
    finally:
        listener.close()


def test_a_stale_channel_is_replaced(short: Scenario) -> None:
    bus = subprocess.Popen([sys.executable, "-m", "hil", "bus", "arm"], stdout=subprocess.PIPE, text=True)
    try:
        assert bus.stdout is not None
        bus.stdout.readline()
        assert channel.names() == ["arm"]
    finally:
        bus.kill()
        bus.communicate()
    assert channel.socket_path("arm").exists()
    assert channel.names() == []
    with pytest.raises(ChannelError, match="no bus is running there"):
        client.join("arm", "nobody", timed=False)
    assert run_processes(short, "arm").log.frames


def test_five_nodes_by_hand_make_the_frames_of_the_rig(hil: Any) -> None:
    """`hil bus`, `hil node` five times, python-can as the witness."""
    bus = hil.start("bus", "arm", "--expect", "plant,dsp,joint1,joint2,joint3")
    assert "waiting for plant, dsp, joint1, joint2, joint3" in bus.stdout.readline()
    witness = can.Bus(interface="hil", channel="arm", name="witness")
    nodes = [
        hil.start("node", *words) for words in (["joint", "2"], ["plant"], ["joint", "1"], ["joint", "3"], ["dsp"])
    ]
    frames = []
    try:
        while (message := witness.recv(LIMIT_S)) is not None:
            frames.append((round(message.timestamp * 1e9), message.arbitration_id, bytes(message.data)))
            if message.arbitration_id == 0x010:
                break
    finally:
        witness.shutdown()
    for node in nodes:
        out, err = node.communicate(timeout=LIMIT_S)
        assert node.returncode == 0, err
        assert "the run is over; nothing was lost, missed or saturated" in out
    expected = [frame[:3] for frame in run_inline(scenario_file.load("paper-joint")).log.frames]
    assert [frame for frame in frames if frame[0] >= 0] == expected
    bus.send_signal(signal.SIGINT)
    bus.communicate(timeout=LIMIT_S)
    assert bus.returncode == 0


def test_nodes_by_hand_say_when_the_run_did_not_come_to_its_end(hil: Any) -> None:
    bus = hil.start("bus", "arm", "--expect", "plant,dsp,joint1,joint2,joint3")
    bus.stdout.readline()
    words = {"plant": ["plant"], "dsp": ["dsp"], **{f"joint{n}": ["joint", str(n)] for n in (1, 2, 3)}}
    nodes = {name: hil.start("node", *each, "--set", "duration_s=30") for name, each in words.items()}
    wait_for(lambda: "time begins" in bus.stdout.readline())
    joined = waits(nodes["joint2"].pid)
    wait_for(lambda: waits(nodes["joint2"].pid) > joined)
    nodes["joint2"].kill()
    for name in nodes.keys() - {"joint2"}:
        _, err = nodes[name].communicate(timeout=LIMIT_S)
        assert nodes[name].returncode == NodeError.exit_code
        assert f"hil: {name}: the bus ended in the middle of the run: joint2 is gone" in err
    bus.send_signal(signal.SIGTERM)
    out, err = bus.communicate(timeout=LIMIT_S)
    assert "session ended" in out
    assert (bus.returncode, err) == (143, "hil: SIGTERM: everything was ended\n")


def test_a_node_that_is_killed_on_a_bus_that_goes_on_brakes_the_arm(hil: Any) -> None:
    """Within three periods (tests/hil/test_link_loss.py), and one that comes again is refused."""
    bus = hil.start("bus", "arm", "--expect", "plant,dsp,joint1,joint2,joint3", "--go-on")
    bus.stdout.readline()
    words = {"plant": ["plant"], "dsp": ["dsp"], **{f"joint{n}": ["joint", str(n)] for n in (1, 2, 3)}}
    nodes = {name: hil.start("node", *each, "--set", "duration_s=30") for name, each in words.items()}
    wait_for(lambda: "time begins" in bus.stdout.readline())
    wait_for(lambda: in_the_middle(nodes["joint2"].pid))
    nodes["joint2"].kill()
    _, err = nodes["plant"].communicate(timeout=LIMIT_S)
    assert err == "hil: plant: no Current of joint2 for 3 periods: brakes engaged\n"
    for name in ("dsp", "joint1", "joint3"):
        nodes[name].communicate(timeout=LIMIT_S)
        assert nodes[name].returncode is not None


def test_a_node_refuses_a_bus_whose_time_has_begun(hil: Any) -> None:
    bus = hil.start("bus", "arm")
    bus.stdout.readline()
    node = hil.run("node", "plant")
    assert node.returncode == ChannelError.exit_code
    assert "a bus that waits for its clients is started with --expect" in node.stderr


def test_two_runs_at_the_same_time_leave_two_folders(hil: Any, short_settings: list[str]) -> None:
    runs = [hil.start("run", "--inline", *short_settings) for _ in range(2)]
    for run in runs:
        _, err = run.communicate(timeout=LIMIT_S)
        assert run.returncode == 0, err
    assert len(list((hil.folder / "runs").iterdir())) == 2


def test_an_observer_stays_from_session_to_session(hil: Any) -> None:
    """It hears, and has room in its transmit queue of ten, in each."""
    bus = hil.start("bus", "arm", "--expect", "dsp")
    bus.stdout.readline()
    witness = can.Bus(interface="hil", channel="arm", name="witness")
    witness.state = can.BusState.ACTIVE  # it acknowledges: where clients are expected, who says nothing only listens
    try:
        for _ in range(2):
            for number in range(8):
                witness.send(can.Message(arbitration_id=0x700 + number, is_extended_id=False))
            # alone, the DSP hears no encoder, and says Stop after three cycles
            assert hil.run("node", "dsp").returncode == FaultError.exit_code
            while witness.recv(LIMIT_S).arbitration_id != 0x010:
                pass
    finally:
        witness.shutdown()


def test_the_log_s_hash_is_over_the_canonical_records() -> None:
    """Independently written down: struct "<qIBB" and the data, from cycle 0 on."""
    import hashlib
    import struct

    log = FrameLog()
    log.watch(-1, 0x80, b"\xff", "dsp")
    log.watch(55_000, 0x80, b"\x00", "dsp")
    log.watch(77_000, 0x80000000 | 0x40000000 | 0x12345, bytes(3), "somebody")
    records = struct.pack("<qIBB", 55_000, 0x80, 0, 1) + b"\x00" + struct.pack("<qIBB", 77_000, 0x12345, 3, 3)
    assert log.sha256() == hashlib.sha256(records).hexdigest()
