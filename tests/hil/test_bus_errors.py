"""Error frames: in words, counted by cause, and the end of a run that cannot go on.

What a bus with bits makes of them is shown on the wire; what only other controllers tell, by frames as candump prints
them of sja1000 and others (linux/can/error.h says what each byte means).
"""

import json
from pathlib import Path
from typing import Any

import can
import pytest

from hil.bus_errors import PERSISTENT_S, BusErrors, as_wire, describe
from hil.can_port import CanPort
from hil.errors import NodeError

WORDS = {
    "088#0000801900008000": "no acknowledgement: in ACK slot while sending (error counters: transmit 128, receive 0)",
    "0A8#0000801900008000": "no acknowledgement: in ACK slot while sending (error counters: transmit 128, receive 0)",
    "088#0000040800000000": "protocol violation: stuff error in CRC while receiving",
    "088#0000020A00000017": "protocol violation: form error in data while receiving (error counters: transmit 0, "
    "receive 23)",
    "088#0000810900000000": "protocol violation: bit error in r0 while sending",
    "004#000800000000600A": "error counter at the warning limit (error counters: transmit 96, receive 10)",
    "204#0020000000008000": "error-passive (error counters: transmit 128, receive 0)",
    "004#0001000000000000": "receive FIFO overrun",
    "004#0002000000000000": "transmit buffer overrun",
    "100#0000000000000000": "restarted",
    "002#1F00000000000000": "arbitration lost",
    "010#0000000004000000": "transceiver trouble",
    "001#": "transmission timed out",
    "004#0040": "",
}


def parts(text: str) -> tuple[int, bytes]:
    identifier, _, data = text.partition("#")
    return int(identifier, 16), bytes.fromhex(data[:16])


@pytest.mark.parametrize("text", WORDS)
def test_error_frames_in_words(text: str) -> None:
    assert describe(*parts(text)) == WORDS[text]


@pytest.fixture
def errors() -> BusErrors:
    return BusErrors("socketcan", "can0")


OFF, NO_ACK, PASSIVE = parts("040#00000000000000F8"), parts("0A8#0000801900008000"), parts("004#0020000000008000")
ACTIVE, FORM, OVERRUN = parts("004#0040"), parts("088#0000020A00000000"), parts("004#0001")


def test_bus_off_ends_the_run_with_the_cure(errors: BusErrors) -> None:
    with pytest.raises(NodeError) as caught:
        errors.hear(*OFF, 1.0)
    said = str(caught.value)
    assert said.startswith("socketcan can0: the bus is off (error counters: transmit 0, receive 248): look for a node")
    assert "sudo ip link set can0 type can restart-ms 100" in said
    assert said.endswith("see `hil doctor -i socketcan -c can0`")


def test_nobody_acknowledges_for_long(errors: BusErrors) -> None:
    """With berr-reporting each attempt is told."""
    for k in range(50):
        errors.hear(*NO_ACK, k * 0.1)
    with pytest.raises(NodeError, match=r"for 5 s, the last: no acknowledgement: in ACK slot.*switch a node on"):
        errors.hear(*NO_ACK, PERSISTENT_S)
    assert errors.counts == {"no acknowledgement": 51}


def test_error_passive_is_told_once_and_lasts(errors: BusErrors) -> None:
    """Without berr-reporting a controller alone tells no more than that."""
    errors.hear(*PASSIVE, 10.0)
    errors.check(10.0 + 0.9 * PERSISTENT_S)
    with pytest.raises(NodeError, match=r"error-passive \(error counters: transmit 128.*switch a node on"):
        errors.check(10.0 + PERSISTENT_S)


def test_wrong_bit_rate_is_nothing_but_errors(errors: BusErrors) -> None:
    for k in range(10):
        errors.hear(*FORM, k * 0.5)
    with pytest.raises(NodeError, match="form error in data while receiving: look for a node at another bit rate"):
        errors.hear(*FORM, PERSISTENT_S)
    assert errors.counts["protocol violation"] == 11


def test_what_is_mended_ends_nothing(errors: BusErrors) -> None:
    """A frame that came, a return to error-active, a single error of long ago."""
    errors.hear(*PASSIVE, 0.0)
    errors.works()
    errors.check(100.0)
    errors.hear(*PASSIVE, 100.0)
    errors.hear(*ACTIVE, 101.0)
    errors.check(200.0)
    for k in range(20):
        errors.hear(*FORM, 300.0 + 10.0 * k)
    errors.check(1000.0)


