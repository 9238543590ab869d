"""`make bench`, how long the analysis of 100 messages takes: their bounds, and all that `hil timing --dbc` tells."""

import random
import time
from collections.abc import Callable
from statistics import median

from rich.console import Console
from rich.table import Table

from hil.timing.analysis import analyse
from hil.timing.frame_time import longest_bits
from hil.timing.response_time import Message, response_times

RUNS = 7
MESSAGES, NODES = 100, 10
LOADS = (0.3, 0.6, 0.8, 0.95)
LIMIT_LOAD, LIMIT_MS = 0.8, 50.0
MS = 1_000_000


def drawn(load: float, seed: int = 1) -> tuple[list[Message], int]:
    """Return messages, the shorter their period the higher their priority, and the bit time that makes the load."""
    chance = random.Random(seed)
    rows = sorted((chance.choice((5, 10, 20, 50, 100, 200, 500, 1000)), chance.randint(1, 8)) for _ in range(MESSAGES))
    bits = [longest_bits(length, False, False)[0] for _, length in rows]
    bit_ns = int(load / sum(each / (period * MS) for each, (period, _) in zip(bits, rows, strict=True)))
    messages = []
    for k, ((period, length), each) in enumerate(zip(rows, bits, strict=True)):
        sender, jitter_ns = frozenset({f"n{k % NODES}"}), chance.choice((0, period * MS // 10))
        made = Message(f"m{k}", k, period * MS, period * MS, each * bit_ns, jitter_ns, False, sender, length)
        messages.append(made)
    return messages, bit_ns


def took_ms(work: Callable[[], object]) -> float:
    """Return the median wall time of some work, ms."""
    times = []
    for _ in range(RUNS):
        began = time.perf_counter()
        work()
        times.append((time.perf_counter() - began) * 1e3)
    return median(times)


def costs_ms(load: float) -> tuple[float, float, float]:
    """Return what bounds cost, with one node a FIFO, and all that is told of a database."""
    messages, bit_ns = drawn(load)
    return (
        took_ms(lambda: response_times(messages, bit_ns)),
        took_ms(lambda: response_times(messages, bit_ns, fifo={"n0"})),
        took_ms(lambda: analyse(messages, bit_ns)),
    )


def show_timing(console: Console) -> bool:
    """Print how long the analysis takes; return whether the bounds take no longer than they may."""
    title = f"analysis of {MESSAGES} messages, ms, medians of {RUNS} (limit: bounds at {LIMIT_LOAD:.0%} {LIMIT_MS:.0f})"
    table = Table(title=title)
    for column in ("load", "bounds", "with one FIFO node", "with the lowest bit rate"):
        table.add_column(column, justify="right")
    costs = {load: costs_ms(load) for load in LOADS}
    for load, each in costs.items():
        table.add_row(f"{load:.0%}", *(f"{cost:.1f}" for cost in each))
    console.print(table)
    return costs[LIMIT_LOAD][0] <= LIMIT_MS
