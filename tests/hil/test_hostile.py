"""Bad input, one by one: it is refused with a reason that names the thing, and the bus goes on for the others."""

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from hil.errors import ChannelError
from hil.wire import channel as channels
from hil.wire import protocol
from hil.wire.identifier import BRS, ERROR, EXTENDED, FD, REMOTE
from tests.hil.raw import Raw, status, wait_for

pytestmark = pytest.mark.usefixtures("bounded")

Spawn = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def spawn() -> Iterator[Spawn]:
    """Start timed clients as processes of their own."""
    started = []

    def start(name: str, identifier: int, *options: str) -> "subprocess.Popen[str]":
        words = [sys.executable, "-m", "tests.hil.timed_client", name, str(identifier), "500", *options]
        started.append(subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


class Pair:
    """Two well-behaved observers."""

    def __init__(self) -> None:
        self.one, self.other = Raw.joined("one"), Raw.joined("other")
        self.said = 0

    def goes_on(self) -> None:
        """A frame each way."""
        self.said += 1
        for sender, receiver in ((self.one, self.other), (self.other, self.one)):
            sender.send((0x7F0, self.said.to_bytes(4, "big")))
            while receiver.frame()[1:] != (0x7F0, self.said.to_bytes(4, "big")):
                pass

    def close(self) -> None:
        self.one.close()
        self.other.close()


@pytest.fixture(scope="module")
def bus(shared_runtime: Path, module_hil: Any) -> Iterator["subprocess.Popen[str]"]:
    """A classic bus that goes on without who dies; a timed client that waits for what never comes keeps its session."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(shared_runtime))
        bus = module_hil.bus("arm", "--go-on")
        stays = Raw.joined("stays", "timed", wakes_on=[])
    assert stays.receive()[0] == protocol.START
    stays.yields()
    yield bus
    stays.close()
    bus.terminate()
    assert "Traceback" not in bus.communicate()[1]


@pytest.fixture
def pair(shared_runtime: Path, monkeypatch: pytest.MonkeyPatch, bus: "subprocess.Popen[str]") -> Iterator[Pair]:
    """Two observers on that bus, who go on whatever the test does."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(shared_runtime))
    pair = Pair()
    pair.goes_on()
    yield pair
    pair.goes_on()
    assert bus.poll() is None
    assert "stays" in status()["nodes"]
    pair.close()
    wait_for(lambda: status()["nodes"].keys() == {"stays"})


def frames(*frames: tuple[int, bytes]) -> bytes:
    """The body of SEND with frames that no encoder would refuse."""
    return protocol.encode_frames([(0, identifier, data) for identifier, data in frames])


def removed(before: list[str]) -> str:
    """Why one more timed client was removed."""
    died: list[str] = wait_for(lambda: (died := status()["died"]) != before and died)
    assert died[:-1] == before
    return died[-1]


# -- frames that are none --

NO_FRAMES = [
    pytest.param(frames((0x800, b"")), r"frame of identifier 0x800 with 0 bytes is none", id="12 bits"),
    pytest.param(frames((EXTENDED | 0x20000000, b"")), r"frame .* is none|identifier 0xa0000000 has", id="30 bits"),
    pytest.param(frames((1 << 40, b"")), r"frame of identifier 0x10000000000 with 0 bytes is none", id="41 bits"),
    pytest.param(frames((0x100, bytes(9))), r"frame of identifier 0x100 with 9 bytes is none", id="9 bytes"),
    pytest.param(frames((0x100 | FD, bytes(9))), r"frame of identifier 0x100000100 with 9 bytes is none", id="FD, 9"),
    pytest.param(frames((0x100 | FD, bytes(65))), r"frame of identifier 0x100000100 with 65 bytes", id="FD, 65"),
    pytest.param(frames((0x100 | FD | REMOTE, b"")), r"frame of identifier 0x140000100 with 0", id="FD remote"),
    pytest.param(frames((0x100 | BRS, b"")), r"frame of identifier 0x200000100 with 0 bytes is none", id="BRS alone"),
    pytest.param(frames((0x100 | ERROR, bytes(8))), r"identifier 0x20000100 has .* flags that exclude", id="error"),
    pytest.param(
        frames((0x100 | FD, bytes(12))),
        r"CAN FD frame on a classic bus: send one without FD, or start the bus with a data rate",
        id="FD on a classic bus",
    ),
    pytest.param(frames((0x100, b"whole"))[:-1], r"1 bytes too many|cut short|frame|-1 bytes", id="cut"),
    pytest.param(frames((0x100, b""))[:-3], r"frames cut short", id="cut in the header"),
    pytest.param(frames((0x100, b"")) + b"?", r"1 bytes too many behind 1 frames", id="a byte behind"),
    pytest.param(b"\xff\xff\xff\xff", r"frames cut short", id="4 thousand million frames"),
]


@pytest.mark.parametrize(("body", "reason"), NO_FRAMES)
@pytest.mark.usefixtures("pair")
def test_observer_that_sends_no_frame_is_shown_out(body: bytes, reason: str) -> None:
    bad = Raw.joined("bad")
    bad.say(protocol.SEND, body)
    assert re.search(reason, bad.reason())
    with pytest.raises(protocol.Closed):
        bad.receive()
    assert "bad" not in wait_for(lambda: (nodes := status()["nodes"]) and "bad" not in nodes and nodes)


@pytest.mark.parametrize(("body", "reason"), NO_FRAMES)
@pytest.mark.usefixtures("pair")
def test_timed_client_that_sends_no_frame_is_removed_and_counted(body: bytes, reason: str) -> None:
    before = status()["died"]
    bad = Raw.joined("bad", "timed")
    assert bad.receive()[0] == protocol.START
    bad.say(protocol.YIELD, protocol.encode_yield((0, None, []))[:16] + body)
    died = removed(before)
    assert died.startswith("bad")
    assert re.search(reason, died)


@pytest.mark.parametrize(
    ("turn", "reason"),
    [
        (lambda raw, now_ns: raw.yields(now_ns - 1), r"bad: timer asked for at \d+ ns, but it is already \d+ ns"),
        (lambda raw, _: raw.yields(None, (-1, 0x100, b"")), r"bad: frame 0x100 .* in -1 ns cannot be sent"),
        (lambda raw, _: raw.yields(busy_ns=-1), r"bad does not keep .*: YIELD with -1 ns of computing"),
        (lambda raw, _: raw.yields((1 << 62) + 1), r"bad does not keep .*: YIELD .* beyond 4611686018427387904 ns"),
        (lambda raw, _: raw.say(protocol.SEND, frames()), r"bad does not keep .*: message 9 where a yield was due"),
        (lambda raw, _: raw.say(protocol.YIELD), r"bad does not keep to the protocol: YIELD cut short"),
        (lambda raw, _: raw.stream.sendall(b"\0\0\0\0\0"), r"bad does not keep .*: message of 0 bytes: 1 to 1048576"),
        (lambda raw, _: raw.configure(depth=3), r"bad does not keep .*: Change: depth = '3': Extra inputs"),
        (lambda raw, _: raw.close(), r"bad is gone: its connection to the bus broke"),
    ],
)  # fmt: skip
@pytest.mark.usefixtures("pair")
def test_timed_client_whose_answer_is_none_is_removed(turn: Callable[[Raw, int], None], reason: str) -> None:
    before = status()["died"]
    bad = Raw.joined("bad", "timed")
    kind, body = bad.receive()
    assert kind == protocol.START
    turn(bad, protocol.decode_time(body))
    assert re.search(reason, removed(before))


@pytest.mark.parametrize(
    ("turn", "reason"),
    [
        (lambda raw: raw.yields(-1), "bad: timer asked for at -1 ns"),
        (lambda raw: raw.yields(None, (0, 0x100 | FD, bytes(12))), "CAN FD frame on a classic bus"),
        (lambda raw: raw.close(), "bad is gone: its connection to the bus broke"),
    ],
)
def test_without_go_on_the_session_ends_with_the_name(hil: Any, turn: Callable[[Raw], None], reason: str) -> None:
    bus = hil.bus("arm", "--expect", "bad,good")
    good = Raw.joined("good", "timed", start_ns=0)
    bad = Raw.joined("bad", "timed", start_ns=0)
    assert bad.receive()[0] == protocol.START
    turn(bad)
    while (kind_and_body := good.receive())[0] in (protocol.START, protocol.GRANT):
        good.yields()
    assert kind_and_body[0] == protocol.END
    assert kind_and_body[1].decode().startswith("bad")
    assert reason in kind_and_body[1].decode()
    wait_for(lambda: status()["missing"] == ["bad", "good"])
    bus.send_signal(signal.SIGTERM)
    out, err = bus.communicate()
    assert re.search(r"session ended at 0\.0\d* s: .*" + re.escape(reason), out)
    assert "Traceback" not in err


# -- who may not come in --


@pytest.mark.parametrize("role", ["observer", "timed"])
@pytest.mark.usefixtures("pair")
def test_second_client_of_a_name_is_refused(role: str) -> None:
    second = Raw()
    second.hello("one", role)
    assert second.reason() == "there is a client of the name 'one' already: give it another"


@pytest.mark.usefixtures("pair")
def test_other_bit_rate_is_refused_with_both() -> None:
    with pytest.raises(can.CanInitializationError, match=r"bitrate = 500000 bit/s, but the bus runs at 1000000 bit/s"):
        can.Bus(interface="hil", channel="arm", bitrate=500_000)


@pytest.mark.usefixtures("pair")
def test_fd_on_a_classic_bus_is_refused() -> None:
    with pytest.raises(can.CanInitializationError, match=r"it wants CAN FD, but this is a classic bus: start the bus"):
        can.Bus(interface="hil", channel="arm", fd=True)


@pytest.mark.usefixtures("pair")
def test_second_bus_on_a_channel_is_refused(hil: Any) -> None:
    second = hil.run("bus", "arm")
    assert second.returncode == ChannelError.exit_code
    assert second.stderr == "hil: channel 'arm' is in use by another bus: take another name, or end that bus\n"


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", "message of 542393671 bytes: 1 to 262144 are allowed"),
        (protocol.message(protocol.SEND, frames()), "message 9 where HELLO was due"),
        (protocol.message(protocol.HELLO, b"{"), "Hello: body: Invalid JSON"),
        (protocol.message(protocol.HELLO, b"[" * 200_000), "Hello: body: Invalid JSON: recursion limit exceeded"),
        (protocol.message(protocol.HELLO, b'{"name": "x", "role": "king"}'), "Hello: role = 'king': Input should be"),
        (protocol.message(protocol.HELLO, b'{"name": "", "role": "timed"}'), "Hello: name = '': String should have"),
        (protocol.message(protocol.HELLO, b'{"name": "x"}'), "Hello: role: Field required"),
        (
            protocol.message(protocol.HELLO, b'{"name": "x", "role": "timed", "depth": ' + b"9" * 5000 + b"}"),
            "number out of range",
        ),
        (protocol.message(protocol.HELLO, b'{"name": "a\\nb", "role": "timed"}'), "Hello: name = 'a\\nb': String"),
    ],
)
@pytest.mark.usefixtures("pair")
def test_hello_that_is_none_is_refused(words: bytes, reason: str) -> None:
    stranger = Raw()
    stranger.stream.sendall(words)
    assert reason in stranger.reason()
    with pytest.raises(protocol.Closed):
        stranger.receive()


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (protocol.message(protocol.CONTROL, b'{"command": "explode"}'), "Command: command = 'explode': Input should"),
        (protocol.message(protocol.CONTROL, b'{"command": "pace", "pace": NaN}'), "Command: pace"),
        (
            protocol.message(protocol.CONTROL, b'{"command": "pace", "pace": -1}'),
            "Command: pace = '-1': Input should be greater",
        ),
        (
            protocol.message(protocol.CONTROL, b'{"command": "step", "step_ns": 1e300}'),
            "Command: step_ns = '1e+300': Input should be a valid",
        ),
        (protocol.message(protocol.YIELD, b""), "message 6 where CONTROL was due"),
    ],
)
@pytest.mark.usefixtures("pair")
def test_command_that_is_none_is_refused(words: bytes, reason: str) -> None:
    stranger = Raw()
    stranger.hello("clock", "control")
    stranger.stream.sendall(words)
    assert reason in stranger.reason()


