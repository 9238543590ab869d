"""Runs by the Sync frame on an interface without shared time: real processes over real sockets.

The interface is `hil` itself, with all nodes as its observers on an open bus: to python-can one interface like another.
"""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest

from hil import scenario_file
from hil.bus_rig import run_on_bus
from hil.can_node import Place
from hil.can_port import CanPort, _refusal
from hil.errors import ChannelError, NodeError, ScenarioError
from hil.rig import run_inline
from hil.wire import channel as channels
from tests.conftest import SHORT

PLACE = Place("hil", "street", {})
LIMIT_S = 60


def wait_for(condition: Callable[[], Any]) -> Any:
    deadline = time.monotonic() + LIMIT_S
    while not (found := condition()):
        assert time.monotonic() < deadline, "waited too long"
        time.sleep(0.02)
    return found


@pytest.fixture
def street(hil: Any) -> Any:
    """An open bus that knows nothing of robots."""
    return hil.bus("street")


def data_of(frames: Any) -> dict[int, list[bytes]]:
    found = defaultdict(list)
    for _, identifier, data, _ in frames:
        found[identifier].append(data)
    return found


def functional(*settings: str) -> Any:
    return run_inline(scenario_file.load("paper-joint", ["bus.fidelity=functional", *settings]))


@pytest.mark.usefixtures("street")
def test_payloads_and_summary_are_those_of_functional(hil: Any) -> None:
    words = [word for setting in SHORT for word in ("--set", setting)]
    run = hil.run("run", "-i", "hil", "-c", "street", "--clock", "sync", "--json", "--out", "out", *words)
    assert run.returncode == 0, run.stderr
    summary = json.loads(run.stdout)
    expected = functional(*SHORT)
    log = list(can.LogReader(str(hil.folder / "out" / "frames.log")))
    found = defaultdict(list)
    for message in log:
        found[message.arbitration_id].append(bytes(message.data))
    assert found == data_of(expected.log.frames)
    inline = json.loads(hil.run("run", "--inline", "--json", "--set", "bus.fidelity=functional", *words).stdout)
    for key in ("cycles", "max_deviation_rad", "final_deviation_rad", "faults", "saturations", "deadline_misses"):
        assert summary[key] == inline[key]
    assert (summary["clock"], summary["mode"]) == ("sync", "sync")
    assert summary["lost_frames"] == 0


@pytest.mark.usefixtures("street")
def test_external_joint_is_announced_waited_for_and_changes_nothing(hil: Any) -> None:
    words = [word for setting in SHORT for word in ("--set", setting)]
    rig = hil.start("run", "-i", "hil", "-c", "street", "--clock", "sync", "--json", "--out", "out", *words,
                    "--external", "joint2")  # fmt: skip
    said = ""
    while "waiting for joint2" not in said:  # somebody takes a while to plug the board in
        line = rig.stderr.readline()
        assert line, said
        said += line
    board = hil.run("node", "joint", "2", "-c", "street", "--set", "clock.kind=sync", *words)
    out, err = rig.communicate(timeout=LIMIT_S)
    assert rig.returncode == 0, err
    assert board.returncode == 0, board.stderr
    text = " ".join(said.split())
    assert "joint2 is external: waiting for it; it answers Encoder_2; by Sync; one period is 1 ms" in text
    assert "Encoder_2 0x102 (4 B, every 1 ms), AccelRef 0x130 (8 B, every 1 ms), Parameter_2 0x302 (5 B)" in text
    assert "sends Stop 0x010 (1 B), Current_2 0x122 (6 B, every 1 ms), Acknowledge_2 0x312 (7 B)" in text
    assert json.loads(out)["max_deviation_rad"] == summary_of(functional(*SHORT))["max_deviation_rad"]


def summary_of(outcome: Any) -> Any:
    from hil.evaluate import evaluate
    from hil.summary import summarise

    return summarise(outcome, evaluate(outcome), 0.0)