def test_losses_end_nothing_and_are_counted_as_losses(errors: BusErrors) -> None:
    for k in range(100):
        errors.hear(*OVERRUN, k * 0.1)
    errors.hear(*FORM, 20.0)
    errors.hear(*parts("002#05"), 20.0)
    assert as_wire(errors.counts) == {"errors": {"protocol violation": 1}, "lost": {"receive FIFO overrun": 100}}


# -- on the wire --

SHORT = ("duration_s=0.2", "trajectory.time_s=0.15", "trajectory.by_rad=[0.05, -0.05, 0.05]")
WORDS_OF_SHORT = [word for setting in SHORT for word in ("--set", setting)]


def faults(folder: Path, **fault: Any) -> str:
    """Write a script of one fault."""
    lines = [f"{key} = {json.dumps(value)}" for key, value in fault.items()]
    path = folder / "faults.toml"
    path.write_text("[[fault]]\n" + "\n".join(lines) + "\n")
    return str(path)


def by_sync(hil: Any) -> Any:
    return hil.run("run", "-i", "hil", "-c", "street", "--clock", "sync", "--json", "--patience", "30", *WORDS_OF_SHORT)


def test_sender_that_goes_bus_off_ends_the_run(hil: Any, tmp_path: Path) -> None:
    """One bit of joint 1's answers is inverted from the 300th on: 32 attempts make its controller leave the bus."""
    script = faults(tmp_path, kind="bit error", identifier=0x121, bit=20, occurrence=300, every=True)
    hil.bus("street", "--faults", script)
    run = by_sync(hil)
    assert run.returncode == 5
    assert "joint1 ended with exit code 5 in the middle of the run: hil street: the bus is off" in run.stderr
    assert "terminator" in run.stderr
    assert "see `hil doctor -i hil -c street`" in run.stderr


def test_bus_that_carries_nothing_whole_ends_the_run(hil: Any, tmp_path: Path) -> None:
    """As with a node at another bit rate: every tenth bit is wrong."""
    hil.bus("street", "--faults", faults(tmp_path, kind="bit error rate", rate=0.1))
    run = by_sync(hil)
    assert run.returncode == 5, run.stderr
    assert "look for a node at another bit rate" in run.stderr


def test_bus_at_another_rate_is_refused(hil: Any) -> None:
    hil.bus("street", "--bitrate", "500000")
    run = by_sync(hil)
    assert run.returncode == 4
    assert "hil street: bit rate: 500000 bit/s (wanted: 1000000 bit/s" in run.stderr
    node = hil.run("node", "dsp", "-c", "street", "--set", "clock.kind=sync")
    assert (node.returncode, "hil bus street --bitrate 1000000" in node.stderr) == (4, True)
    assert "Traceback" not in run.stderr + node.stderr


def test_errors_that_are_mended_are_in_the_summary(hil: Any, tmp_path: Path) -> None:
    """Every node sees each of them, and nothing is lost."""
    script = faults(tmp_path, kind="bit error", identifier=0x121, bit=20, occurrence=300, every=False)
    hil.bus("street", "--faults", script)
    run = by_sync(hil)
    assert run.returncode == 0, run.stderr
    summary = json.loads(run.stdout)
    assert {name: counts["errors"] for name, counts in summary["wire"].items()} == {
        name: {"protocol violation": 1} for name in ("plant", "joint1", "joint2", "joint3", "dsp", "rig")
    }
    assert (summary["bus_errors"], summary["lost_frames"]) == (6, 0)


def test_nobody_there_to_acknowledge(hil: Any) -> None:
    hil.bus("street")
    run = hil.run("node", "dsp", "-c", "street", "--set", "clock.kind=sync")
    assert run.returncode == 5
    assert "nobody else is awake on this bus: switch a node on" in run.stderr


@pytest.mark.usefixtures("bounded")
def test_receive_overrun_is_counted(hil: Any, tmp_path: Path) -> None:
    """Each frame is either heard or counted; from the third second on its controller's FIFO is full."""
    hil.bus("street", "--faults", faults(tmp_path, kind="receive overrun", node="deaf", from_s=3.0))
    heard = sent = 0
    with can.Bus(interface="hil", channel="street") as other:
        deaf = CanPort("hil", "street", {0x080}, name="deaf", timed=True)
        while deaf.errors.counts["receive FIFO overrun"] < 7:
            other.send(can.Message(arbitration_id=0x080, is_extended_id=False, data=b"\0"))
            sent += 1
            before = deaf.errors.counts.total()
            while (frame := deaf.receive(0.1)) is None and deaf.errors.counts.total() == before:
                pass
            heard += frame is not None
        deaf.close()
    assert heard + 7 == sent
