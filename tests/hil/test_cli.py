"""The command line as a user meets it: what it prints, where, and how it ends."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import can
import pytest

from hil import scenario_file
from hil.wire import channel, client

NUMBERS = (
    "simulated_s", "wall_s", "startup_s", "cycles", "frames", "lost_frames", "deadline_misses", "saturations",
    "bus_load", "peak_command_speed_m_s",
)  # fmt: skip
TEXTS = ("scenario", "clock", "fidelity", "mode", "frame_log_sha256")
FIGURES = ("response", "deviation", "task-space", "disturbance")
PER_JOINT = ("max_deviation_rad", "final_deviation_rad")
PER_AXIS = ("max_velocity_deviation_m_s", "max_position_deviation_m")


def test_json_prints_one_object_and_nothing_else(hil: Any, short_settings: list[str]) -> None:
    run = hil.run("run", "--json", *short_settings)
    assert run.returncode == 0, run.stderr
    summary = json.loads(run.stdout)
    assert run.stdout.count("\n") == 1
    assert all(isinstance(summary[key], int | float) for key in NUMBERS)
    assert all(isinstance(summary[key], str) for key in TEXTS)
    assert all(len(summary[key]) == 3 for key in PER_JOINT)
    assert all(len(summary[key]) == 2 for key in PER_AXIS)
    assert summary["faults"] == []
    assert (summary["mode"], summary["clock"], summary["fidelity"]) == ("processes", "virtual", "bits")
    assert (summary["cycles"], summary["simulated_s"]) == (200, 0.2)
    assert not (hil.folder / "runs").exists()


def test_inline_and_processes_agree_on_everything_but_time(hil: Any, short_settings: list[str]) -> None:
    one, other = (json.loads(hil.run("run", "--json", *mode, *short_settings).stdout) for mode in ([], ["--inline"]))
    own = {"mode", "wall_s", "startup_s", "processes"}
    assert {key: value for key, value in one.items() if key not in own} == {
        key: value for key, value in other.items() if key not in own
    }


def test_a_run_prints_a_table_and_leaves_a_folder(hil: Any, short_settings: list[str]) -> None:
    run = hil.run("run", "--inline", *short_settings)
    assert run.returncode == 0, run.stderr
    assert "joint deviation, urad" in run.stdout
    assert "observer off" in run.stdout
    (folder,) = (hil.folder / "runs").iterdir()
    assert f"run folder: runs/{folder.name}" in run.stdout
    assert {path.name for path in folder.iterdir()} == {
        "scenario.toml", "frames.log", "arm.dbc", "signals.parquet", "summary.json",
        *(f"{figure}.png" for figure in FIGURES), *(f"{figure}.svg" for figure in FIGURES),
    }  # fmt: skip


def test_a_run_folder_runs_again_to_the_same_frames(hil: Any, short_settings: list[str]) -> None:
    first = json.loads(hil.run("run", "--inline", "--json", "--out", "first", *short_settings).stdout)
    again = json.loads(hil.run("run", "first/scenario.toml", "--inline", "--json").stdout)
    assert first["frame_log_sha256"] == again["frame_log_sha256"]


def test_scenarios_lists_one_a_line(hil: Any) -> None:
    listed = hil.run("scenarios").stdout.splitlines()
    assert [line.split()[0] for line in listed] == scenario_file.builtin_names()
    assert all(len(line.split()) > 3 for line in listed)


FAULTY = """
from firmware_py.joint_cpu import JointCPU
class Broken(JointCPU):
    def control(self, count, a_ref):
        return 1 // 0, 0
class Blind(JointCPU):
    def _reference(self, cycle):
        return None if cycle == 150 or self.strikes else super()._reference(cycle)
class Deaf(JointCPU):
    def _take_parameter(self):
        return []
class Wild(JointCPU):
    def control(self, count, a_ref):
        return 40000, 0
class Unborn(JointCPU):
    def __init__(self, *settings):
        raise RuntimeError("no")
