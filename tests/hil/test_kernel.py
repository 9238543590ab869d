"""The kernel against a naive bus that goes from nanosecond to nanosecond, and its agreements as bus transcripts."""

from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.drive import Direct
from hil.errors import NodeError
from hil.wire.bits import frame_bits
from hil.wire.identifier import EXTENDED, REMOTE
from hil.wire.kernel import Kernel

END_NS = 4000
DEPTH = 10
"""Frames that a transmit queue holds, the one on the wire counted."""

# -- a node that answers by script, and tells what it was handed --


@dataclass(frozen=True)
class Step:
    """One reaction. timer: ns from now, None to cancel, "keep" to ask for the same instant again if it is ahead."""

    busy_ns: int = 0
    timer: int | str | None = None
    sends: tuple[tuple[int, int, bytes], ...] = ()


@dataclass(frozen=True)
class Script:
    steps: tuple[Step, ...] = (Step(),)
    wakes_on: tuple[int, ...] = ()
    stores: tuple[int, ...] = ()


class ScriptedNode:
    """Its n-th call, the start being the first, is answered by the n-th step; later ones by silence."""

    finished = False

    def __init__(self, name, script, journal):
        self.name = name
        self.wakes_on = script.wakes_on
        self.stores = script.stores
        self._steps = list(script.steps)
        self._timer_ns = None
        self._journal = journal

    def _answer(self, now_ns, *handed):
        self._journal.append((self.name, now_ns, *handed))
        step = self._steps.pop(0) if self._steps else Step()
        if step.timer == "keep":
            ahead = self._timer_ns is not None and self._timer_ns > now_ns
            self._timer_ns = self._timer_ns if ahead else None
        else:
            self._timer_ns = None if step.timer is None else now_ns + step.timer
        return step.busy_ns, self._timer_ns, list(step.sends)

    def on_start(self, now_ns):
        return self._answer(now_ns, "start")

    def on_frame(self, identifier, data, now_ns):
        return self._answer(now_ns, "frame", identifier, data)

    def on_timer(self, now_ns):
        return self._answer(now_ns, "timer")

    def store(self, identifier, data, at_ns):
        self._journal.append((self.name, at_ns, "store", identifier, data))

    def report(self):
        return {}


def nodes_of(scripts):
    """Fresh nodes a, b, c ... and the journal in which all of them write."""
    journal = []
    return [ScriptedNode(chr(ord("a") + n), script, journal) for n, script in enumerate(scripts)], journal


def join_all(kernel, nodes):
    """Join the nodes, and behind them a silent one that acknowledges; return the ports of the nodes."""
    ports = [kernel.join(Direct(node)) for node in nodes]
    kernel.join(Direct(ScriptedNode("silent", Script(), [])))
    return ports


# -- the naive bus --


def arbitration_bits(identifier):
    """What a node puts on the wire while it fights for it: 0 is dominant."""
    remote, extended = [int(identifier & REMOTE != 0)], identifier & EXTENDED != 0
    if not extended:
        ide = [0]
        return [int(bit) for bit in f"{identifier & 0x7FF:011b}"] + remote + ide
    number = f"{identifier & 0x1FFFFFFF:029b}"
    srr_ide = [1, 1]
    return [int(bit) for bit in number[:11]] + srr_ide + [int(bit) for bit in number[11:]] + remote


def wins(identifier, other):
    """Whether a frame beats another on a wired AND: at the first bit that differs, the recessive one gives way."""
    for mine, yours in zip(arbitration_bits(identifier), arbitration_bits(other), strict=False):
        if mine != yours:
            return mine == 0
    return False


def length_bits(identifier, data):
    extended, remote = identifier & EXTENDED != 0, identifier & REMOTE != 0
    number = identifier & (0x1FFFFFFF if extended else 0x7FF)
    return frame_bits(number, b"" if remote else data, extended, remote, len(data))


