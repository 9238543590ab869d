"""Random message sets on the wire, beside their bounds: `python -m tests.hil.timing.wire_sets` prints the figures.

A response is counted as the bound counts it: from the release to the end of the intermission.
"""

import random
from collections import defaultdict, deque
from collections.abc import Mapping, Sequence
from statistics import median
from typing import NamedTuple

from hil.node import Reaction
from hil.timing.frame_time import as_seen, longest_bits
from hil.timing.queues import queues
from hil.timing.response_time import Message, Response, response_times, utilisation
from hil.wire.bits import INTERMISSION_BITS, frame_bits
from hil.wire.kernel import Kernel

MS = 1_000_000
SETS = 200
HORIZON_NS = 200 * MS


class Release(NamedTuple):
    """An instance of a message: when it is queued, when it was released, what it carries."""

    queued_ns: int
    released_ns: int
    identifier: int
    data: bytes


class Sender:
    """Queues frames when they are due, and no more; those of one instant in the given order."""

    wakes_on = stores = frozenset[int]()

    def __init__(self, name: str, releases: Sequence[Release]) -> None:
        self.name = name
        self.coming = deque(sorted(releases, key=lambda each: each.queued_ns))
        self.queued: dict[int, deque[int]] = defaultdict(deque)

    def start(self, now_ns: int) -> Reaction:
        return self.wake(now_ns, [], None)

    def wake(self, now_ns: int, _stored, _cause) -> Reaction:
        sends = []
        while self.coming and self.coming[0].queued_ns <= now_ns:
            each = self.coming.popleft()
            self.queued[each.identifier].append(each.released_ns)
            sends.append((0, each.identifier, each.data))
        return 0, self.coming[0].queued_ns if self.coming else None, sends


def longest_on_wire(
    plan: Mapping[str, Sequence[Release]], fifo: frozenset[str], bit_ns: int, depths: Mapping[str, int] | None = None
) -> dict[int, int]:
    """Return the longest response of each identifier, ns, when all nodes have sent what they plan, and lost nothing.

    depths: places in transmit queues, by node, else unlimited.
    """
    kernel = Kernel(bit_ns)
    senders = {name: Sender(name, releases) for name, releases in plan.items()}
    for sender in [*senders.values(), Sender("listener", [])]:
        controller = kernel.join(sender).controller
        controller.depth = (depths or {}).get(sender.name, HORIZON_NS)
        controller.fifo = sender.name in fifo
    longest: dict[int, int] = defaultdict(int)

    def watch(end_ns: int, identifier: int, _data: bytes, sender: str) -> None:
        response_ns = end_ns + INTERMISSION_BITS * bit_ns - senders[sender].queued[identifier].popleft()
        longest[identifier] = max(longest[identifier], response_ns)

    kernel.watchers.append(watch)
    kernel.start()
    kernel.run(1000 * HORIZON_NS)
    lost = {port.name: dict(port.controller.lost) for port in kernel.ports if port.controller.lost}
    assert not lost, f"lost: {lost}"
    assert not any(queue for sender in senders.values() for queue in sender.queued.values())
    return longest


class Drawn(NamedTuple):
    """A message set: by priority, each with one sender and the data of its longest frame; FIFO nodes; the bit."""

    messages: list[Message]
    data: dict[int, bytes]
    fifo: frozenset[str]
    bit_ns: int


