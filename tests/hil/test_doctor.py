"""`hil doctor`: what `ip -json -details -statistics link show` says, judged; and the command, end to end.

links/ holds what iproute2 6.1 prints: of vcan0 and of a Kvaser PCI card (SJA1000), under Linux 6.1; bus-off.json is
can0.json with the words and counters of a controller that went off, which an emulated card does not.
"""

import errno
import json
import os
import socket
import subprocess
from collections import Counter
from pathlib import Path
from typing import Any

import can
import pytest

from dbc.compiler import load_arm
from hil import scenario_file
from hil.can_node import Place
from hil.can_port import CanPort
from hil.doctor import link as links
from hil.doctor import link_checks, machine, traffic
from hil.doctor.examine import check_rate, examine
from hil.doctor.finding import Finding, worst
from hil.doctor.link import Link, from_ip, from_sysfs, read_link
from hil.doctor.machine import Machine
from hil.scenario import Scenario

RECORDED = Path(__file__).parent / "links"
TIMING = (
    '"bittiming":{"bitrate":1000000,"sample_point":"0.750",'
    '"tq":125,"prop_seg":2,"phase_seg1":3,"phase_seg2":2,"sjw":1,"brp":1}'
)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return scenario_file.load("paper-joint")


def recorded(name: str, *changes: tuple[str, str]) -> Link:
    """Return the interface of a recording, with words of its text replaced."""
    text = (RECORDED / f"{name}.json").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return from_ip(text)


def judged(link: Link, scenario: Scenario) -> dict[str, Finding]:
    return {finding.name: finding for finding in link_checks.check_link(link, scenario)}


# -- interfaces of Linux --


def test_healthy_interface_has_nothing_to_mend(scenario: Scenario) -> None:
    found = judged(recorded("can0"), scenario)
    assert {finding.verdict for finding in found.values()} == {"ok"}
    assert not any(finding.cure for finding in found.values())
    assert found["bit rate"].value == "1000000 bit/s"
    assert found["sample point"].value == "75.0%"
    assert found["error counters"].value == "transmit 0, receive 0"
    assert found["restart-ms"].value == "100 ms"
    assert found["txqueuelen"].value == "10 frames, up to 1.3 ms"


AGAIN = "sudo ip link set can0 down; "
SET_UP = (
    f"{AGAIN}sudo ip link set can0 type can bitrate 1000000 sample-point 0.8 restart-ms 100; sudo ip link set can0 up"
)
WRONG = {
    ("500k", "bit rate"): ("bad", "500000 bit/s", SET_UP),
    ("500k", "sample point"): ("ok", "87.5%", ""),
    ("listen-only", "controller"): ("bad", "LISTEN-ONLY", AGAIN + "sudo ip link set can0 type can listen-only off"),
    ("restart-0", "restart-ms"): ("warn", "it stays off", AGAIN + "sudo ip link set can0 type can restart-ms 100"),
    ("down", "up"): ("bad", "down", "sudo ip link set can0 up"),
    ("down", "error state"): ("bad", "STOPPED", "sudo ip link set can0 up"),
    ("bus-off", "error state"): ("bad", "BUS-OFF", "sudo ip link set can0 down; sudo ip link set can0 up"),
    ("bus-off", "error counters"): ("bad", "transmit 248, receive 0, restarts 2 times, bus error 1041", "bit rate"),
    ("bus-off", "lost frames"): ("warn", "sent, dropped 3", "went down, or bus-off"),
    ("vcan0-down", "up"): ("bad", "down", "sudo ip link set vcan0 up"),
    ("lo", "interface"): ("bad", "lo is not CAN", "`ip link` lists"),
}


@pytest.mark.parametrize(("name", "check"), WRONG, ids=" ".join)
def test_each_trouble_has_its_verdict_and_cure(name: str, check: str, scenario: Scenario) -> None:
    finding = judged(recorded(name), scenario)[check]
    verdict, value, cure = WRONG[name, check]
    assert (finding.verdict, value in finding.value, cure in finding.cure) == (verdict, True, True), finding