class NaiveBus:
    """One nanosecond after the other: end a frame, wake who is due, queue, arbitrate. Ties by node order."""

    def __init__(self, nodes, bit_ns, functional=False, start_ns=0, depth=DEPTH):
        self.nodes, self.functional, self.depth = nodes, functional, depth
        self.bit_ns = 0 if functional else bit_ns
        self.now_ns = start_ns
        self.log, self.bits_on_wire = [], 0
        self.on_wire = None  # (end, node, identifier, data)
        self.free_ns = start_ns
        self.timer, self.refused, self.busy_ns, self.inbox, self.coming, self.queue = (
            dict.fromkeys(nodes),
            dict.fromkeys(nodes, 0),
            dict.fromkeys(nodes, start_ns),
            {node: [] for node in nodes},
            {node: [] for node in nodes},
            {node: [] for node in nodes},
        )

    def run(self, end_ns):
        for node in self.nodes:
            self.take(node, node.on_start(self.now_ns))
        while True:
            self.instant()
            if self.now_ns == end_ns:
                return
            self.now_ns += 1

    def instant(self):
        while True:
            ended = self.end_frame()
            for node in self.nodes:
                self.wake(node)
            self.fill_queues()
            self.arbitrate()
            if not ended and not (self.on_wire and self.on_wire[0] == self.now_ns):
                return

    def end_frame(self):
        if self.on_wire is None or self.on_wire[0] != self.now_ns:
            return False
        end_ns, sender, identifier, data = self.on_wire
        self.on_wire, self.free_ns = None, end_ns + 3 * self.bit_ns
        self.log.append((end_ns, identifier, data, sender.name))
        for node in self.nodes:
            if node is not sender and identifier in (*node.wakes_on, *node.stores):
                self.inbox[node].append((end_ns, identifier, data))
        return True

    def wake(self, node):
        """Handle what arrived, one after the other, as long as the node is not computing."""
        while self.busy_ns[node] <= self.now_ns:
            arrivals = [at_ns for at_ns, identifier, _ in self.inbox[node] if identifier in node.wakes_on]
            timer_ns = self.timer[node]
            timer_due = timer_ns is not None and timer_ns <= self.now_ns
            if not arrivals and not timer_due:
                return
            # A timer was asked for before a frame of the same instant ended.
            by_timer = timer_due and not (arrivals and arrivals[0] < timer_ns)
            while self.inbox[node] and self.inbox[node][0][1] not in node.wakes_on:
                at_ns, identifier, data = self.inbox[node].pop(0)
                node.store(identifier, data, at_ns)
            if by_timer:
                self.timer[node] = None
                self.take(node, node.on_timer(self.now_ns))
            else:
                _, identifier, data = self.inbox[node].pop(0)
                self.take(node, node.on_frame(identifier, data, self.now_ns))

    def take(self, node, reaction):
        busy_ns, self.timer[node], sends = reaction
        self.busy_ns[node] = self.now_ns + (0 if self.functional else busy_ns)
        for delay_ns, identifier, data in sends:
            queued_ns = self.now_ns + (0 if self.functional else delay_ns)
            self.coming[node].append((queued_ns, identifier, data))

    def fill_queues(self):
        for node in self.nodes:
            due = [entry for entry in self.coming[node] if entry[0] == self.now_ns]
            for entry in due:
                self.coming[node].remove(entry)
                sending = self.on_wire is not None and self.on_wire[1] is node
                if len(self.queue[node]) + sending < self.depth:
                    self.queue[node].append(entry)
                else:
                    self.refused[node] += 1

    def arbitrate(self):
        if self.on_wire is not None or self.now_ns < self.free_ns:
            return
        best = None
        for node in self.nodes:
            for entry in self.queue[node]:
                if best is None or wins(entry[1], best[1][1]):
                    best = (node, entry)
        if best is None:
            return
        node, entry = best
        self.queue[node].remove(entry)
        bits = 0 if self.functional else length_bits(entry[1], entry[2])
        self.bits_on_wire += 0 if self.functional else bits + 3
        self.on_wire = (self.now_ns + bits * self.bit_ns, node, entry[1], entry[2])


# -- random scripts --

BASES = [0x010, 0x080, 0x101, 0x7FF]
POOL = [
    *BASES,
    0x080 | REMOTE,
    0x101 | REMOTE,
    0x101 << 18 | EXTENDED,
    0x101 << 18 | 0x2AAAA | EXTENDED,
    0x101 << 18 | 0x2AAAA | EXTENDED | REMOTE,
    0x1FFFFFFF | EXTENDED,
]

times = st.one_of(st.sampled_from([0, 50, 100, 100, 200]), st.integers(0, 400))
later = st.one_of(st.sampled_from([50, 100, 100, 200]), st.integers(1, 400))
sends = st.lists(
    st.builds(
        lambda delay_ns, identifier, data: (delay_ns, identifier, bytes(len(data)) if identifier & REMOTE else data),
        st.one_of(st.just(0), times),
        st.sampled_from(POOL),
        st.binary(max_size=8),
    ),
    max_size=3,
).map(tuple)
steps = st.builds(Step, st.one_of(st.just(0), times), st.one_of(st.none(), st.just("keep"), later, later), sends)
identifiers = st.lists(st.sampled_from(POOL), unique=True).map(tuple)
scripts = st.lists(
    st.builds(Script, st.lists(steps, min_size=1, max_size=8).map(tuple), identifiers, identifiers),
    min_size=1,
    max_size=4,
)
depths = st.sampled_from([1, 2, 3, DEPTH])