class Quitter(JointCPU):
    def on_frame(self, identifier, data, now_ns):
        busy_ns, timer_ns, sends = super().on_frame(identifier, data, now_ns)
        stop = [(0, 0x010, b"" if now_ns < 50_000_000 else b"\\x00")] if now_ns > 40_000_000 else []
        return busy_ns, timer_ns, sends + stop
class Late(JointCPU):
    def on_frame(self, identifier, data, now_ns):
        return 0, now_ns - 1, []
"""


@pytest.mark.parametrize("mode", [["--inline"], []])
@pytest.mark.parametrize(
    ("words", "exit_code", "message"),
    [
        (["nope"], 3, r"no scenario 'nope': built in are .*load-step, .*paper-joint, paper-task"),
        (["--set", "joint.obsever=1"], 3, r"unknown key joint.obsever: did you mean joint.observer\?"),
        (["paper-task", "--set", "trajectory.radius_m=0.5"], 3, r"puts the wrist .* m from the base"),
        (["--set", "joint2.cpu=faulty:Broken"], 5, r"joint2 .*faulty.py, line 5: ZeroDivisionError"),
        (["--set", "joint2.cpu=faulty:Unborn"], 5, r"joint2 failed in .*faulty.py, line \d+: RuntimeError: no"),
        (["--set", "joint2.cpu=broken:Syntax"], 3, r"joint2.cpu = 'broken:Syntax': SyntaxError: .*write python, i8086"),
        (["--set", "joint2.cpu=faulty:Wild"], 5, r"joint2 .*Current_2.Reference: raw value 40000 is outside"),
        (["--set", "joint2.cpu=faulty:Late"], 5, r"joint2.*timer asked for at .* ask for a later instant"),
        (["--set", "joint2.cpu=faulty:Blind"], 6, r"at 0.15\d s: joint2: joint fault \(reference lost\)"),
        (["--set", "joint2.cpu=faulty:Quitter"], 6, r"at 0.05\d s: joint2: Stop before the end"),
        (["--set", "joint2.cpu=faulty:Deaf"], 6, r"dsp: .*joint2 was not ready by cycle -2"),
        (["--out", "taken"], 7, r"run folder taken is there already: choose another --out, or remove it"),
        (["--out", "file"], 7, r"run folder file is there already"),
        (["--out", "file/below"], 7, r"run folder file/below: Not a directory"),
    ],
)
def test_each_family_of_errors_has_its_message_and_its_exit_code(
    mode: list[str], words: list[str], exit_code: int, message: str, hil: Any, short_settings: list[str]
) -> None:
    (hil.folder / "faulty.py").write_text(FAULTY)
    (hil.folder / "broken.py").write_text("class Syntax(:")
    (hil.folder / "taken").mkdir()
    (hil.folder / "taken" / "something").touch()
    (hil.folder / "file").touch()
    settings = [] if "paper-task" in words else short_settings
    run = hil.run("run", *mode, *words, *settings)
    assert run.returncode == exit_code, run.stderr
    assert re.search(message, run.stderr), run.stderr
    assert "Traceback" not in run.stdout + run.stderr
    assert not list(hil.folder.glob("**/.*.partial"))


@pytest.mark.parametrize(
    "words",
    [
        ["run", "--nonsense"],
        ["fly"],
        ["node", "joint", "x"],
        ["run", "--patience", "0"],
        ["bus", "--bitrate", "1"],
        ["bus", "--data-bitrate", "1"],
        ["bus", "--pace", "0"],
        ["bus", "--pace", "-1"],
        ["bus", "--seed", "-1"],
        ["clock", "arm", "stop"],
        ["clock", "arm", "step", "soon"],
        ["clock", "arm", "status", "pause", "step"],
    ],
)
def test_wrong_usage_ends_with_2(words: list[str], hil: Any) -> None:
    run = hil.run(*words)
    assert run.returncode == 2
    assert "Traceback" not in run.stderr


@pytest.mark.parametrize(
    ("words", "exit_code", "message"),
    [
        (["node", "plant", "-c", "nowhere"], 4, r"channel 'nowhere': no bus is running there; start one with `hil bus"),
        (["node", "plant", "-c", "no/where"], 4, r"channel 'no/where': a name has 1 to 41 letters"),
        (["node", "plant", "-i", "socketcan"], 4, r"interface 'socketcan', channel 'arm': "),
        (["node", "joint", "7"], 3, r"no node 'joint7': this scenario has plant, dsp, joint1, joint2, joint3"),
        (["node", "cook"], 3, r"no node 'cook'"),
        (["bus", "--bitrate", "300007"], 2, r"value: --bitrate 300007: a bit lasts 3333.256 ns, which is no whole"),
        (["bus", "--data-bitrate", "3000000"], 2, r"--data-bitrate 3000000: a bit lasts 333.333 ns, which is no whole"),
        (["bus", "--bitrate", "500000", "--data-bitrate", "250000"], 2, r"data bit rate 250000 is below the nominal"),
        (["bus", "arm", "no/where"], 4, r"channel 'no/where': a name has 1 to 41 letters"),
        (["bus", "--faults", "missing.toml"], 3, r"missing.toml"),
        (["clock", "nowhere"], 4, r"channel 'nowhere': no bus is running there; start one with `hil bus nowhere`"),
        (["clock", "arm", "pause", "3"], 2, r"pause 3.0: step and pace take a number from 1e-9 to 1e6, the others"),
        (["clock", "arm", "status", "3"], 2, r"status 3.0: step and pace take"),
        (["clock", "arm", "step", "0"], 2, r"step 0.0: step and pace take a number from 1e-9"),
        (["clock", "arm", "step", "nan"], 2, r"step nan: step and pace take"),
        (["clock", "arm", "pace", "2e6"], 2, r"pace 2000000.0: step and pace take"),
        (["bus", "--fidelity", "some"], 2, r"'some' is not one of 'bits',"),
        (["node", "joint"], 2, r"write plant, dsp, or joint N"),
    ],
)
def test_nodes_and_buses_refuse_what_cannot_be(words: list[str], exit_code: int, message: str, hil: Any) -> None:
    run = hil.run(*words)
    in_one_line = re.sub(r"[\s│]+", " ", run.stderr)
    assert (run.returncode, bool(re.search(message, in_one_line))) == (exit_code, True), run.stderr
    assert "Traceback" not in run.stderr


def clock(hil: Any, *words: str) -> dict[str, Any]:
    """Give the bus `arm` a command; return how it stands."""
    run = hil.run("clock", "arm", *words, "--json")
    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout.count("\n") == 1
    answer: dict[str, Any] = json.loads(run.stdout)
    return answer


def at(condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """Ask the bus `arm` until it stands so."""
    deadline = time.monotonic() + 60.0
    while not condition(status := client.control("arm", command="status")):
        assert time.monotonic() < deadline, status
        time.sleep(0.01)
    return status


@pytest.mark.parametrize("options", [["--pace", "1"], ["--pace", "0.5"], []])
def test_a_bus_is_paused_stepped_and_goes_on(options: list[str], hil: Any) -> None:
    hil.bus("arm", *options)
    before = at(lambda status: status["now_ns"] > 0)
    assert (before["paused"], before["pace"]) == (False, float(options[1]) if options else 1.0)
    paused = clock(hil, "pause")
    assert paused["paused"]
    assert clock(hil)["now_ns"] == paused["now_ns"] >= before["now_ns"]
    stepped_ns = paused["now_ns"] + 1_000_000
    assert clock(hil, "step", "0.001")["paused"]
    assert at(lambda status: status["now_ns"] >= stepped_ns)["now_ns"] == stepped_ns
    clock(hil, "step")
    assert at(lambda status: status["now_ns"] > stepped_ns)["now_ns"] == stepped_ns + 1_000_000
    assert not clock(hil, "continue")["paused"]
    at(lambda status: status["now_ns"] > stepped_ns + 50_000_000)


@pytest.mark.parametrize("options", [["--pace", "1"], []])
def test_a_bus_keeps_the_pace_that_it_is_told(options: list[str], hil: Any) -> None:
    hil.bus("arm", *options)
    assert clock(hil, "pace", "1000")["pace"] == 1000.0
    later = at(lambda status: status["now_ns"] > 100_000_000_000)
    assert later["pace"] == 1000.0
    assert clock(hil, "pace")["pace"] is None


def test_a_bus_says_whom_it_waits_for(hil: Any) -> None:
    hil.bus("arm", "--expect", "slow,late")
    assert clock(hil)["missing"] == ["slow", "late"]
    assert "not there yet: slow, late" in hil.run("clock").stdout
    slow, late = (can.Bus(interface="hil", channel="arm", name=name, timed=True) for name in ("slow", "late"))
    try:
        first = at(lambda status: status["waiting_for"] is not None)
        assert (first["waiting_for"]["name"], first["missing"], first["now_ns"]) == ("slow", [], 0)
        assert first["waiting_for"]["seconds"] > 0.0
        later = at(lambda status: status["waiting_for"]["seconds"] > first["waiting_for"]["seconds"])
        assert later["nodes"]["late"] == {
            "sent": 0, "received": 0, "repeated": 0, "lost": {}, "errors": {}, "tec": 0, "rec": 0,
            "state": "error-active", "channel": "arm",
        }  # fmt: skip
        shown = hil.run("clock", "arm", "status").stdout
        assert re.search(r"bus 'arm' at 0.000000 s, as fast as it goes\nwaiting for slow for \d+\.\d s\n", shown)
        assert re.search(r"late +│ arm +│ error-act", shown), shown
    finally:
        slow.shutdown()
        late.shutdown()


def test_a_session_of_two_timed_clients_is_stepped(hil: Any) -> None:
    """A client's frame is there when the step is long enough for it."""
    hil.bus("arm", "--expect", "a,b")
    clock(hil, "pause")
    a, b = (can.Bus(interface="hil", channel="arm", name=name, timed=True) for name in ("a", "b"))
    with ThreadPoolExecutor() as pool:
        a.send(can.Message(arbitration_id=0x100, is_extended_id=False))
        asked = [pool.submit(bus.recv, 0.01) for bus in (a, b)]
        at(lambda status: status["nodes"].keys() == {"a", "b"})
        clock(hil, "step", "0.00001")
        before = at(lambda status: status["now_ns"] == 10_000)
        assert [before["nodes"][name]["sent"] for name in "ab"] == [0, 0]
        clock(hil, "step", "0.001")
        after = at(lambda status: status["nodes"]["a"]["sent"] == 1)
        assert after["nodes"]["b"]["received"] == 1
        assert asked[1].result(60).arbitration_id == 0x100
        clock(hil, "continue")
        left = pool.submit(b.shutdown)
        assert asked[0].result(60) is None
        a.shutdown()
        left.result(60)


