"""A bus that is never idle: eight nodes whose queues are always full, for one simulated second.

Ref: ISO 11898-1:2015, 10.8 (arbitration); Davis et al., "Controller Area Network (CAN) Schedulability Analysis:
Refuted, Revisited and Revised" (2007), 3 (priority queues); "Controller Area Network (CAN) Schedulability Analysis
with FIFO Queues" (2011).
"""

import random
from collections import Counter, deque

import pytest

from hil.wire.duration import duration_ns
from hil.wire.identifier import BRS, EXTENDED, EXTENDED_MASK, FD
from hil.wire.kernel import Kernel

SECOND = 1_000_000_000
DEPTH = 10
NODES = 8


class Greedy:
    """Fills its queue whenever it is told that a place is free, with frames of identifiers of its own, at random."""

    wakes_on = ()
    stores = ()

    def __init__(self, number, fd, seed):
        self.name = f"n{number}"
        self._random = random.Random(seed)
        self._fd = fd
        self._number = number
        self.asked = 0

    def start(self, _now_ns):
        return 0, None, []

    def frame(self):
        """One of 16 identifiers, the number of the node in the last bits."""
        self.asked += 1
        dice = self._random
        identifier = dice.randrange(16) << 3 | self._number | dice.randrange(16) << 7
        if dice.random() < 0.3:
            identifier = identifier << 18 | dice.randrange(1 << 15) << 3 | self._number | EXTENDED
        if self._fd and dice.random() < 0.7:
            return identifier | FD | BRS * (dice.random() < 0.8), bytes(dice.choice((0, 8, 12, 64)))
        return identifier, dice.randbytes(dice.randrange(9))


class Run:
    """The log of a second: frames (end, identifier, data, node), and what each node queued when."""

    def __init__(self, fifo=False, data_bit_ns=None, seed=1):
        self.kernel = Kernel(bit_ns=1000, data_bit_ns=data_bit_ns)
        self.nodes = [Greedy(number, data_bit_ns is not None, seed + number) for number in range(NODES)]
        self.ports = [self.kernel.join(node) for node in self.nodes]
        self.log, self.queued = [], {node.name: [] for node in self.nodes}
        for port in self.ports:
            port.controller.fifo = fifo
        self.kernel.watchers.append(self._ended)
        self.kernel.start()
        for node, port in zip(self.nodes, self.ports, strict=True):
            for _ in range(DEPTH):
                self._queue(node, port)
        self._of = {node.name: (node, port) for node, port in zip(self.nodes, self.ports, strict=True)}
        self.kernel.run(SECOND)

    def _ended(self, end_ns, identifier, data, sender):
        self.log.append((end_ns, identifier, data, sender))
        self._queue(*self._of[sender])

    def _queue(self, node, port):
        identifier, data = node.frame()
        assert self.kernel.medium.queue(port, identifier, data)
        self.queued[node.name].append((self.kernel.now_ns, identifier, data))


def rank(identifier):
    """What the wire compares: SOF is equal; identifier, RTR or SRR, IDE, extension."""
    number = identifier & EXTENDED_MASK
    if identifier & EXTENDED:
        return f"{number >> 18:011b}11{number & 0x3FFFF:018b}0"
    return f"{number:011b}00"


def naive(run, fifo):
    """Replay what was queued on a bus that looks at every head each time it is free."""
    waiting = {name: deque() for name in run.queued}
    ahead = {name: deque(frames) for name, frames in run.queued.items()}
    now_ns, log = 0, []
    while True:
        for name, frames in ahead.items():
            while frames and frames[0][0] <= now_ns:
                waiting[name].append(frames.popleft())
        heads = []
        for name, frames in waiting.items():
            choice = frames[0] if fifo else min(frames, key=lambda frame: rank(frame[1]))
            heads.append((rank(choice[1]), name, choice))
        _, name, frame = min(heads)
        waiting[name].remove(frame)
        end_ns = now_ns + duration_ns(frame[1], frame[2], run.kernel.rates)
        if end_ns > SECOND:
            return log
        log.append((end_ns, frame[1], frame[2], name))
        now_ns = end_ns + 3000


VARIANTS = {
    "classic": {},
    "classic, first-in-first-out": {"fifo": True},
    "FD": {"data_bit_ns": 200},
    "FD, first-in-first-out": {"fifo": True, "data_bit_ns": 125},
}


@pytest.fixture(scope="module", params=VARIANTS)
def run(request):
    return request.param, Run(**VARIANTS[request.param])


def test_the_load_is_full_with_intermission_counted(run):
    """The only bits that may be missing are those of the frame that does not end within the second."""
    _, run = run
    busy_ns = sum(duration_ns(identifier, data, run.kernel.rates) + 3000 for _, identifier, data, _ in run.log)
    assert busy_ns >= 0.999 * SECOND
    first_end = run.log[0][0]
    assert first_end == duration_ns(run.log[0][1], run.log[0][2], run.kernel.rates)
    assert run.log[-1][0] + 3000 == busy_ns  # not one bit of idle bus between them


def test_frames_follow_each_other_after_exactly_three_bits(run):
    _, run = run
    last_end = -3000
    for end_ns, identifier, data, _ in run.log:
        assert end_ns - duration_ns(identifier, data, run.kernel.rates) == last_end + 3000
        last_end = end_ns


def test_no_priority_inversion_among_what_may_be_sent(run):
    """Frame by frame the same as on a naive bus: no head of higher priority ever waits behind another."""
    name, run = run
    expected = naive(run, fifo="first" in name)
    assert [frame[0] for frame in run.log] == [frame[0] for frame in expected]
    assert run.log == expected


def test_nothing_is_lost_uncounted(run):
    _, run = run
    sent = Counter(frame[3] for frame in run.log)
    for node, port in zip(run.nodes, run.ports, strict=True):
        controller = port.controller
        assert controller.sent == sent[node.name]
        assert controller.queued == DEPTH
        assert node.asked == controller.sent + controller.queued
        assert not controller.lost
        assert not controller.errors
        queued = Counter((identifier, data) for _, identifier, data in run.queued[node.name])
        assert Counter(frame[1:3] for frame in run.log if frame[3] == node.name) <= queued


def test_first_in_first_out_keeps_each_nodes_order(run):
    name, run = run
    for node in run.nodes:
        mine = [frame[1:3] for frame in run.log if frame[3] == node.name]
        asked = [(identifier, data) for _, identifier, data in run.queued[node.name]][: len(mine)]
        assert (mine == asked) == ("first" in name) or not mine


def test_a_full_queue_refuses_more_and_counts_it(run):
    _, run = run
    port = run.ports[0]
    before = port.controller.lost["transmit queue full"]
    assert not run.kernel.medium.queue(port, 0x7FF, b"")
    assert port.controller.lost["transmit queue full"] == before + 1
    port.controller.lost.clear()
