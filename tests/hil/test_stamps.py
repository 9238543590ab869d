"""Stamps of other clocks, carried over to CLOCK_MONOTONIC: on clocks that are set by hand, and on a real socket's."""

import json
import os
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.stamped_socket import STAMPS, StampedSocket
from hil.stamps import PAIRS, SAMPLE_NS, STEP_NS, ControllerStamps, SystemStamps

S = 1_000_000_000
READING_NS = 100


class Clocks:
    """Two clocks that go on by a little whenever one is read."""

    def __init__(self, system_ahead_ns: int = 1_700_000_000 * S) -> None:
        self.now_ns, self.ahead_ns = 5 * S, system_ahead_ns

    def monotonic(self) -> int:
        self.now_ns += READING_NS
        return self.now_ns

    def system(self) -> int:
        self.now_ns += READING_NS
        return self.now_ns + self.ahead_ns


@pytest.fixture
def clocks() -> Clocks:
    return Clocks()


@given(st.integers(0, S), st.integers(0, 2 * 10**18))
def test_a_stamp_comes_out_at_its_instant(age_ns: int, ahead_ns: int) -> None:
    clocks = Clocks(ahead_ns)
    stamps = SystemStamps(clocks.monotonic, clocks.system)
    came_ns = clocks.now_ns - age_ns
    assert abs(stamps.heard(came_ns + ahead_ns) - came_ns) <= READING_NS
    assert (stamps.steps, stamps.foreign) == (0, 0)


def test_a_step_of_the_system_s_clock_is_counted_and_followed(clocks: Clocks) -> None:
    stamps = SystemStamps(clocks.monotonic, clocks.system)
    for seconds, steps in ((3600, 1), (-2, 2), (-3600, 3)):
        clocks.ahead_ns += seconds * S
        clocks.now_ns += SAMPLE_NS
        assert abs(stamps.heard(clocks.now_ns + clocks.ahead_ns) - clocks.now_ns) <= 20 * READING_NS
        assert stamps.steps == steps
    assert stamps.foreign == 0


def test_a_large_step_is_seen_before_its_second_is_over(clocks: Clocks) -> None:
    stamps = SystemStamps(clocks.monotonic, clocks.system)
    clocks.ahead_ns += 60 * S
    assert abs(stamps.heard(clocks.now_ns + clocks.ahead_ns) - clocks.now_ns) <= 20 * READING_NS
    assert (stamps.steps, stamps.foreign) == (1, 0)


def test_slewing_is_no_step(clocks: Clocks) -> None:
    """adjtime slews by 500 ppm at most: half a millisecond in a second."""
    stamps = SystemStamps(clocks.monotonic, clocks.system)
    for _ in range(100):
        clocks.ahead_ns += STEP_NS // 2
        clocks.now_ns += SAMPLE_NS
        assert abs(stamps.heard(clocks.now_ns + clocks.ahead_ns) - clocks.now_ns) <= 20 * READING_NS
    assert stamps.steps == 0


def test_a_stamp_of_no_clock_we_know_gives_the_time_of_hearing(clocks: Clocks) -> None:
    """As those of the wire `hil`, whose time is virtual."""
    stamps = SystemStamps(clocks.monotonic, clocks.system)
    assert clocks.now_ns < stamps.heard(123_456) <= clocks.now_ns
    assert stamps.foreign == 1


def test_no_frame_comes_in_the_future(clocks: Clocks) -> None:
    stamps = SystemStamps(clocks.monotonic, clocks.system)
    assert stamps.heard(clocks.now_ns + clocks.ahead_ns + S) <= clocks.now_ns


@given(st.integers(-100, 100), st.lists(st.integers(0, 200_000), min_size=200, max_size=200), st.integers())
def test_a_controller_s_clock_that_drifts_is_followed(ppm: int, delays_ns: list[int], ahead_ns: int) -> None:
    """Its stamps come out at the instant, but for the least interrupt of the last frames and the drift meanwhile."""
    stamps = ControllerStamps()
    for k, delay_ns in enumerate(delays_ns):
        came_ns = 5 * S + k * 1_000_000
        own_ns = came_ns + ahead_ns + k * ppm
        found_ns = stamps.heard(own_ns, came_ns + delay_ns)
        least_ns = min(delays_ns[max(0, k + 1 - PAIRS) : k + 1])
        assert abs(found_ns - came_ns - least_ns) <= abs(ppm) * PAIRS