CHANGED = {
    "passive": ('"ERROR-ACTIVE"', '"ERROR-PASSIVE"', "error state", "bad", "gets no acknowledgement"),
    "warning": ('"ERROR-ACTIVE"', '"ERROR-WARNING"', "error state", "warn", "terminator"),
    "counts": ('{"tx":0,"rx":0}', '{"tx":8,"rx":3}', "error counters", "warn", "lower the counters"),
    "high": ('{"tx":0,"rx":0}', '{"tx":0,"rx":128}', "error counters", "bad", "another bit rate"),
    "overrun": ('"over_errors":0', '"over_errors":7', "lost frames", "warn", "too late"),
    "late": ('"0.750"', '"0.925"', "sample point", "warn", "sample-point 0.8"),
    "early": ('"0.750"', '"0.500"', "sample point", "warn", "sample-point 0.8"),
    "older iproute2": ('"0.750"', "0.875", "sample point", "ok", ""),
    "loopback": ('["BERR-REPORTING"]', '["LOOPBACK","FD"]', "controller", "bad", "loopback off;"),
    "one-shot": ('["BERR-REPORTING"]', '["ONE-SHOT"]', "controller", "bad", "one-shot off;"),
    "presumed": ('["BERR-REPORTING"]', '["PRESUME-ACK"]', "controller", "warn", "presume-ack off;"),
    "short queue": ('"txqlen":10', '"txqlen":3', "txqueuelen", "warn", "sudo ip link set can0 txqueuelen 10"),
    "long queue": ('"txqlen":10', '"txqlen":1000', "txqueuelen", "warn", "sudo ip link set can0 txqueuelen 10"),
    "not set": ('"bitrate":1000000', '"bitrate":0', "bit rate", "bad", SET_UP),
    "arbitration": ('"arbitration_lost":0', '"arbitration_lost":9', "error counters", "ok", ""),
    "history": ('"bus_error":0', '"bus_error":9', "error counters", "warn", "if they grow"),
    "no counters": ('"berr_counter":{"tx":0,"rx":0},', "", "error counters", "unknown", "does not tell"),
    "new state": ('"ERROR-ACTIVE"', '"RESTING"', "error state", "unknown", "terminator"),
}


@pytest.mark.parametrize("name", CHANGED)
def test_values_at_and_beyond_the_limits(name: str, scenario: Scenario) -> None:
    old, new, check, verdict, cure = CHANGED[name]
    finding = judged(recorded("can0", (old, new)), scenario)[check]
    assert (finding.verdict, cure in finding.cure) == (verdict, True), finding


def test_interface_that_was_never_set_up_is_set_up_whole(scenario: Scenario) -> None:
    found = judged(recorded("down", (TIMING + ",", "")), scenario)
    assert found["up"].cure == found["bit rate"].cure == SET_UP


def test_controller_with_fixed_bit_rates_is_understood(scenario: Scenario) -> None:
    """can_print_opt of iproute2 prints no bittiming then."""
    fixed = '"bittiming_bitrate":1000000,"bitrate_const":[500000,1000000]'
    found = judged(recorded("can0", (TIMING, fixed)), scenario)
    assert found["bit rate"].verdict == "ok"
    assert found["sample point"].verdict == "unknown"


@pytest.mark.parametrize("bitrate", [50_000, 500_000, 800_000, 1_000_000])
def test_the_recommended_sample_point_is_allowed(bitrate: int) -> None:
    first, last = link_checks.allowed_points(bitrate)
    assert first <= link_checks.recommended_point(bitrate) <= last


def test_queue_holds_a_cycle_of_more_joints() -> None:
    found = judged(recorded("can0"), scenario_file.load("five-joints"))["txqueuelen"]
    assert found.verdict == "warn"
    assert found.cure == "sudo ip link set can0 txqueuelen 14"