# -- who dies, and who is slow --


def clock(hil: Any) -> dict[str, Any]:
    """What `hil clock` says."""
    run = hil.run("clock", "arm", "status", "--json")
    assert run.returncode == 0, run.stderr
    found: dict[str, Any] = json.loads(run.stdout)
    return found


def test_timed_client_that_dies_in_its_turn_is_removed_and_the_others_go_on(hil: Any, spawn: Spawn) -> None:
    bus = hil.bus("arm", "--expect", "left,right,victim", "--go-on")
    left, right, victim = spawn("left", 1), spawn("right", 2), spawn("victim", 3, "--die-at", "20")
    assert victim.wait() == -signal.SIGKILL
    before = wait_for(lambda: (found := clock(hil)) and found["died"] and found)
    assert before["died"] == ["victim is gone: its connection to the bus broke"]
    wait_for(lambda: status()["now_ns"] > before["now_ns"] + 10_000_000)
    after = clock(hil)
    assert after["nodes"].keys() == {"left", "right"}
    assert all(after["nodes"][name]["sent"] > before["nodes"][name]["sent"] for name in ("left", "right"))
    assert left.poll() is right.poll() is bus.poll() is None


def test_timed_client_that_dies_in_its_turn_ends_the_session_with_its_name(hil: Any, spawn: Spawn) -> None:
    bus = hil.bus("arm", "--expect", "left,right,victim")
    left, right = spawn("left", 1), spawn("right", 2)
    assert spawn("victim", 3, "--die-at", "20").wait() == -signal.SIGKILL
    for name, process in (("left", left), ("right", right)):
        reason = "victim is gone: its connection to the bus broke"
        assert process.communicate() == (f"{name}: the bus has ended: {reason}\n", "")
    assert wait_for(lambda: status()["missing"]) == ["left", "right", "victim"]
    assert bus.poll() is None