def play(scripts, bit_ns, functional, cuts=(), start_ns=0, depth=DEPTH):
    """Run the kernel, in as many parts as there are cuts; return (frames, journal, bits on the wire, refused)."""
    nodes, journal = nodes_of(scripts)
    kernel = Kernel(bit_ns, functional, start_ns)
    log = []
    kernel.watchers.append(lambda *frame: log.append(frame))
    ports = join_all(kernel, nodes)
    for port in ports:
        port.controller.depth = depth
    kernel.start()
    for until_ns in (*sorted(cuts), start_ns + END_NS):
        kernel.run(until_ns)
    return log, journal, kernel.bits_on_wire, [port.controller.lost["transmit queue full"] for port in ports]


def play_naively(scripts, bit_ns, functional, start_ns=0, depth=DEPTH):
    nodes, journal = nodes_of(scripts)
    bus = NaiveBus(nodes, bit_ns, functional, start_ns, depth)
    bus.run(start_ns + END_NS)
    return bus.log, journal, bus.bits_on_wire, [bus.refused[node] for node in nodes]


@settings(max_examples=200, deadline=None)
@given(scripts, st.integers(1, 3), st.sampled_from([0, -1000, 77]), depths)
def test_bus_in_bits_equals_the_naive_bus(scripts, bit_ns, start_ns, depth):
    expected = play_naively(scripts, bit_ns, False, start_ns, depth)
    assert play(scripts, bit_ns, False, (), start_ns, depth) == expected


@settings(max_examples=100, deadline=None)
@given(scripts, depths)
def test_functional_bus_equals_the_naive_bus(scripts, depth):
    expected = play_naively(scripts, 1, True, depth=depth)
    assert play(scripts, 1, True, depth=depth) == expected


@settings(max_examples=50, deadline=None)
@given(scripts, st.booleans(), st.lists(st.integers(0, END_NS), max_size=4))
def test_run_in_parts_is_the_run_in_one(scripts, functional, cuts):
    assert play(scripts, 1, functional, cuts) == play(scripts, 1, functional)


# -- the agreements, one by one, as transcripts --

BIT_NS = 1000
SYNC, ENCODER, CURRENT, REFERENCE = 0x080, 0x101, 0x121, 0x130
EMPTY = b""


def send(identifier, data=EMPTY, delay_ns=0):
    return (delay_ns, identifier, data)


def end_of(start_ns, identifier, data=EMPTY):
    return start_ns + BIT_NS * length_bits(identifier, data)


def after(end_ns):
    """Where the next frame may start."""
    return end_ns + 3 * BIT_NS


def transcript(*scripts, functional=False, until_ns=10_000_000):
    """Play the scripts; return [(end, identifier, sender)] and what every node was handed after its start."""
    log, journal, _ = play_until(scripts, functional, until_ns)
    return [(end_ns, identifier, sender) for end_ns, identifier, _, sender in log], [
        entry for entry in journal if entry[2] != "start"
    ]


def play_until(scripts, functional, until_ns):
    nodes, journal = nodes_of(scripts)
    kernel = Kernel(BIT_NS, functional)
    log = []
    kernel.watchers.append(lambda *frame: log.append(frame))
    join_all(kernel, nodes)
    kernel.start()
    kernel.run(until_ns)
    return log, journal, kernel


def sender(*sends, at_ns=None):
    """A node that queues frames: at the start, or by its timer."""
    if at_ns is None:
        return Script((Step(sends=sends),))
    return Script((Step(timer=at_ns), Step(sends=sends)))


def test_sync_goes_before_encoder_though_the_plant_wakes_first():
    plant, dsp = sender(send(ENCODER), at_ns=1_000_000), sender(send(SYNC), at_ns=1_000_000)
    bus, _ = transcript(plant, dsp)
    sync_end = end_of(1_000_000, SYNC)
    assert bus == [(sync_end, SYNC, "b"), (end_of(after(sync_end), ENCODER), ENCODER, "a")]