# -- a socket that the kernel stamps --

CAN_FRAME = struct.pack("=IB3x8s", 0x121, 6, b"\x01\x02\x03\x04\x05\x06\0\0")


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    """A UDP socket in place of a CAN one: SO_TIMESTAMPING is of all sockets."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as hears,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as says,
    ):
        hears.bind(("127.0.0.1", 0))
        says.connect(hears.getsockname())
        yield says, hears


def test_the_kernel_stamps_a_frame_when_it_comes_not_when_it_is_read(pair: tuple[socket.socket, socket.socket]) -> None:
    says, hears = pair
    stamped = StampedSocket(hears)
    before_ns = time.monotonic_ns()
    says.send(CAN_FRAME)
    after_ns = time.monotonic_ns()
    time.sleep(0.05)
    identifier, data, came_ns = stamped.receive(1.0)
    assert (identifier, data) == (0x121, b"\x01\x02\x03\x04\x05\x06")
    assert before_ns - STEP_NS <= came_ns <= after_ns + STEP_NS
    assert stamped.bare == 1
    assert stamped.receive(0.0) is None


def test_a_controller_s_stamp_is_taken_where_there_is_one(pair: tuple[socket.socket, socket.socket]) -> None:
    """The control message as the kernel lays it out: three timespecs, the kernel's first, the controller's last."""
    stamped = StampedSocket(pair[1])
    system_ns, own_ns = time.time_ns(), 42 * S
    for k in range(3):
        late_ns = (3 - k) * 50_000  # the kernel's stamp is late by less and less
        at_ns = system_ns + k * 1_000_000
        kernel = divmod(at_ns + late_ns, S)
        found = stamped.came_ns([STAMPS.pack(*kernel, 0, 0, *divmod(own_ns + k * 1_000_000, S))])
        expected = at_ns + late_ns - time.time_ns() + time.monotonic_ns()
        assert abs(found - min(expected, time.monotonic_ns())) < 5 * STEP_NS
    assert stamped.bare == 0


# -- what is asked of the machine --

ASK = """
import gc, json, os, sys
from hil import real_time
if len(sys.argv) > 1:
    os.setgroups([]); os.setgid(65534); os.setuid(65534)
refused = real_time.prepare(1)
locked = [line.split()[1] for line in open('/proc/self/status') if line.startswith('VmLck')]
print(json.dumps([refused, os.sched_getscheduler(0), sorted(os.sched_getaffinity(0)), locked, gc.get_freeze_count()]))
"""


@pytest.fixture
def asked(tmp_path: Path) -> Callable[..., list[Any]]:
    """A process that asks, under limits of the shell."""
    script = tmp_path / "ask.py"
    script.write_text(ASK)

    def ask(*words: str, limits: str = "true") -> list[Any]:
        command = ["bash", "-c", f'{limits}; exec "$0" "$@"', sys.executable, str(script), *words]
        ran = subprocess.run(command, capture_output=True, text=True, check=True)
        return list(json.loads(ran.stdout))

    return ask


def test_a_process_gets_what_is_permitted_or_says_what_not(asked: Callable[..., list[Any]]) -> None:
    refused, scheduler, cpus, locked, frozen = asked()
    said = " ".join(refused)
    assert (scheduler == os.SCHED_FIFO) != ("SCHED_FIFO" in said)
    assert (int(locked[0]) > 0) != ("mlockall" in said)
    assert (len(cpus) == 1 and len(os.sched_getaffinity(0)) > 1) != ("affinity" in said)
    assert frozen > 1000


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can take its own permissions away")
def test_what_is_not_permitted_is_a_line_and_no_more(asked: Callable[..., list[Any]]) -> None:
    refused, scheduler, _, locked, _ = asked("nobody", limits="ulimit -l 64 -r 0")
    assert scheduler == os.SCHED_OTHER
    assert locked == ["0"]
    assert [line.partition(":")[0] for line in refused] == ["not permitted"] * 2
    assert "SCHED_FIFO at priority 50: Operation not permitted: see `hil doctor`" in refused[0]
    assert "mlockall" in refused[1]
