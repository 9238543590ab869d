"""`make bench`, what the wire alone costs: trivial nodes on `hil`, inline and as processes, beside two other buses.

The same six nodes send the same messages on each (hil/bench_nodes.py). python-can's `virtual` has a thread a node in
one process, and no time; the naive server (hil/bench_naive.py) has a process a node, and wakes each at every frame.
All of them are kept on one CPU, where each is fastest.
"""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from statistics import median

import can
from rich.console import Console
from rich.table import Table

from hil.addresses import fixed_addresses
from hil.bench.naive import run_naive
from hil.bench.nodes import ANSWERS, FRAMES_A_CYCLE, PERIOD_NS, Timeless, Trivial
from hil.drive import RUN_IS_OVER, Direct
from hil.errors import NodeError
from hil.processes import START_S, one_cpu
from hil.wire.channel import Listener
from hil.wire.kernel import Kernel
from hil.wire.server import Bus, Server

RUNS = 5
CYCLES = {"hil, inline": 5000, "hil, processes": 2000, "virtual, threads": 500, "naive, processes": 500}
FLOORS = {"hil, inline": 15.0, "hil, processes": 5.0}
"""Simulated s / wall s."""
BIT_NS = 1000
NAMES = tuple(ANSWERS)
LOOK_S = 0.2
"""Wall time after which a thread looks whether it is over."""

Carried = tuple[float, list[int]]
"""(wall s, identifiers in the order of the bus)"""


def run_inline(cycles: int) -> Carried:
    """Play the nodes in this process."""
    kernel = Kernel(BIT_NS)
    order = _identifiers(kernel)
    for name in NAMES:
        kernel.join(Direct(Trivial(name)))
    kernel.start()
    began = time.perf_counter()
    kernel.run((cycles + 1) * PERIOD_NS - 1)
    return time.perf_counter() - began, order


def run_processes(cycles: int) -> Carried:
    """Play each node in a process of its own, with what `hil run` does for them."""
    kernel = Kernel(BIT_NS)
    order = _identifiers(kernel)
    with _serve(kernel) as (server, pids), one_cpu([0, *pids]):
        server.start()
        began = time.perf_counter()
        server.run((cycles + 1) * PERIOD_NS - 1)
        return time.perf_counter() - began, order


def _identifiers(kernel: Kernel) -> list[int]:
    """Return a list that the identifiers of all frames come into."""
    order: list[int] = []
    kernel.watchers.append(lambda _end_ns, identifier, _data, _sender: order.append(identifier))
    return order


@contextmanager
def _serve(kernel: Kernel) -> Iterator[tuple[Server, list[int]]]:
    """Serve a channel on which every node has joined."""
    listener = Listener(f"bench-{os.getpid()}")
    server = Server([Bus(listener, kernel)], NAMES, lambda _name, _waited_s: None)
    command = [sys.executable, "-m", "hil.bench.nodes"]
    with fixed_addresses():
        nodes = [subprocess.Popen([*command, name, listener.channel]) for name in NAMES]
    try:
        deadline = time.monotonic() + START_S
        while server.missing():
            server.poll(0.05)
            if time.monotonic() > deadline or any(node.poll() is not None for node in nodes):
                raise NodeError(f"{', '.join(server.missing())} did not join the bus within {START_S:.0f} s")
        yield server, [node.pid for node in nodes]
    finally:
        server.end(RUN_IS_OVER)
        for node in nodes:
            node.wait()
        listener.close()


def run_virtual(cycles: int) -> Carried:
    """Play each node in a thread of its own, on python-can's interface `virtual`."""
    with one_cpu([0]):  # the threads inherit it; on two CPUs they take more than twice as long
        return _run_threads(cycles)


def _run_threads(cycles: int) -> Carried:
    over = threading.Event()
    nodes = [Timeless(name, cycles) for name in NAMES]
    buses = [_virtual(own=node.name == "dsp") for node in nodes]
    witness = _virtual(own=False)
    threads = [threading.Thread(target=_play, args=(*each, over)) for each in zip(nodes, buses, strict=True)]
    for thread in threads:
        thread.start()
    began = time.perf_counter()
    for node, bus in zip(nodes, buses, strict=True):
        _send(bus, node.begin())
    over.wait()
    wall_s = time.perf_counter() - began
    for thread in threads:
        thread.join()
    order = [message.arbitration_id for message in iter(lambda: witness.recv(0), None)]
    for bus in [*buses, witness]:
        bus.shutdown()
    return wall_s, order


def _virtual(own: bool) -> can.BusABC:
    return can.Bus(interface="virtual", channel="bench", receive_own_messages=own)


def _send(bus: can.BusABC, frames: list[tuple[int, bytes]]) -> None:
    for identifier, data in frames:
        bus.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=data))


def _play(node: Timeless, bus: can.BusABC, over: threading.Event) -> None:
    """Answer frames until the DSP has finished."""
    while not over.is_set():
        message = bus.recv(LOOK_S)
        if message is not None:
            _send(bus, node.hear(message.arbitration_id))
            if node.finished:
                over.set()


BUSES: dict[str, Callable[[int], Carried]] = {
    "hil, inline": run_inline,
    "hil, processes": run_processes,
    "virtual, threads": run_virtual,
    "naive, processes": lambda cycles: run_naive(NAMES, cycles),
}


def speed(name: str, cycles: int) -> float:
    """Return simulated s / wall s of one run."""
    wall_s, order = BUSES[name](cycles)
    if len(order) != cycles * FRAMES_A_CYCLE:
        raise NodeError(f"{name}: {len(order)} frames in {cycles} cycles: {cycles * FRAMES_A_CYCLE} are due")
    return cycles * PERIOD_NS / 1e9 / wall_s


def speeds() -> dict[str, float]:
    """Return the medians of every bus, all of them measured in turns."""
    turns = [{name: speed(name, cycles) for name, cycles in CYCLES.items()} for _ in range(RUNS)]
    return {name: median(turn[name] for turn in turns) for name in CYCLES}


def show_wire(console: Console) -> bool:
    """Print what a cycle of trivial nodes costs on each bus; return whether the floors are reached."""
    found = speeds()
    floors = ", ".join(f"{name} {floor:.0f}" for name, floor in FLOORS.items())
    table = Table(title=f"six trivial nodes, eight frames a simulated ms, medians of {RUNS} (floors: {floors})")
    for column in ("bus", "simulated s / wall s", "us a frame", "hil, processes is faster by", "hil, inline by"):
        table.add_column(column, justify="right")
    for name, reached in found.items():
        ratios = [f"{found[ours] / reached:.1f}" for ours in ("hil, processes", "hil, inline")]
        table.add_row(name, f"{reached:.2f}", f"{1e3 / reached / FRAMES_A_CYCLE:.1f}", *ratios)
    console.print(table)
    return all(found[name] >= floor for name, floor in FLOORS.items())