def test_frame_queued_as_it_wakes_takes_part_in_the_arbitration_of_that_instant():
    """b is woken by the frame whose end frees the bus; its answer ranks higher than what waits at a."""
    a = sender(send(REFERENCE), send(REFERENCE + 1))
    b = Script((Step(), Step(sends=(send(SYNC),))), wakes_on=(REFERENCE,))
    bus, _ = transcript(a, b)
    first = end_of(0, REFERENCE)
    second = end_of(after(first), SYNC)
    third = end_of(after(second), REFERENCE + 1)
    assert bus == [(first, REFERENCE, "a"), (second, SYNC, "b"), (third, REFERENCE + 1, "a")]


def test_frame_queued_behind_a_start_of_frame_waits_however_urgent():
    low, high = sender(send(0x7FF), at_ns=1000), sender(send(0x000), at_ns=1001)
    bus, _ = transcript(low, high)
    first = end_of(1000, 0x7FF)
    assert bus == [(first, 0x7FF, "a"), (end_of(after(first), 0x000), 0x000, "b")]


@pytest.mark.parametrize("late_ns", [0, 1, 2999, 3000])
def test_frame_queued_in_the_intermission_starts_behind_it(late_ns):
    end_ns = end_of(0, REFERENCE)
    bus, _ = transcript(sender(send(REFERENCE)), sender(send(SYNC), at_ns=end_ns + late_ns))
    assert bus[1] == (end_of(after(end_ns), SYNC), SYNC, "b")


def test_frame_queued_on_an_idle_bus_starts_at_once():
    end_ns = end_of(0, REFERENCE)
    bus, _ = transcript(sender(send(REFERENCE)), sender(send(SYNC), at_ns=end_ns + 3001))
    assert bus[1] == (end_of(end_ns + 3001, SYNC), SYNC, "b")


EXTENDED_OF_ENCODER = ENCODER << 18 | EXTENDED
PRECEDENCE = [
    pytest.param(0x101, 0x102, id="lower identifier"),
    pytest.param(0x0FF, 0x100, id="lower identifier by its first bits"),
    pytest.param(ENCODER, ENCODER | REMOTE, id="data before remote"),
    pytest.param(ENCODER, EXTENDED_OF_ENCODER, id="standard before extended of the same base"),
    pytest.param(ENCODER | REMOTE, EXTENDED_OF_ENCODER, id="standard remote before extended of the same base"),
    pytest.param(0x100 << 18 | 0x3FFFF | EXTENDED, ENCODER, id="extended of a lower base before standard"),
    pytest.param(EXTENDED_OF_ENCODER, EXTENDED_OF_ENCODER | REMOTE, id="extended data before extended remote"),
    pytest.param(EXTENDED_OF_ENCODER | REMOTE, EXTENDED_OF_ENCODER | 1, id="lower extension though remote"),
    pytest.param(0 | EXTENDED, 1, id="extended 0 before standard 1"),
    pytest.param(0, 0 | EXTENDED, id="standard 0 before extended 0"),
]


@pytest.mark.parametrize("functional", [False, True])
@pytest.mark.parametrize("nodes", ["in one node", "in two nodes"])
@pytest.mark.parametrize(("winner", "loser"), PRECEDENCE)
def test_arbitration_is_won_by(winner, loser, nodes, functional):
    if nodes == "in one node":
        bus, _ = transcript(sender(send(loser), send(winner)), functional=functional)
    else:
        bus, _ = transcript(sender(send(loser)), sender(send(winner)), functional=functional)
    assert [identifier for _, identifier, _ in bus] == [winner, loser]


def test_equal_frames_go_by_node_order_then_in_the_order_queued():
    scripts = [sender(send(SYNC, b"\x01"), send(SYNC, b"\x02")), sender(send(SYNC, b"\x03"))]
    log, _, _ = play_until(scripts, False, 10_000_000)
    assert [(sender, data) for _, _, data, sender in log] == [("a", b"\x01"), ("a", b"\x02"), ("b", b"\x03")]


def test_equal_frames_of_one_instant_go_in_the_order_asked_for():
    """The first is asked for at the start, 50 us ahead; the second by the timer that falls due then."""
    node = Script((Step(timer=50_000, sends=(send(SYNC, b"\x01", 50_000),)), Step(sends=(send(SYNC, b"\x02"),))))
    log, _, _ = play_until([node], False, 10_000_000)
    assert [data for _, _, data, _ in log] == [b"\x01", b"\x02"]


def test_intermission_is_counted_with_each_frame():
    frames = [send(SYNC, b"\x01"), send(ENCODER, bytes(8)), send(EXTENDED_OF_ENCODER), send(SYNC | REMOTE, bytes(5))]
    log, _, kernel = play_until([sender(*frames)], False, 10_000_000)
    lengths = [length_bits(identifier, data) for _, identifier, data, _ in log]
    assert kernel.bits_on_wire == sum(lengths) + 3 * len(lengths)
    assert log[-1][0] == BIT_NS * (sum(lengths) + 3 * (len(lengths) - 1))