def test_slow_client_is_named_with_the_seconds_and_the_clock_answers(hil: Any, spawn: Spawn) -> None:
    bus = hil.bus("arm", "--expect", "left,right")
    left, right = spawn("left", 1), spawn("right", 2)
    wait_for(lambda: status()["now_ns"] > 0)
    left.send_signal(signal.SIGSTOP)
    try:
        lines = iter(bus.stdout.readline, "")
        assert next(line for line in lines if line.startswith("waiting for left ")) == "waiting for left for 1 s\n"
        waiting = clock(hil)["waiting_for"]
        assert waiting["name"] == "left"
        assert waiting["seconds"] >= 1.0
        assert "waiting for left for " in hil.run("clock", "arm").stdout
        stands_at_ns = status()["now_ns"]
        assert status()["now_ns"] == stands_at_ns
    finally:
        left.send_signal(signal.SIGCONT)
    wait_for(lambda: status()["now_ns"] > stands_at_ns)
    assert left.poll() is right.poll() is None


# -- ends --


def test_stale_socket_is_replaced(hil: Any) -> None:
    first = hil.bus("arm")
    first.kill()
    first.wait()
    assert channels.socket_path("arm").exists()
    assert channels.names() == []
    hil.bus("arm")
    pair = Pair()
    pair.goes_on()
    pair.close()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_bus_that_is_told_to_end_leaves_nothing_and_its_clients_are_told(hil: Any, spawn: Spawn, number: int) -> None:
    bus = hil.bus("arm", "--expect", "left,right")
    witness = can.Bus(interface="hil", channel="arm")
    left, right = spawn("left", 1), spawn("right", 2)
    assert witness.recv(10.0) is not None
    bus.send_signal(number)
    _, err = bus.communicate()
    assert "Traceback" not in err
    with pytest.raises(can.CanOperationError, match=r"^hil channel arm: the bus has ended: the bus ends$"):
        list(iter(lambda: witness.recv(10.0), "never"))
    witness.shutdown()
    for name, process in (("left", left), ("right", right)):
        assert process.communicate() == (f"{name}: the bus has ended: the bus ends\n", "")
    assert os.listdir(channels.folder()) == []
