"""What the kernel says of its CAN interfaces, through iproute2 and /proc; and what to do where it has none."""

import fcntl
import json
import os
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import pytest

INSIDE = os.environ.get("HIL_LAB_INSIDE") == "1"
"""Whether this is the lab, where everything must be there and may be changed."""
LOSSES = ("rx_over_errors", "rx_dropped", "rx_errors", "tx_dropped", "tx_errors")
"""What an interface counts when it loses a frame."""


class Unavailable(Exception):
    """This machine has not what a test needs; the message says what and how to get it."""


def family() -> None:
    """Raise Unavailable if the kernel has no CAN at all."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        raise Unavailable(f"no CAN in this kernel ({error.strerror}): modprobe can_raw, or run make lab") from None


@contextmanager
def alone() -> Iterator[None]:
    """Have the interfaces of this machine for oneself: tests run two files at a time, and a bus is for all."""
    with Path(tempfile.gettempdir(), "hil-interfaces.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def program(name: str) -> str:
    """Return the path of a program; raise Unavailable without it."""
    path = shutil.which(name)
    if path is None:
        raise Unavailable(f"no program {name}: install can-utils and iproute2, or run make lab")
    return path


def said(*words: str) -> Any:
    """Return what `ip` or `tc` says as JSON of one interface."""
    command = [program(words[0]), "-json", *words[1:]]
    (found,) = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    return found


def link(name: str) -> dict[str, Any]:
    """Return an interface with details and statistics; raise Unavailable without it."""
    if not Path("/sys/class/net", name).exists():
        cure = "modprobe vcan; ip link add dev vcan0 type vcan; ip link set vcan0 up; " if name == "vcan0" else ""
        raise Unavailable(f"no interface {name}: {cure}or run make lab")
    found: dict[str, Any] = said("ip", "-details", "-statistics", "link", "show", name)
    if "UP" not in found["flags"]:
        raise Unavailable(f"interface {name} is down: ip link set {name} up")
    return found


def received(name: str) -> dict[str, int]:
    """Return the statistics of what an interface received."""
    return dict(link(name)["stats64"]["rx"])


def sent(name: str) -> dict[str, int]:
    """Return the statistics of what an interface sent."""
    return dict(link(name)["stats64"]["tx"])


def losses(*names: str) -> dict[str, int]:
    """Return what these interfaces have lost so far, all together."""
    folders = [Path("/sys/class/net", name, "statistics") for name in names]
    return {loss: sum(int((folder / loss).read_text()) for folder in folders) for loss in LOSSES}


def refused(name: str) -> int:
    """Return how many frames the transmit queue of an interface has refused."""
    return int(said("tc", "-statistics", "qdisc", "show", "dev", name)["drops"])


def set_link(name: str, *words: str) -> None:
    """Change an interface."""
    subprocess.run([program("ip"), "link", "set", name, *words], check=True)


def set_queue(name: str, what: str, *words: str) -> None:
    """Change what makes frames wait for an interface."""
    subprocess.run([program("tc"), "qdisc", what, "dev", name, "root", *words], check=True)


def listeners(name: str) -> int:
    """Return how many sockets listen to all frames of an interface."""
    lines = Path("/proc/net/can/rcvlist_all").read_text().splitlines()
    return sum(line.split()[0] == name for line in lines if line.strip())


def wait_for(condition: Callable[[], bool], what: str, limit_s: float = 60.0) -> None:
    """Wait until something is so; fail with its name."""
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, f"not after {limit_s:g} s: {what}"
        time.sleep(0.01)


def give_up(why: object) -> NoReturn:
    """Skip the test, loudly; in the lab, fail it."""
    if INSIDE:
        pytest.fail(str(why))
    pytest.skip(str(why))
