"""`make bench`, how the wire scales: wall time of a frame against clients, load, and how many accept it.

Clients are nodes that are called inline, observers, or timed clients; those at sockets share one process, on the CPU of
the bus. The claim: what a frame costs grows no faster than the number of clients that accept it.
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.table import Table

from hil.addresses import fixed_addresses
from hil.bench.clients import BIT_NS, Case, Sender, acceptors
from hil.drive import RUN_IS_OVER, Direct
from hil.errors import NodeError
from hil.processes import START_S, one_cpu
from hil.wire.channel import Listener
from hil.wire.kernel import Kernel
from hil.wire.server import Bus, Server

CLIENTS = (2, 4, 8, 16, 32, 64)
LOADS = (0.1, 0.25, 0.5, 0.75, 1.0)
USUAL_CLIENTS, USUAL_LOAD = 8, 0.5
RUNS = 5
BATCHES = {"inline": 1000, "observers": 1000, "timed": 200}
"""Batches of frames in one run, by kind of client."""
MARGIN = 1.5
"""How much more than in proportion counts as more; below it, noise."""

Costs = dict[Case, float]
"""Wall us a frame."""


# -- one run --


def cost_us(case: Case) -> float:
    """Return the wall us a frame of one run."""
    kernel = Kernel(BIT_NS)
    sender = Sender(case)
    if case.kind == "inline":
        for node in (sender, *acceptors(case)):
            kernel.join(Direct(node))
        kernel.start()
        return _time(kernel.run, sender, kernel)
    with _serve(case, kernel) as (server, pid), one_cpu([0, pid]):
        server.start()
        kernel.join(Direct(sender)).begin()
        return _time(_until_all_is_seen(server), sender, kernel)


def _until_all_is_seen(server: Server) -> Callable[[int], None]:
    """Return what runs a server until observers have got every frame, too."""

    def run(until_ns: int) -> None:
        server.run(until_ns)
        while any(observer.unsent for observer in server.observers):
            server.poll(0.0001)

    return run


def _time(run: Callable[[int], None], sender: Sender, kernel: Kernel) -> float:
    case = sender.case
    batch_ns = case.batch(0)[1]
    run(10 * batch_ns)
    sent_before, now_ns = sender.sent, kernel.now_ns
    began = time.perf_counter()
    run(now_ns + BATCHES[case.kind] * batch_ns)
    return (time.perf_counter() - began) * 1e6 / (sender.sent - sent_before)


@contextmanager
def _serve(case: Case, kernel: Kernel) -> Iterator[tuple[Server, int]]:
    """Serve a channel on which all clients of a case have joined."""
    listener = Listener(f"bench-{os.getpid()}")
    server = Server([Bus(listener, kernel)], (), lambda _name, _waited_s: None)
    words = [case.kind, str(case.clients), str(int(case.everyone)), str(case.load), listener.channel]
    with fixed_addresses():
        process = subprocess.Popen([sys.executable, "-m", "hil.bench.clients", *words])
    try:
        deadline = time.monotonic() + START_S
        while len(server.timed) + len(server.observers) < case.clients:
            server.poll(0.05)
            if time.monotonic() > deadline or process.poll() is not None:
                raise NodeError(f"{case}: the clients did not join within {START_S:.0f} s")
        yield server, process.pid
    finally:
        server.end(RUN_IS_OVER)
        process.wait()
        listener.close()


# -- all of them --


def cases() -> list[Case]:
    """Return every number of clients at the usual load, and every load with the usual number of clients."""
    chosen = [(clients, USUAL_LOAD) for clients in CLIENTS] + [(USUAL_CLIENTS, load) for load in LOADS]
    return [
        Case(kind, clients, everyone, load)
        for kind in BATCHES
        for everyone in (False, True)
        for clients, load in dict.fromkeys(chosen)
    ]


def measure() -> Costs:
    """Return the best of every case's runs, measured in turns: what else the machine does only adds."""
    turns = [{case: cost_us(case) for case in cases()} for _ in range(RUNS)]
    return {case: min(turn[case] for turn in turns) for case in turns[0]}


def excesses(costs: Costs) -> dict[Case, float]:
    """Return by how much a frame costs more than in proportion to those that accept it, against the fewest clients."""
    found = {}
    for case, cost in costs.items():
        if case.load == USUAL_LOAD:
            fewest = case._replace(clients=CLIENTS[0])
            found[case] = cost / costs[fewest] / (case.acceptors / fewest.acceptors)
    return found


def show_scaling(console: Console, costs: Costs) -> bool:
    """Print what a frame costs; return whether that grows no faster than the number of clients that accept it."""
    for title, by in (
        (f"clients, load {USUAL_LOAD:.0%}", [(f"{clients}", clients, USUAL_LOAD) for clients in CLIENTS]),
        (f"load, {USUAL_CLIENTS} clients", [(f"{load:.0%}", USUAL_CLIENTS, load) for load in LOADS]),
    ):
        table = Table(title=f"wall us a frame by {title}, best of {RUNS} runs")
        for column in ("clients are", "accepted by", *(label for label, _, _ in by)):
            table.add_column(column, justify="right")
        for kind in BATCHES:
            for everyone in (False, True):
                found = [costs[Case(kind, clients, everyone, load)] for _, clients, load in by]
                table.add_row(kind, "all" if everyone else "one", *(f"{cost:.1f}" for cost in found))
        console.print(table)
    worst, excess = max(excesses(costs).items(), key=lambda item: item[1])
    console.print(
        f"cost a frame against the number of clients that accept it: at most {excess:.2f} times in proportion "
        f"(limit {MARGIN}; {worst.clients} clients, {worst.kind}, accepted by {'all' if worst.everyone else 'one'})"
    )
    return excess <= MARGIN