def test_vcan_has_no_bits_and_proves_nothing_of_a_bus(scenario: Scenario) -> None:
    found = judged(recorded("vcan0"), scenario)
    for name in link_checks.OF_BITS:
        assert found[name] == Finding(name, "none: vcan moves whole frames", "", "unknown")
    claim = found[link_checks.CLAIMS]
    assert claim.value == "order and payloads alone: vcan0 has no bit rate, no arbitration, no error state"
    assert "proves nothing about a bus" in claim.cure
    assert worst(list(found.values())) == "ok"


def test_missing_interface_is_looked_for_and_a_virtual_one_made() -> None:
    assert "sudo ip link add dev vcan7 type vcan" in link_checks.missing("vcan7").cure
    assert "dev vcan0 type vcan" in link_checks.missing("can0").cure


@pytest.mark.parametrize("name", ["nosuch0", "", ".", "..", "../lo", "-json"])
def test_no_interface_of_that_name(name: str) -> None:
    assert read_link(name) is None


def test_this_machines_own_interface_is_read_in_both_ways() -> None:
    """lo is everywhere; iproute2 may be missing."""
    read, seen = read_link("lo"), from_sysfs(Path("/sys/class/net/lo"), "no iproute2")
    assert read is not None
    assert (read.name, read.is_can, read.up, read.txqueuelen) == ("lo", False, seen.up, seen.txqueuelen)


# -- without iproute2 --


@pytest.fixture
def sysfs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A folder like /sys/class/net, with one card and vcan0."""

    def make(name: str, kind: str, flags: str) -> None:
        real = tmp_path / "devices" / kind / "net" / name
        (real / "statistics").mkdir(parents=True)
        texts = {"type": "280", "flags": flags, "tx_queue_len": "10", "statistics/rx_over_errors": "2"}
        for file, text in texts.items():
            (real / file).write_text(text + "\n")
        (tmp_path / name).symlink_to(real)

    make("can0", "pci0000:00", "0x40081")
    make("vcan0", "virtual", "0x80")
    monkeypatch.setattr(links, "SYSFS", tmp_path)
    return tmp_path


@pytest.mark.usefixtures("sysfs")
def test_without_iproute2_what_can_be_seen_is_judged_and_the_rest_is_unknown(
    scenario: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(links.shutil, "which", lambda *_args, **_more: None)
    card, virtual = read_link("can0"), read_link("vcan0")
    assert card is not None
    assert virtual is not None
    found = judged(card, scenario)
    assert found["up"].verdict == "ok"
    assert found["lost frames"].value == "receive FIFO overruns 2"
    for name in link_checks.OF_BITS:
        assert (found[name].verdict, found[name].cure) == ("unknown", "iproute2 is missing: sudo apt install iproute2")
    found = judged(virtual, scenario)
    assert found["up"].verdict == "bad"
    assert "no arbitration" in found[link_checks.CLAIMS].value


@pytest.mark.usefixtures("sysfs")
@pytest.mark.parametrize("answer", ["", "[]", "state ERROR-ACTIVE", '[{"ifname":"can0"}]', "[1]", '[{"linkinfo":1}]'])
def test_an_answer_that_is_not_understood_is_as_good_as_none(answer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Older versions of `ip` printed the state of a controller past the JSON."""
    monkeypatch.setattr(links, "_ask_ip", lambda _name: (answer, ""))
    card = read_link("can0")
    assert card is not None
    assert "update iproute2" in card.source


@pytest.mark.usefixtures("sysfs")
def test_ip_that_fails_or_hangs_is_as_good_as_none(monkeypatch: pytest.MonkeyPatch) -> None:
    def hang(command: list[str], **_more: Any) -> None:
        raise subprocess.TimeoutExpired(command, links.IP_S)

    monkeypatch.setattr(links.shutil, "which", lambda *_args, **_more: "/sbin/ip")
    monkeypatch.setattr(links.subprocess, "run", hang)
    card = read_link("can0")
    assert card is not None
    assert "timed out" in card.source


