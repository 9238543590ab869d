"""docs/bridge.md: its commands, with another channel of ours in vcan0's place, and what it says of other things."""

import json
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from hil import scenario_file
from hil.rig import run_inline

PAGE = (Path(__file__).parents[2] / "docs" / "bridge.md").read_text()
LIMIT_S = 60
FAR = 0x7AA


def commands() -> list[list[str]]:
    """Return the page's terminals: the bus, the bridge, the rig and the node."""
    (block,) = re.findall(r"^```sh terminals\n(.*?)^```", PAGE, re.M | re.S)
    return [line.split(" # ")[0].split() for line in block.splitlines()]


def payloads(log: Path) -> dict[int, list[bytes]]:
    found = defaultdict(list)
    for message in can.LogReader(str(log)):
        found[message.arbitration_id].append(bytes(message.data))
    return found


def functional(settings: list[str]) -> dict[int, list[bytes]]:
    found = defaultdict(list)
    scenario = scenario_file.load("paper-joint", ["bus.fidelity=functional", *settings[1::2]])
    for _, identifier, data, _ in run_inline(scenario).log.frames:
        found[identifier].append(data)
    return found


def play(hil: Any, lines: list[list[str]], settings: list[str], limit_s: float, *more: str) -> Any:
    """Start the four terminals, the rig with --json and more; return its summary when rig and node have ended well."""
    bus, bridge, rig, node = lines
    hil.bus(bus[2], *bus[3:])
    started = start_bridge(hil, *bridge[2:])
    running = hil.start(*rig[1:], "--json", *more, *settings)
    board = hil.start(*node[1:], *settings)
    out, err = running.communicate(timeout=limit_s)
    assert running.returncode == 0, err
    assert board.wait(limit_s) == 0
    assert started.poll() is None
    return json.loads(out)


def test_commands_of_the_page_over_two_channels_of_ours(hil: Any, short_settings: list[str]) -> None:
    hil.bus("there")
    lines = [ours(line) for line in commands()]
    summary = play(hil, lines, short_settings, LIMIT_S, "--out", "out")
    assert payloads(hil.folder / "out" / "frames.log") == functional(short_settings)
    assert summary["lost_frames"] == 0


# -- what does not work across a bridge, as the page says --


@pytest.fixture
def bridged(hil: Any) -> Iterator[tuple[can.BusABC, can.BusABC, Any]]:
    """Two channels, somebody on each, and the bridge of the page."""
    hil.bus("arm there")
    start_bridge(hil, *ours(commands()[1])[2:])
    with can.Bus(interface="hil", channel="arm") as near, can.Bus(interface="hil", channel="there") as far:
        yield near, far, hil


def ours(line: list[str]) -> list[str]:
    """Return a command with a channel of ours in place of vcan0."""
    return [{"socketcan": "hil", "vcan0": "there"}.get(word, word) for word in line]


def start_bridge(hil: Any, *words: str) -> Any:
    bridge = hil.program(*words)
    assert "CAN Bridge (Started" in bridge.stdout.readline()
    return bridge


def message(number: int, **more: Any) -> can.Message:
    return can.Message(arbitration_id=number, **{"is_extended_id": False} | more)


KINDS: list[dict[str, Any]] = [{"data": b"\1\2"}, {"is_remote_frame": True, "dlc": 3}, {"is_extended_id": True}]


@pytest.mark.parametrize("kind", KINDS)
def test_frames_go_across_once_and_do_not_come_back(bridged: Any, kind: dict[str, Any]) -> None:
    near, far, _ = bridged
    near.send(message(0x123, **kind))
    heard = far.recv(LIMIT_S)
    assert heard.equals(message(0x123, **kind), timestamp_delta=None, check_channel=False)
    far.send(message(FAR))
    assert near.recv(LIMIT_S).arbitration_id == FAR
    assert near.recv(0.2) is None
    assert far.recv(0.2) is None


def test_second_bridge_lets_frames_go_round_for_ever(bridged: Any) -> None:
    near, far, hil = bridged
    start_bridge(hil, *ours(commands()[1])[2:])
    near.send(message(0x123))
    for _ in range(50):
        assert far.recv(LIMIT_S).arbitration_id == 0x123


PLAIN = ("can.bridge", "--bus1-interface", "hil", "--bus1-channel", "arm",
         "--bus2-interface", "hil", "--bus2-channel", "there")  # fmt: skip


@pytest.mark.usefixtures("bounded")
def test_nobody_on_the_other_side_ends_the_bridge(hil: Any) -> None:
    """The sender gets its acknowledgements, and its echoes, from the bridge."""
    hil.bus("arm there")
    bridge = start_bridge(hil, *PLAIN)
    with can.Bus(interface="hil", channel="arm", receive_own_messages=True) as near:
        for number in range(12):
            near.send(message(number), timeout=LIMIT_S)
            echo = near.recv(LIMIT_S)
            assert (echo.arbitration_id, echo.is_rx) == (number, False)  # type: ignore[union-attr]
        said = ""
        while "the transmit queue of 10 frames is full" not in said:
            said += bridge.stderr.readline()
    assert bridge.poll() is None


@pytest.mark.usefixtures("bounded")
def test_error_frame_ends_a_bridge_that_is_told_of_them(hil: Any, tmp_path: Path) -> None:
    """In that direction; the other goes on."""
    script = tmp_path / "faults.toml"
    script.write_text('[[fault]]\nkind = "bit error"\nidentifier = 0x123\nbit = 15\n')
    hil.bus("arm", "--faults", str(script))
    hil.bus("there")
    bridge = start_bridge(hil, *PLAIN)
    with can.Bus(interface="hil", channel="arm", error_frames="none") as near:
        near.send(message(0x123))
        said = ""
        while "an error frame cannot be sent" not in said:
            said += bridge.stderr.readline()
        with can.Bus(interface="hil", channel="there") as far:
            far.send(message(FAR))
            heard = near.recv(LIMIT_S)
            assert heard is not None
            assert heard.arbitration_id == FAR


@pytest.mark.parametrize("target", re.findall(r"\]\((?!http)(.*?)\)|`(tests/[\w/.]+)`", PAGE))
def test_what_the_page_points_to_is_there(target: tuple[str, str]) -> None:
    link, path = target
    root = Path(__file__).parents[2]
    assert (root / "docs" / link if link else root / path).exists()


def test_the_bridge_takes_the_options_of_the_page() -> None:
    """Of the installed python-can."""
    run = subprocess.run([sys.executable, "-m", "can.bridge", "--help"], capture_output=True, text=True, check=True)
    assert {word for word in commands()[1] if word.startswith("--")} <= set(re.findall(r"--[\w-]+", run.stdout))