def test_one_bus_command_serves_several_channels_in_one_time(hil: Any) -> None:
    bus = hil.bus("arm leg arm", "--pace", "1")
    assert "bus 'arm', 'leg': open to everybody" in bus.stdout.readline()
    stopped = clock(hil, "pause")
    leg = hil.run("clock", "leg", "--json")
    assert json.loads(leg.stdout)["now_ns"] == stopped["now_ns"]
    assert json.loads(leg.stdout)["paused"]
    bus.send_signal(signal.SIGINT)
    out, err = bus.communicate(timeout=60)
    assert (bus.returncode, out, err) == (0, "bus 'arm', 'leg': ended\n", "")


def test_a_second_bus_on_one_of_the_channels_is_refused_and_leaves_the_others(hil: Any) -> None:
    hil.bus("arm")
    run = hil.run("bus", "leg", "arm")
    assert run.returncode == 4
    assert "channel 'arm' is in use by another bus" in run.stderr
    assert channel.names() == ["arm"]


def test_a_client_that_dies_is_removed_where_the_bus_is_told_to_go_on(hil: Any) -> None:
    hil.bus("arm", "--expect", "a,b", "--go-on")
    a, b = (can.Bus(interface="hil", channel="arm", name=name, timed=True) for name in ("a", "b"))
    with ThreadPoolExecutor() as pool:
        asked = pool.submit(b.recv, 0.01)
        a._connection.close()
        assert asked.result(60) is None
    status = clock(hil)
    assert status["died"] == ["a is gone: its connection to the bus broke"]
    assert "removed: a is gone" in hil.run("clock").stdout
    b.shutdown()