# -- the machine --

GOOD = Machine(fifo=0, mlock=0, resolution_s=1e-9, clocksource="tsc", governors=("performance",))
MACHINES: dict[str, tuple[Machine, str, str, str]] = {
    "fifo": (Machine(errno.EPERM, 0, 1e-9, "tsc", ()), "SCHED_FIFO", "warn", "/etc/security/limits.d/hil.conf"),
    "mlock": (Machine(0, errno.ENOMEM, 1e-9, "tsc", ()), "mlock", "warn", "memlock unlimited"),
    "jiffies": (Machine(0, 0, 4e-3, "jiffies", ()), "clock", "bad", "CONFIG_HIGH_RES_TIMERS"),
    "coarse": (Machine(0, 0, 1e-4, "", ()), "clock", "warn", "high-resolution timers"),
    "hpet": (Machine(0, 0, 1e-9, "hpet", ()), "clock", "warn", "echo tsc | sudo tee"),
    "powersave": (Machine(0, 0, 1e-9, "", ("performance", "powersave")), "CPU governor", "warn", "cpupower"),
    "unseen": (Machine(0, 0, 1e-9, "", ()), "CPU governor", "unknown", ""),
}


def test_good_machine_has_nothing_to_mend(scenario: Scenario) -> None:
    assert {finding.verdict for finding in machine.check_machine(GOOD, scenario)} == {"ok"}


@pytest.mark.parametrize("name", MACHINES)
def test_each_lack_of_a_machine_has_its_cure(name: str, scenario: Scenario) -> None:
    given, check, verdict, cure = MACHINES[name]
    found = {finding.name: finding for finding in machine.check_machine(given, scenario)}[check]
    assert (found.verdict, cure in found.cure) == (verdict, True), found


def test_reading_the_machine_changes_nothing() -> None:
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    found = machine.read_machine()
    assert (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority) == before
    assert 0 < found.resolution_s < 1
    assert "VmLck:\t       0 kB" in Path("/proc/self/status").read_text()


@pytest.mark.parametrize(
    ("flags", "age_s", "verdict", "value"),
    [
        (0x18, None, "ok", "kernel"),
        (0x1C, 0.0003, "ok", "kernel and controller, 0.3 ms old when taken"),
        (0x00, None, "warn", "none by the kernel"),
        (None, None, "unknown", "not to be read"),
        (0x18, 1.7e9, "bad", "1.7e+09 s old when taken"),
    ],
)
def test_time_stamps(flags: int | None, age_s: float | None, verdict: str, value: str) -> None:
    found = machine.check_stamps(flags, age_s)
    assert (found.verdict, found.value) == (verdict, value)


def test_the_kernel_tells_of_time_stamps() -> None:
    assert machine.read_stamps("nosuch0") is None
    flags = machine.read_stamps("lo")
    assert flags is None or flags & machine.RX_SOFTWARE


@pytest.mark.parametrize(
    ("number", "cure"), [(errno.EAFNOSUPPORT, "modprobe can_raw"), (errno.EPERM, "run as a user"), (0, "")]
)
def test_kernel_without_can_and_user_without_leave(number: int, cure: str) -> None:
    found = machine.check_family(number)
    assert (found.verdict, cure in found.cure) == ("bad" if number else "ok", True)


# -- other traffic --


def heard(*messages: can.Message) -> traffic.Traffic:
    found, codec = traffic.Traffic(seconds=1.0), load_arm()
    for message in messages:
        found.hear(message, 100.0, codec)
    return found


def frame(identifier: int, extended: bool = False, age_s: float = 0.0) -> can.Message:
    return can.Message(arbitration_id=identifier, is_extended_id=extended, timestamp=100.0 - age_s)


def error(identifier: int, *data: int) -> can.Message:
    return can.Message(arbitration_id=identifier, is_error_frame=True, data=bytes(data).ljust(8, b"\0"))