def test_remote_frame_lasts_as_long_as_one_without_data_whatever_it_asks_for():
    log, _, _ = play_until([sender(send(ENCODER | REMOTE, bytes(8)))], False, 10_000_000)
    assert log == [(BIT_NS * frame_bits(ENCODER, b"", remote=True, dlc=8), ENCODER | REMOTE, bytes(8), "a")]


def test_sender_does_not_hear_itself():
    everything = Script((Step(sends=(send(SYNC), send(ENCODER))),), wakes_on=(SYNC,), stores=(ENCODER,))
    _, handed = transcript(everything)
    assert handed == []


def test_stored_frame_wakes_nobody():
    _, handed = transcript(sender(send(REFERENCE)), Script(stores=(REFERENCE,)))
    assert handed == []


def test_stored_frame_behind_a_wake_up_is_not_visible_before_that_is_handled():
    """While b computes come Encoder, Reference, Encoder: the first Encoder is handled without the Reference."""
    a = sender(
        send(CURRENT), send(ENCODER, b"\x01", 100_000), send(REFERENCE, EMPTY, 200_000), send(ENCODER, b"\x02", 300_000)
    )
    b = Script((Step(), Step(busy_ns=500_000)), wakes_on=(CURRENT, ENCODER), stores=(REFERENCE,))
    bus, handed = transcript(a, b)
    current_end, _, reference_end, _ = [end_ns for end_ns, _, _ in bus]
    done_ns = current_end + 500_000
    assert handed == [
        ("b", current_end, "frame", CURRENT, EMPTY),
        ("b", done_ns, "frame", ENCODER, b"\x01"),
        ("b", reference_end, "store", REFERENCE, EMPTY),
        ("b", done_ns, "frame", ENCODER, b"\x02"),
    ]


def test_stored_frame_is_visible_to_a_timer_of_the_same_instant():
    end_ns = end_of(0, REFERENCE)
    _, handed = transcript(sender(send(REFERENCE)), Script((Step(timer=end_ns),), stores=(REFERENCE,)))
    assert handed == [("b", end_ns, "store", REFERENCE, EMPTY), ("b", end_ns, "timer")]


def test_frames_that_arrive_while_a_node_computes_are_handled_when_it_is_done_in_order_of_arrival():
    """The more urgent SYNC arrives last and is handled last; each takes its own computing time."""
    a = sender(send(REFERENCE), send(CURRENT, EMPTY, 10_000), send(SYNC, EMPTY, 110_000))
    b = Script(
        (Step(), Step(300_000, None, (send(0x700, EMPTY, 300_000),)), Step(20_000), Step()),
        wakes_on=(REFERENCE, CURRENT, SYNC),
    )
    bus, handed = transcript(a, b)
    first = end_of(0, REFERENCE)
    assert handed == [
        ("b", first, "frame", REFERENCE, EMPTY),
        ("b", first + 300_000, "frame", CURRENT, EMPTY),
        ("b", first + 320_000, "frame", SYNC, EMPTY),
    ]
    assert bus[-1] == (end_of(first + 300_000, 0x700), 0x700, "b")


def test_timer_that_falls_due_while_a_node_computes_is_handled_when_it_is_done():
    b = Script((Step(timer=100), Step(500, 50), Step()))
    _, handed = transcript(b)
    assert handed == [("a", 100, "timer"), ("a", 600, "timer")]


@pytest.mark.parametrize("before_done_ns", [2, 1, 0])
def test_waiting_frame_goes_before_a_timer_that_fell_due_after_it(before_done_ns):
    """The frame has ended 5 us before the node gets done; the timer falls due after the frame, at the latest as the
    node gets done."""
    end_ns = end_of(0, SYNC)
    done_ns = end_ns + 5000
    b = Script((Step(busy_ns=done_ns, timer=done_ns - before_done_ns), Step(timer=1), Step()), wakes_on=(SYNC,))
    _, handed = transcript(sender(send(SYNC)), b)
    assert handed[0] == ("b", done_ns, "frame", SYNC, EMPTY)


def test_timer_is_replaced_by_an_int():
    end_ns = end_of(0, SYNC)
    for other_ns in (end_ns + 10, end_ns + 1_000_000):
        b = Script((Step(timer=end_ns + 500), Step(timer=other_ns - end_ns)), wakes_on=(SYNC,))
        _, handed = transcript(sender(send(SYNC)), b)
        assert handed == [("b", end_ns, "frame", SYNC, EMPTY), ("b", other_ns, "timer")]