def test_a_node_refuses_a_bus_of_another_rate(hil: Any) -> None:
    bus = hil.start("bus", "arm", "--expect", "plant", "--bitrate", "500000")
    bus.stdout.readline()
    run = hil.run("node", "plant")
    assert run.returncode == 5
    assert "runs with bit_ns = 2000, the scenario wants 1000: start the bus with the same --bitrate" in run.stderr


@pytest.mark.skipif(os.geteuid() != 0, reason="mounting a small file system takes root")
def test_a_full_disk_ends_with_one_message_and_no_folder(hil: Any) -> None:
    """A real file system of 256 KiB."""
    disk = hil.folder / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", disk], capture_output=True).returncode:
        pytest.skip("this machine does not let us mount a tmpfs")
    try:
        run = hil.run("run", "--inline", "--out", str(disk / "run"), "--set", "duration_s=3")
        assert run.returncode == 7
        assert re.search(r"hil: run folder .*: No space left on device; nothing was kept", run.stderr)
        assert "Traceback" not in run.stderr
        assert list(disk.iterdir()) == []
    finally:
        subprocess.run(["umount", disk], check=True)


@pytest.mark.parametrize("words", [["scenarios"], ["run", "--inline", "--json"], ["run", "--help"]])
def test_standard_output_that_takes_nothing_is_an_error_of_its_own(words: list[str], hil: Any) -> None:
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "hil", *words]
        run = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, cwd=hil.folder, timeout=120)
    assert (run.returncode, run.stderr) == (7, "hil: standard output: No space left on device: send it elsewhere\n")