def draw(seed: int, nodes: int, fifo: int, shared: bool = False) -> Drawn:
    """Return a set at 30 to 95 % load on so many nodes, some of them FIFO; shared: a third has a second sender."""
    drawn = random.Random(seed)
    count = drawn.randint(5, 12)
    lengths = [drawn.randint(0, 8) for _ in range(count)]
    periods = [drawn.choice([2, 5, 5, 10, 10, 20, 50]) * MS + drawn.randint(-99, 99) * 1000 for _ in range(count)]
    bits = [longest_bits(length, False, False)[0] for length in lengths]
    bit_ns = int(drawn.uniform(0.30, 0.95) / sum(each / period for each, period in zip(bits, periods, strict=True)))
    messages = []
    for k, (length, period) in enumerate(zip(lengths, periods, strict=True)):
        jitter, sender = drawn.choice([0, drawn.randint(0, 3 * period // 2)]), frozenset({f"n{drawn.randrange(nodes)}"})
        if shared and drawn.random() < 0.33:
            sender |= {f"n{drawn.randrange(nodes)}"}
        message = Message(f"m{k}", 0x100 + 3 * k, period, period, bits[k] * bit_ns, jitter, False, sender, length)
        messages.append(message)
    data = {each.identifier: drawn.randbytes(each.length or 0) for each in messages}
    return Drawn(messages, data, frozenset(f"n{k}" for k in range(fifo)), bit_ns)


def node(message: Message) -> str:
    (name,) = message.senders
    return name


def at_random(drawn: Drawn, seed: int) -> dict[str, list[Release]]:
    """Plan offsets, jitter and data at random."""
    chance = random.Random(seed)
    plan: dict[str, list[Release]] = defaultdict(list)
    for message in drawn.messages:
        offset = chance.choice([0, chance.randint(0, message.period_ns)])
        queued_ns = 0
        for released_ns in range(offset, HORIZON_NS, message.period_ns):
            jitter_ns = chance.choice([0, message.jitter_ns, chance.randint(0, message.jitter_ns)])
            queued_ns = max(queued_ns, released_ns + jitter_ns)
            data = chance.choice([drawn.data[message.identifier], chance.randbytes(message.length or 0)])
            sender = (
                next(iter(message.senders)) if len(message.senders) == 1 else chance.choice(sorted(message.senders))
            )
            plan[sender].append(Release(queued_ns, released_ns, message.identifier, data))
    return plan


def critical(drawn: Drawn, asked: Response, seen: Sequence[Message]) -> dict[str, list[Release]]:
    """Plan the critical instant of a message, at 1 ns: the longest frame of those below has begun at 0 ns.

    Whoever may go before it is queued at 1 ns with all its jitter, then as soon as it may be; it is itself the last.
    """
    message = asked.message
    queue = [each for each in seen if node(each) in drawn.fifo and node(each) == node(message)] or [message]
    lowest = max(each.priority for each in queue)
    below = [each for each in seen if each.priority > lowest]
    plan: dict[str, list[Release]] = defaultdict(list)
    if below:
        longest = max(below, key=lambda each: each.time_ns)
        plan[node(longest)].append(Release(0, 0, longest.identifier, drawn.data[longest.identifier]))
    for each in sorted(seen, key=lambda each: (each.identifier == message.identifier, each.identifier)):
        if each.priority <= lowest:
            first_ns = 1 - each.jitter_ns
            for released_ns in range(first_ns, asked.busy_ns + 1, each.period_ns):
                release = Release(max(1, released_ns), released_ns, each.identifier, drawn.data[each.identifier])
                plan[node(each)].append(release)
    return plan


def within(seed: int, nodes: int, fifo: int, shared: bool = False) -> tuple[list[float], int]:
    """Return measured / bound of every message of a random run, and how many have no bound."""
    drawn = draw(seed, nodes, fifo, shared)
    assert 0.29 < utilisation(drawn.messages) < 0.96
    bounds = response_times(drawn.messages, drawn.bit_ns, fifo=drawn.fifo)
    depths = {row["node"]: row["frames_at_most"] for row in queues(bounds, None) if row["frames_at_most"] is not None}
    longest = longest_on_wire(at_random(drawn, seed), drawn.fifo, drawn.bit_ns, depths)
    ratios = [longest[each.message.identifier] / each.bound_ns for each in bounds if each.bound_ns is not None]
    return ratios, len(bounds) - len(ratios)


def at_critical_instants(seed: int, nodes: int, fifo: int) -> list[float]:
    """Return measured / bound at the critical instant of each message (of a FIFO only, if there is one)."""
    drawn = draw(seed, nodes, fifo)
    bits = {each.name: frame_bits(each.identifier, drawn.data[each.identifier]) for each in drawn.messages}
    seen = as_seen(drawn.messages, bits, drawn.bit_ns, drawn.bit_ns)
    ratios = []
    for asked in response_times(seen, drawn.bit_ns, fifo=drawn.fifo):
        if asked.bound_ns is None or (fifo and node(asked.message) not in drawn.fifo):
            continue
        longest = longest_on_wire(critical(drawn, asked, seen), drawn.fifo, drawn.bit_ns)
        ratios.append(longest[asked.message.identifier] / asked.bound_ns)
    return ratios


QUEUES = {"by priority": (4, 0), "one FIFO node of three": (3, 1), "three FIFO nodes": (3, 3)}
"""Nodes, and how many of them send first-in-first-out."""


def figures(name: str, sets: int = SETS) -> dict[str, float]:
    """Return measured / bound over so many sets: the largest of random runs, and what critical instants come to."""
    nodes, fifo = QUEUES[name]
    runs = [within(seed, nodes, fifo) for seed in range(sets)]
    ratios = [each for run, _ in runs for each in run]
    forced = [each for seed in range(sets) for each in at_critical_instants(seed, nodes, fifo)]
    return {
        "bounds": len(ratios),
        "without": sum(none for _, none in runs),
        "largest": max(ratios),
        "forced": len(forced),
        "forced median": median(forced),
        "forced largest": max(forced),
    }


if __name__ == "__main__":
    for kind in QUEUES:
        print(kind, figures(kind))