def test_timer_is_cancelled_by_none():
    b = Script((Step(timer=500_000), Step(timer=None)), wakes_on=(SYNC,))
    _, handed = transcript(sender(send(SYNC)), b)
    assert handed == [("b", end_of(0, SYNC), "frame", SYNC, EMPTY)]


def test_timer_cancelled_and_asked_for_again_fires_once():
    a = sender(send(SYNC), send(ENCODER))
    first = end_of(0, SYNC)
    second = end_of(after(first), ENCODER)
    b = Script((Step(timer=500_000), Step(timer=None), Step(timer=500_000 - second)), wakes_on=(SYNC, ENCODER))
    _, handed = transcript(a, b)
    assert handed[2:] == [("b", 500_000, "timer")]


def test_timer_may_be_due_at_the_start_itself():
    """As the plant's and the DSP's are: they begin at the next multiple of the period, which may be now."""
    _, handed = transcript(Script((Step(timer=0),)))
    assert handed == [("a", 0, "timer")]


@pytest.mark.parametrize("timer", [0, -1, -1_000_000])
def test_timer_that_is_not_ahead_is_refused_by_name(timer):
    for early in (Script((Step(timer=100), Step(timer=timer))), Script((Step(), Step(timer=timer)), wakes_on=(SYNC,))):
        with pytest.raises(NodeError, match=r"^b: timer .* ns, but it is already \d+ ns"):
            transcript(sender(send(SYNC)), early)


def test_timer_behind_the_start_is_refused_by_name():
    with pytest.raises(NodeError, match=r"^b\b"):
        transcript(sender(send(SYNC)), Script((Step(timer=-1),)))


@pytest.mark.parametrize(
    "step",
    [
        pytest.param(Step(sends=(send(SYNC, EMPTY, -1),)), id="a frame queued before the call"),
        pytest.param(Step(busy_ns=-1), id="negative computing time"),
        pytest.param(Step(sends=(send(SYNC, bytes(9)),)), id="nine bytes"),
        pytest.param(Step(sends=(send(0x800),)), id="standard identifier of 12 bits"),
    ],
)
def test_impossible_reaction_is_refused_by_name(step):
    with pytest.raises(NodeError, match=r"^b\b"):
        transcript(Script(), Script((Step(timer=100), step)))


def test_time_never_goes_back():
    """Whatever a node asks for: the ends of frames ascend, and so do the instants that nodes are handed."""
    b = Script((Step(timer=100_000), Step(sends=(send(SYNC, EMPTY, -90_000),))))
    try:
        _, journal, _ = play_until([Script((Step(timer=100_000), Step(timer=10))), b], False, 10_000_000)
    except NodeError:
        return
    instants = [now_ns for _, now_ns, *_ in journal]
    assert instants == sorted(instants)


class TestFunctional:
    """Frames and computing take no time; frames of one instant go in identifier order, reactions joining the queue."""

    def test_frame_and_computing_take_no_time(self):
        a = sender(send(ENCODER, bytes(8), 5000), at_ns=1000)
        b = Script((Step(), Step(200_000, None, (send(CURRENT, bytes(8), 200_000),))), wakes_on=(ENCODER,))
        log, _, kernel = play_until([a, b], True, 10_000_000)
        assert log == [(1000, ENCODER, bytes(8), "a"), (1000, CURRENT, bytes(8), "b")]
        assert kernel.bits_on_wire == 0

    def test_frames_of_one_instant_go_in_identifier_order(self):
        a, b = sender(send(0x300), send(0x100), at_ns=7), sender(send(0x200), send(0x080), at_ns=7)
        bus, _ = transcript(a, b, functional=True)
        assert bus == [(7, 0x080, "b"), (7, 0x100, "a"), (7, 0x200, "b"), (7, 0x300, "a")]

    def test_frames_of_a_reaction_join_the_queue(self):
        """b answers Encoder with Current and 0x200: Current overtakes what waits of a, 0x200 goes between."""
        a = sender(send(ENCODER), send(0x130), send(0x300), at_ns=7)
        b = Script((Step(), Step(sends=(send(0x200), send(CURRENT)))), wakes_on=(ENCODER,))
        bus, _ = transcript(a, b, functional=True)
        assert [identifier for _, identifier, _ in bus] == [ENCODER, CURRENT, 0x130, 0x200, 0x300]

    def test_one_cycle_of_the_robot(self):
        """Sync, Encoder_1..2, the currents that answer them, and AccelRef, which comes last, all at kT."""
        plant = sender(send(0x101), send(0x102), at_ns=1000)
        dsp = Script(
            (Step(timer=1000), Step(sends=(send(SYNC),)), Step(200_000, None, (send(REFERENCE, EMPTY, 200_000),))),
            wakes_on=(0x102,),
        )
        joints = [Script((Step(), Step(125_000, None, (send(0x120 + n),))), wakes_on=(0x100 + n,)) for n in (1, 2)]
        bus, _ = transcript(plant, dsp, *joints, functional=True)
        assert bus == [
            (1000, SYNC, "b"),
            (1000, 0x101, "a"),
            (1000, 0x102, "a"),
            (1000, 0x121, "c"),
            (1000, 0x122, "d"),
            (1000, REFERENCE, "b"),
        ]