@pytest.mark.usefixtures("street")
def test_joint_that_is_stopped_for_a_while_holds_the_robot_still_and_changes_nothing(hil: Any) -> None:
    rig = hil.start("run", "-i", "hil", "-c", "street", "--clock", "sync", "--json", "--set", "duration_s=1.0")
    witness = CanPort("hil", "street", {0x080})
    pid = wait_for(lambda: node_of(rig.pid, "joint1"))
    for byte in (b"\xff", b"\x80"):  # the last cycle of the set-up, then cycle 128
        while wait_for(lambda: witness.receive(1.0)) != (0x080, byte):
            pass
    os.kill(pid, signal.SIGSTOP)
    witness.close()
    time.sleep(1.5)
    assert rig.poll() is None
    os.kill(pid, signal.SIGCONT)
    out, err = rig.communicate(timeout=LIMIT_S)
    assert rig.returncode == 0, err
    expected = summary_of(functional("duration_s=1.0"))
    assert json.loads(out)["final_deviation_rad"] == expected["final_deviation_rad"]


def node_of(rig: int, name: str) -> int | None:
    for line in Path(f"/proc/{rig}/task/{rig}/children").read_text().split():
        words = Path(f"/proc/{line}/cmdline").read_bytes().split(b"\0")
        if name.encode() in words:
            return int(line)
    return None


@pytest.mark.usefixtures("street")
def test_killed_node_ends_the_run_with_its_name_and_a_stop(hil: Any) -> None:
    witness = CanPort("hil", "street", {0x010})
    rig = hil.start("run", "-i", "hil", "-c", "street", "--clock", "sync", "--json", "--set", "duration_s=30")
    os.kill(wait_for(lambda: node_of(rig.pid, "joint3")), signal.SIGKILL)
    _, err = rig.communicate(timeout=LIMIT_S)
    assert rig.returncode == 5
    assert "joint3 was killed by SIGKILL" in err
    assert wait_for(lambda: witness.receive(1.0)) == (0x010, b"\x01")
    witness.close()


@pytest.mark.usefixtures("street")
def test_patience_ends_a_run_that_waits_for_a_board_and_names_it() -> None:
    said: list[str] = []
    scenario = scenario_file.load("paper-joint", SHORT)
    with pytest.raises(NodeError, match=r"joint2 has not answered for [0-9]+ s \(limit 2 s\)"):
        run_on_bus(scenario, PLACE, ["joint2"], notice=said.append, patience_s=2.0)
    assert any("waiting for joint2" in text for text in said)


@pytest.mark.usefixtures("street")
def test_stop_from_anybody_stops_the_arm(hil: Any) -> None:
    """As `cansend street 010#01`."""
    rig = hil.start("run", "-i", "hil", "-c", "street", "--clock", "sync", "--json", "--set", "duration_s=30")
    witness = CanPort("hil", "street", {0x080})
    while wait_for(lambda: witness.receive(1.0)) != (0x080, b"\x10"):
        pass
    witness.send(0x010, b"\x01")
    _, err = rig.communicate(timeout=LIMIT_S)
    witness.close()
    assert rig.returncode == 6
    assert "operator" in err


@pytest.mark.usefixtures("street")
def test_ctrl_c_stops_the_arm_and_leaves_no_process(hil: Any, children_of: Any) -> None:
    witness = CanPort("hil", "street", {0x010})
    rig = hil.start("run", "-i", "hil", "-c", "street", "--clock", "sync", "--json", "--set", "duration_s=30")
    wait_for(lambda: node_of(rig.pid, "dsp"))
    children = children_of(rig.pid)
    rig.send_signal(signal.SIGINT)
    rig.communicate(timeout=LIMIT_S)
    assert rig.returncode == 130
    assert wait_for(lambda: witness.receive(1.0)) == (0x010, b"\x01")
    witness.close()
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in children))


def test_node_whose_rig_is_gone_ends_by_itself(hil: Any, street: Any, children_of: Any) -> None:
    rig = hil.start("run", "-i", "hil", "-c", "street", "--clock", "sync", "--json", "--external", "joint1")
    wait_for(lambda: node_of(rig.pid, "dsp"))
    children = children_of(rig.pid)
    rig.kill()
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in children))
    assert street.poll() is None