def test_strangers_are_left_alone_and_senders_of_our_identifiers_are_not() -> None:
    quiet = traffic.others(heard(frame(0x7DF), frame(0x101, extended=True)))
    assert (quiet.verdict, quiet.value) == ("ok", "2 frames in 1.0 s, none on our identifiers")
    found = traffic.others(heard(frame(0x102), frame(0x102), frame(0x7DF)))
    assert found.verdict == "bad"
    assert found.value == "3 frames in 1.0 s; ours: Encoder_2 2"
    assert "another sender of our identifiers" in found.cure


def test_a_run_that_is_going_on_is_told_from_a_stranger() -> None:
    found = traffic.others(heard(frame(0x080), frame(0x101)))
    assert found.verdict == "warn"
    assert "a run is going on" in found.cure


def test_the_freshest_stamp_counts() -> None:
    assert heard(frame(1, age_s=0.5), frame(1, age_s=0.25)).stamp_age_s == 0.25


@pytest.mark.parametrize(
    ("identifier", "data", "said"),
    [
        (0x040, (), ["bus-off"]),
        (0x020, (), ["no acknowledgement"]),
        (0x088, (0, 0, 0x04), ["protocol violation"]),
        (0x100, (), ["restarted"]),
        (0x002, (3,), ["arbitration lost"]),
        (0x004, (0, 0x01), ["receive FIFO overrun"]),
        (0x004, (0, 0x20), ["error-passive"]),
        (0x004, (0, 0x08), ["error counter at the warning limit"]),
        (0x004, (0, 0x40), []),
        (0x200, (), []),
    ],
)
def test_error_frames_are_put_into_words(identifier: int, data: tuple[int, ...], said: list[str]) -> None:
    assert traffic.explain(identifier, bytes(data)) == said


def test_error_frames_are_counted_and_cured() -> None:
    found = traffic.error_frames(heard(error(0x020), error(0x020), error(0x004, 0, 0x20)))
    assert (found.verdict, found.value) == ("bad", "no acknowledgement 2, error-passive 1")
    assert "switch a node on" in found.cure
    assert "terminator" in found.cure
    assert traffic.error_frames(heard(error(0x002))).verdict == "ok"
    assert traffic.error_frames(traffic.Traffic(errors=Counter({"protocol violation": 1}))).verdict == "warn"


class Broken:
    """A bus that goes down while it is listened to."""

    def recv(self, _timeout: float) -> None:
        raise can.CanOperationError("Error receiving: Network is down", error_code=errno.ENETDOWN)


def test_interface_that_goes_down_while_listening_is_told() -> None:
    port = CanPort.__new__(CanPort)
    port.bus = Broken()  # type: ignore[assignment]
    found = traffic.others(traffic.listen(port, load_arm(), 1.0))
    assert found.verdict == "bad"
    assert "Network is down" in found.cure


# -- a bus in virtual time --


@pytest.mark.parametrize(("bit_ns", "verdict"), [(1000, "ok"), (2000, "bad"), (0, "unknown")])
def test_rate_of_a_bus_in_virtual_time(bit_ns: int, verdict: str, scenario: Scenario) -> None:
    assert check_rate(bit_ns, "arm", scenario).verdict == verdict


def test_bus_of_ours_is_fit(hil: Any) -> None:
    hil.bus("arm")
    run = hil.run("doctor", "-i", "hil", "-c", "arm", "--listen", "0.2", "--json")
    assert run.returncode == 0, run.stderr
    said = json.loads(run.stdout)
    assert (said["verdict"], said["timing_claims"], said["scenario"]) == ("ok", True, "paper-joint")
    assert [each["name"] for each in said["findings"]][:2] == ["bus", "bit rate"]
    run = hil.run("doctor", "-i", "hil", "-c", "arm", "--listen", "0")
    assert run.returncode == 0, run.stderr
    assert "arm, bits" in run.stdout