def test_observer_sends_from_outside_at_the_instant_reached():
    nodes, journal = nodes_of([Script((Step(),), wakes_on=(SYNC,))])
    kernel = Kernel(BIT_NS)
    kernel.join(Direct(nodes[0]))
    outsider = kernel.join(Direct(ScriptedNode("outside", Script(), [])))
    kernel.start()
    kernel.run(12_345)
    outsider.queue((SYNC, EMPTY))
    kernel.run(1_000_000)
    assert journal[1:] == [("a", end_of(12_345, SYNC), "frame", SYNC, EMPTY)]


def test_nothing_happens_behind_a_stop():
    nodes, journal = nodes_of([sender(send(SYNC), send(ENCODER)), Script(wakes_on=(SYNC, ENCODER))])
    kernel = Kernel(BIT_NS)
    log = []

    def stop_at_sync(*frame):
        log.append(frame)
        kernel.stopped = True

    kernel.watchers.append(stop_at_sync)
    for node in nodes:
        kernel.join(Direct(node))
    kernel.start()
    kernel.run(1_000_000)
    kernel.run(2_000_000)
    assert [identifier for _, identifier, _, _ in log] == [SYNC]
    assert [entry for entry in journal if entry[2] == "frame"] == []
    assert kernel.now_ns == end_of(0, SYNC)


class TestTransmitQueue:
    """A controller holds ten frames, the one on the wire among them; what finds no room is refused and counted."""

    def test_ten_frames_find_room_the_eleventh_does_not(self):
        frames = [send(SYNC, bytes([number])) for number in range(12)]
        log, _, kernel = play_until([sender(*frames)], False, 10_000_000)
        assert [data for _, _, data, _ in log] == [data for _, _, data in frames[:10]]
        assert kernel.ports[0].controller.lost == {"transmit queue full": 2}

    @pytest.mark.parametrize(("after_ns", "sent"), [(-1, 10), (0, 11), (1, 11)])
    def test_there_is_room_again_when_a_frame_has_ended(self, after_ns, sent):
        frames = [send(SYNC)] * 10
        first_end = end_of(0, SYNC)
        node = Script((Step(timer=first_end + after_ns, sends=tuple(frames)), Step(sends=(send(ENCODER),))))
        log, _, _ = play_until([node], False, 10_000_000)
        assert len(log) == sent

    def test_urgent_frame_is_refused_like_any_other(self):
        bus, _ = transcript(sender(*[send(0x7FF)] * 10, send(0x000)))
        assert [identifier for _, identifier, _ in bus] == [0x7FF] * 10

    def test_room_goes_to_the_frame_that_was_asked_for_first(self):
        """Both enter the queue at 50 us: one asked for at the start, the other by the timer that falls due then."""
        steps = (Step(timer=50_000, sends=(send(SYNC, b"\x01", 50_000),)), Step(sends=(send(SYNC, b"\x02"),)))
        kernel, log = Kernel(BIT_NS), []
        kernel.watchers.append(lambda *frame: log.append(frame))
        nodes, _ = nodes_of([Script(steps)])
        (port,) = join_all(kernel, nodes)
        port.controller.depth = 1
        kernel.start()
        kernel.run(1_000_000)
        assert [data for _, _, data, _ in log] == [b"\x01"]

    def test_queue_of_a_neighbour_has_its_own_room(self):
        bus, _ = transcript(sender(*[send(ENCODER)] * 10), sender(*[send(SYNC)] * 10))
        assert [name for *_, name in bus] == ["b"] * 10 + ["a"] * 10

    def test_depth_is_the_controllers(self):
        kernel = Kernel(BIT_NS)
        log = []
        kernel.watchers.append(lambda *frame: log.append(frame))
        nodes, _ = nodes_of([sender(*[send(SYNC)] * 20)])
        (port,) = join_all(kernel, nodes)
        port.controller.depth = 17
        kernel.start()
        kernel.run(10_000_000)
        assert (len(log), port.controller.sent, port.controller.lost["transmit queue full"]) == (17, 17, 3)