def test_board_left_in_run_by_a_killed_rig_is_stopped_before_the_next_set_up(
    hil: Any, street: Any, children_of: Any
) -> None:
    """And a board that waits for its first set-up goes on waiting: that Stop is not for it."""
    words = ["-c", "street", "--set", "clock.kind=sync"]
    board = hil.start("node", "joint", "2", *words)
    rig = hil.start("run", "-i", "hil", *words, "--json", "--external", "joint2", "--set", "duration_s=30")
    witness = CanPort("hil", "street", {0x080})
    for byte in (b"\xff", b"\x10"):  # the last cycle of the set-up, then cycle 16
        while wait_for(lambda: witness.receive(1.0)) != (0x080, byte):
            pass
    witness.close()
    nodes = children_of(rig.pid)
    rig.kill()
    rig.communicate()
    wait_for(lambda: not any(Path(f"/proc/{pid}").exists() for pid in nodes))
    assert board.poll() is None
    waiting = hil.start("node", "joint", "2", *words, *(word for setting in SHORT for word in ("--set", setting)))
    assert "joint2 of paper-joint" in waiting.stdout.readline()
    time.sleep(2.0)  # until it listens; it says nothing when it does
    outcome = run_on_bus(scenario_file.load("paper-joint", SHORT), PLACE, ["joint2"], patience_s=20.0)
    assert data_of(outcome.log.frames) == data_of(functional(*SHORT).log.frames)
    _, complaint = board.communicate(timeout=LIMIT_S)
    assert board.returncode == 6
    assert "joint2: stopped" in complaint
    waiting.communicate(timeout=LIMIT_S)
    assert waiting.returncode == 0
    assert street.poll() is None


REFUSED = {
    ("-i", "socketcan"): (2, "--interface socketcan needs --channel"),
    ("-i", "socketcan", "-c", "no0", "--bus-kwargs", "[1]"): (2, "write a JSON object"),
    ("-i", "socketcan", "-c", "no0", "--bus-kwargs", '{"channel": "no1"}'): (2, "use --interface and --channel"),
    ("-i", "nonsense", "-c", "x"): (4, "interface 'nonsense', channel 'x'"),
    ("-i", "nonsense", "-c", "can0"): (4, "python-can has canalystii, cantact"),
    ("-i", "kvaser", "-c", "0"): (4, "what drives it is not installed here: see 'kvaser' in python-can's"),
    ("-i", "hil", "-c", "x", "--clock", "sync", "--bus-kwargs", '{"bitrate": "fast"}'): (4, "'fast'"),
    ("-i", "socketcand", "-c", "can0", "--bus-kwargs", '{"hots": "x"}'): (
        4,
        "check --bus-kwargs: they are keywords of",
    ),
    ("-i", "hil", "-c", "nobody", "--clock", "sync"): (4, "no bus is running there"),
    ("-i", "hil", "-c", "nobody", "--clock", "sync", "--inline"): (2, "leave --inline out"),
    ("--external", "joint2"): (2, "--external and --at need a bus"),
    ("-i", "hil", "-c", "x", "--clock", "sync", "--external", "joint9"): (3, "no node 'joint9'"),
    ("-i", "hil", "-c", "x", "--clock", "sync", "--at", "joint1"): (2, "write NODE=CHANNEL"),
}


@pytest.mark.parametrize("words", REFUSED, ids=" ".join)
def test_what_cannot_be_is_refused_with_the_cure(words: tuple[str, ...], hil: Any) -> None:
    run = hil.run("run", *words)
    exit_code, message = REFUSED[words]
    assert run.returncode == exit_code, run.stderr
    assert message in " ".join(run.stderr.replace("│", " ").split())


CURES = {
    errno.ENODEV: ("No such device", "`ip link` lists those there are; `sudo ip link add dev vcan9 type vcan`"),
    errno.ENETDOWN: ("Network is down", "`sudo ip link set vcan9 up`"),
    errno.EPERM: ("Operation not permitted", "a container or a security policy forbids it"),
    errno.EACCES: ("Permission denied", "a serial adapter belongs to a group"),
    errno.EAFNOSUPPORT: ("Address family not supported by protocol", "load can_raw"),
}


@pytest.mark.parametrize("number", CURES)
def test_what_the_kernel_refuses_has_its_cure(number: int) -> None:
    """As the kernel says it; python-can passes it on as it is, or in an error of its own."""
    said, cure = CURES[number]
    for error in (OSError(number, os.strerror(number)), can.CanInitializationError(said, number)):
        text = _refusal("socketcan", "vcan9", error)
        assert text.startswith("interface 'socketcan', channel 'vcan9': ")
        assert said in text
        assert cure in text