def test_bus_at_another_rate_is_refused_with_the_cure(hil: Any) -> None:
    hil.bus("slow", "--bitrate", "500000")
    run = hil.run("doctor", "-i", "hil", "-c", "slow", "--listen", "0")
    assert run.returncode == 4
    assert "hil bus slow --bitrate 1000000" in run.stdout
    assert run.stderr == "hil: hil slow: bit rate: mend this first\n"


def test_functional_bus_proves_no_timing(hil: Any) -> None:
    hil.bus("quick", "--fidelity", "functional")
    found = {each.name: each for each in examine(Place("hil", "quick", {}), scenario_file.load("paper-joint"), 0.0)}
    assert "no arbitration" in found[link_checks.CLAIMS].value


def test_no_bus_says_how_to_start_one(hil: Any) -> None:
    run = hil.run("doctor", "-i", "hil", "-c", "nobody", "--json")
    assert run.returncode == 4
    (finding,) = json.loads(run.stdout)["findings"]
    assert "hil bus nobody" in finding["cure"]


def test_somebody_who_sends_on_our_bus_is_heard(hil: Any) -> None:
    """And somebody else acknowledges: the doctor drives no bit."""
    hil.bus("arm")
    doctor = hil.start("doctor", "-i", "hil", "-c", "arm", "--listen", "4", "--json")
    stranger, other = CanPort("hil", "arm", None), CanPort("hil", "arm", None)
    while doctor.poll() is None:
        stranger.send(0x103, b"")
        stranger.receive(0.02)
    stranger.close()
    other.close()
    found = {each["name"]: each for each in json.loads(doctor.communicate()[0])["findings"]}
    assert doctor.returncode == 4
    assert "ours: Encoder_3" in found["other traffic"]["value"]


# -- other interfaces, and none --


def has_socketcan() -> bool:
    return machine.read_family() == 0


@pytest.mark.skipif(has_socketcan(), reason="there is SocketCAN here")
def test_kernel_without_socketcan_is_told_and_not_traced(hil: Any) -> None:
    run = hil.run("doctor", "-i", "socketcan", "-c", "can9")
    assert run.returncode == 4
    assert "no SocketCAN" in run.stdout
    assert "sudo modprobe can_raw" in run.stdout
    assert run.stderr == "hil: socketcan can9: kernel, interface: mend this first\n"


def test_interface_that_is_not_can_is_not_opened(scenario: Scenario) -> None:
    found = examine(Place("socketcan", "lo", {}), scenario, 0.1)
    assert found[1].value == "lo is not CAN"
    assert "other traffic" not in {each.name for each in found}


def test_interface_inside_one_process_is_refused(scenario: Scenario) -> None:
    found = examine(Place("virtual", "x", {}), scenario, 0.0)
    assert (found[0].verdict, "nodes of a run are processes" in found[0].cure) == ("bad", True)


def test_interface_that_does_not_open_says_why(scenario: Scenario) -> None:
    found = examine(Place("nonsense", "x", {}), scenario, 0.0)
    assert found[0].verdict == "bad"
    assert "interface 'nonsense', channel 'x'" in found[0].cure


@pytest.mark.parametrize(
    ("words", "exit_code", "message"),
    [
        (("--bus-kwargs", "[1]"), 2, "write a JSON object"),
        (("--scenario", "nosuch"), 3, "no scenario 'nosuch'"),
        (("--listen", "-1"), 2, "Invalid value for '--listen'"),
    ],
)
def test_wrong_words_are_refused(words: tuple[str, ...], exit_code: int, message: str, hil: Any) -> None:
    run = hil.run("doctor", *words)
    assert run.returncode == exit_code
    assert message in " ".join(run.stderr.replace("│", " ").split())


def test_family_of_sockets_that_this_python_does_not_know(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(socket, "AF_CAN")
    assert machine.read_family() == errno.EAFNOSUPPORT