class TestAcknowledgement:
    """A frame that nobody acknowledges is sent again and again (ISO 11898-1, 10.9.6 and 12.1.4)."""

    # SOF to ACK slot; then, instead of ACK delimiter and EOF, error flag, error delimiter, intermission.
    ATTEMPT_NS = BIT_NS * (length_bits(SYNC, EMPTY) - 8 + 6 + 8 + 3)
    SUSPEND_NS = BIT_NS * 8

    def alone(self, script):
        nodes, _ = nodes_of([script])
        kernel, log = Kernel(BIT_NS), []
        kernel.watchers.append(lambda *frame: log.append(frame))
        port = kernel.join(Direct(nodes[0]))
        kernel.start()
        return kernel, port, log

    def test_node_alone_sends_again_and_again_and_becomes_error_passive_never_bus_off(self):
        kernel, port, log = self.alone(sender(send(SYNC)))
        error_ns = self.ATTEMPT_NS - BIT_NS * 17
        controller = port.controller
        for attempt in range(1, 17):
            kernel.run(error_ns - 1)
            assert (controller.confinement.tec, controller.repeated) == (8 * (attempt - 1), attempt - 1)
            kernel.run(error_ns)
            assert (controller.confinement.tec, controller.repeated) == (8 * attempt, attempt)
            error_ns += self.ATTEMPT_NS
        assert controller.counts()["state"] == "error-passive"
        for attempt in range(17, 40):
            error_ns += self.SUSPEND_NS
            kernel.run(error_ns - 1)
            assert controller.repeated == attempt - 1
            kernel.run(error_ns)
            assert controller.repeated == attempt
            error_ns += self.ATTEMPT_NS
        assert controller.counts() == {
            "sent": 0, "received": 0, "repeated": 39, "lost": {}, "errors": {"ACK": 39}, "tec": 128, "rec": 0,
            "state": "error-passive",
        }  # fmt: skip
        assert log == []

    def test_whoever_joins_in_the_middle_of_an_attempt_acknowledges_the_next(self):
        kernel, port, log = self.alone(sender(send(SYNC)))
        kernel.run(self.ATTEMPT_NS + 1)
        kernel.join(Direct(ScriptedNode("late", Script(), [])))
        kernel.run(10_000_000)
        assert log == [(end_of(2 * self.ATTEMPT_NS, SYNC), SYNC, EMPTY, "a")]
        assert (port.controller.repeated, port.controller.confinement.tec) == (2, 2 * 8 - 1)

    @pytest.mark.parametrize("count", [1, 3])
    def test_who_listens_only_does_not_acknowledge(self, count):
        nodes, _ = nodes_of([sender(send(SYNC)), *[Script(wakes_on=(SYNC,))] * count])
        kernel, log = Kernel(BIT_NS), []
        kernel.watchers.append(lambda *frame: log.append(frame))
        ports = [kernel.join(Direct(node)) for node in nodes]
        for port in ports[1:]:
            port.controller.listen_only = True
        kernel.medium.assess()
        kernel.start()
        kernel.run(1_000_000)
        assert log == []
        assert ports[0].controller.repeated > 1
        kernel.medium.listen_only(ports[-1], False)
        kernel.run(2_000_000)
        assert [frame[1:] for frame in log] == [(SYNC, EMPTY, "a")]
        assert all(port.controller.received >= 1 for port in ports[1:])

    def test_error_passive_node_acknowledges_too(self):
        nodes, _ = nodes_of([sender(send(SYNC)), Script()])
        kernel, log = Kernel(BIT_NS), []
        kernel.watchers.append(lambda *frame: log.append(frame))
        _, port = [kernel.join(Direct(node)) for node in nodes]
        port.controller.confinement.rec = 130
        kernel.medium.assess()
        kernel.start()
        kernel.run(1_000_000)
        assert len(log) == 1
        assert 119 <= port.controller.confinement.rec <= 127

    def test_functional_bus_needs_no_acknowledgement(self):
        nodes, _ = nodes_of([sender(send(SYNC))])
        kernel, log = Kernel(BIT_NS, functional=True), []
        kernel.watchers.append(lambda *frame: log.append(frame))
        kernel.join(Direct(nodes[0]))
        kernel.start()
        kernel.run(0)
        assert log == [(0, SYNC, EMPTY, "a")]