@pytest.mark.skipif(os.path.exists("/sys/class/net/vcan0"), reason="there is SocketCAN here")
def test_interface_that_is_not_there_says_what_is_missing() -> None:
    with pytest.raises(ChannelError, match="interface 'socketcan', channel 'vcan9'"):
        CanPort("socketcan", "vcan9", None)


def test_nodes_on_two_channels_with_a_bridge_between_them_are_one_robot(hil: Any) -> None:
    """python-can's own bridge carries the frames; the rig and its nodes do not know of it."""
    hil.bus("here there")
    bridge = hil.program("can.bridge", "--bus1-interface", "hil", "--bus1-channel", "here",
                         "--bus2-interface", "hil", "--bus2-channel", "there")  # fmt: skip
    scenario = scenario_file.load("paper-joint", SHORT)
    elsewhere = {"joint1": "there", "joint3": "there"}
    time.sleep(2.0)  # until the bridge listens; it says nothing when it does
    outcome = run_on_bus(scenario, Place("hil", "here", {}), elsewhere=elsewhere, patience_s=20.0)
    bridge.terminate()
    assert data_of(outcome.log.frames) == data_of(functional(*SHORT).log.frames)


def test_unknown_external_node_is_refused() -> None:
    with pytest.raises(ScenarioError, match="no node 'joint4'"):
        run_on_bus(scenario_file.load("paper-joint"), PLACE, ["joint4"])


class FullQueue:
    """A bus whose queue takes a frame at the third try."""

    def __init__(self, error: can.CanError) -> None:
        self.error, self.tries = error, 0

    def send(self, _message: can.Message) -> None:
        self.tries += 1
        if self.tries % 3:
            raise self.error


@pytest.mark.usefixtures("street")
def test_full_queue_is_waited_for_and_counted_and_another_error_is_not() -> None:
    port = CanPort("hil", "street", None)
    real, port.bus = port.bus, FullQueue(can.CanOperationError("Transmit buffer full", error_code=105))  # type: ignore[assignment]
    port.send(0x100, b"")
    port.send(0x100, b"")
    assert port.retries == 4
    port.bus = FullQueue(can.CanOperationError("Network is down", error_code=100))  # type: ignore[assignment]
    with pytest.raises(NodeError, match=r"cannot send 0x100: Network is down.*ip link set street up"):
        port.send(0x100, b"")
    port.bus = real
    port.close()


def test_two_rigs_on_one_bus_see_each_other(hil: Any, street: Any) -> None:
    """Another sender of our identifiers: the run ends, and says so, or is left alone; it never hangs."""
    assert street.poll() is None
    assert channels.names() == ["street"]
    words = [
        "run",
        "-i",
        "hil",
        "-c",
        "street",
        "--clock",
        "sync",
        "--json",
        "--patience",
        "5",
        "--set",
        "duration_s=0.2",
    ]
    rigs = [hil.start(*words) for _ in range(2)]
    codes = [rig.communicate(timeout=LIMIT_S) and rig.returncode for rig in rigs]
    assert all(code in (0, 4, 5, 6) for code in codes)


def test_module_says_how_it_is_started() -> None:
    run = subprocess.run([sys.executable, "-m", "hil.can_node"], capture_output=True, text=True, check=False)
    assert run.returncode != 0


@pytest.mark.usefixtures("street")
def test_other_traffic_on_the_bus_hides_no_dead_node(hil: Any) -> None:
    """Frames that are none of ours, more often than the rig looks around."""
    rig = hil.start("run", "-i", "hil", "-c", "street", "--clock", "sync", "--json", "--set", "duration_s=30")
    with can.Bus(interface="hil", channel="street") as other:
        other.send_periodic(can.Message(arbitration_id=0x700, is_extended_id=False), 0.02)
        os.kill(wait_for(lambda: node_of(rig.pid, "joint3")), signal.SIGKILL)
        _, err = rig.communicate(timeout=LIMIT_S)
    assert rig.returncode == 5
    assert "joint3 was killed by SIGKILL" in err
