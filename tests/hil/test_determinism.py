"""The same bus fifty times: at any pace, with clients as threads and as processes that are stopped now and then.

Three timed clients contend for the bus, under bit errors by a seed; what is compared is every frame and every error
with its instant. The machine decides nothing but how long it takes.
"""

import hashlib
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from math import inf

import can
import pytest

from hil.drive import RUN_IS_OVER
from hil.pace import Pace
from hil.wire.channel import Listener
from hil.wire.fault import BitErrorRate
from hil.wire.faults import FaultScript
from hil.wire.kernel import Kernel
from hil.wire.protocol import FAR_NS
from hil.wire.server import Bus, Server

pytestmark = [pytest.mark.usefixtures("runtime")]

NAMES = ("a", "b", "c")
RUNS_IN_THREADS, RUNS_IN_PROCESSES = 42, 8
MESSAGES = 20

CLIENT = """
import sys
from tests.hil.test_determinism import client
client(sys.argv[1])
"""


def client(name: str) -> None:
    """Send by turns with the others and at the same instants, wait by filter and by timeout, answer what is heard."""
    number = NAMES.index(name)
    with can.Bus(interface="hil", channel="same", name=name, timed=True, wait_s=20) as bus:
        bus.send_periodic(can.Message(arbitration_id=0x300 + number, data=b"tick", is_extended_id=False), 0.0017)
        for k in range(MESSAGES):
            bus.send(
                can.Message(arbitration_id=0x100 + (number + k) % 3, data=bytes([k, number]), is_extended_id=False)
            )
            heard = bus.recv(timeout=1e-3)
            if heard is not None and not heard.is_error_frame and k % 4 == number:
                bus.send(can.Message(arbitration_id=0x18DA0000 + number, data=heard.data))
            for _ in range(3):
                bus.recv(timeout=5e-4 * (1 + number))


def serve(start: Callable[[], None], pace: float) -> str:
    """Play one session; return the hash over all that happened."""
    digest = hashlib.sha256()
    with closing(Listener("same")) as listener:
        kernel = Kernel(1000)
        FaultScript([BitErrorRate(rate=1e-3)], seed=5).install(kernel)
        kernel.watchers.append(lambda *frame: digest.update(repr(frame).encode()))
        kernel.listeners.append(lambda event: digest.update(repr((event.port.name, *event[:1], *event[2:])).encode()))
        server = Server([Bus(listener, kernel)], NAMES, lambda _name, _s: None, Pace(pace))
        start()
        while server.missing():
            server.poll(0.05)
        server.start()
        server.run(FAR_NS)
        server.end(RUN_IS_OVER)
        assert server.deterministic
    return digest.hexdigest()


def in_threads(pace: float) -> str:
    with ThreadPoolExecutor(len(NAMES)) as pool:
        playing: list[object] = []
        return serve(lambda: playing.extend(pool.submit(client, name) for name in NAMES), pace)


def in_processes(pace: float, stopped: int) -> str:
    """Stop one of the processes again and again while they play."""
    processes: list[subprocess.Popen[bytes]] = []

    def start() -> None:
        processes.extend(subprocess.Popen([sys.executable, "-c", CLIENT, name]) for name in NAMES)

    def disturb() -> None:
        while len(processes) <= stopped:
            time.sleep(0.005)
        while processes[stopped].poll() is None:
            processes[stopped].send_signal(signal.SIGSTOP)
            time.sleep(0.01)
            processes[stopped].send_signal(signal.SIGCONT)
            time.sleep(0.005)

    disturber = threading.Thread(target=disturb, daemon=True)
    disturber.start()
    try:
        found = serve(start, pace)
    finally:
        for process in processes:
            process.wait(20)
    disturber.join(20)
    return found


def test_fifty_runs_have_one_log() -> None:
    threads = [in_threads(1.0 if run % 3 == 0 else inf) for run in range(RUNS_IN_THREADS)]
    processes = [in_processes(1.0 if run % 2 else inf, run % len(NAMES)) for run in range(RUNS_IN_PROCESSES)]
    assert len(threads) + len(processes) == 50
    assert set(threads + processes) == {threads[0]}