def test_a_folder_of_the_user_s_beside_the_run_folder_is_left_alone(hil: Any, short_settings: list[str]) -> None:
    mine = hil.folder / "x.partial" / "mine"
    mine.parent.mkdir()
    mine.touch()
    assert hil.run("run", "--inline", "--out", "x", *short_settings).returncode == 0
    assert {path.name for path in hil.folder.iterdir()} == {"x", "x.partial"}
    assert mine.exists()


def test_saturations_are_named_by_node_and_signal(hil: Any, short_settings: list[str]) -> None:
    run = hil.run("run", "--inline", "--set", "drive.limit_A=0.5", *short_settings)
    assert re.search(r"saturations by signal: .*plant amplifier joint1: \d+", run.stdout)


def test_without_the_report_extra_the_cure_is_named(hil: Any, short_settings: list[str]) -> None:
    """An interpreter that has no pyarrow: a package of that name in the way which cannot be imported."""
    (hil.folder / "pyarrow.py").write_text("raise ImportError('not here')")
    run = hil.run("run", "--inline", "--out", "x", *short_settings)
    assert run.returncode == 8
    assert "pip install 'hil[report]'" in run.stderr
    assert list(hil.folder.iterdir()) == [hil.folder / "pyarrow.py"]


def test_a_user_s_own_controller_plays_a_joint(hil: Any, short_settings: list[str]) -> None:
    """The example of the README, under 30 lines, as it stands."""
    example = Path(__file__).parents[2] / "examples" / "pd_joint.py"
    assert len(example.read_text().splitlines()) <= 30
    (hil.folder / "pd_joint.py").write_text(example.read_text())
    own = ["--set", "joint2.cpu=pd_joint:SpeedDamping"]
    summaries = [
        json.loads(hil.run("run", "--json", *mode, *own, *short_settings).stdout) for mode in ([], ["--inline"])
    ]
    plain = json.loads(hil.run("run", "--json", "--inline", *short_settings).stdout)
    assert summaries[0]["frame_log_sha256"] == summaries[1]["frame_log_sha256"] != plain["frame_log_sha256"]
    assert summaries[0]["faults"] == []
