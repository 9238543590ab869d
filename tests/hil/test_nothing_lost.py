"""Random traffic under random faults: every frame is accounted for, every run can be had again.

Ref: Bosch, CAN Specification 2.0 (1991), part B, 4 (message validation), 8 (fault confinement).
"""

from collections import Counter

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil.wire.confinement import ERROR_ACTIVE
from hil.wire.events import STATUS
from hil.wire.fault import Babble, BitError, BitErrorRate, CutOff, Overrun, QueueDelay, StuckDominant
from hil.wire.identifier import BRS, EXTENDED, FD, REMOTE

NAMES = "abcd"
SPAN = 1500
END = 20_000
"""Bits; by then everything has been sent that can be."""

IDENTIFIERS = {
    "a": [0x010, 0x2AA, 0x7F0, 0x100 << 18 | EXTENDED],
    "b": [0x000, 0x2AB, 0x555 | REMOTE],
    "c": [0x100, 0x101 << 18 | 5 | EXTENDED, 0x3E0],
    "d": [0x7FF, 0x102, 0x001],
}
FD_IDENTIFIERS = {name: [*some, some[0] | FD, some[-1] | FD | BRS] for name, some in IDENTIFIERS.items()}
FD_IDENTIFIERS["b"][-1] = 0x2AC | FD | BRS

bits = st.integers(0, SPAN)
nodes = st.sampled_from(NAMES)
victims = st.lists(nodes, max_size=2, unique=True).map(tuple)


def frames(fd):
    known = FD_IDENTIFIERS if fd else IDENTIFIERS
    data = st.sampled_from([b"", b"\0", b"\x55\x33", bytes(8), b"\xff" * 4])
    return st.lists(
        nodes.flatmap(lambda name: st.tuples(st.just(name), st.sampled_from(known[name]), data, bits)), max_size=14
    )


def interval(kind, **kwargs):
    def make(node, first, length, **rest):
        return kind(node=node, from_s=first * 1e-6, to_s=(first + length) * 1e-6, **rest)

    return st.builds(make, nodes, bits, st.integers(1, 300), **kwargs)


ANY_IDENTIFIER = st.sampled_from([identifier for some in IDENTIFIERS.values() for identifier in some])
BIT_ERRORS = st.builds(
    BitError, identifier=ANY_IDENTIFIER, bit=st.integers(-12, 60), occurrence=st.integers(1, 3), at=victims
)
FAULTS = st.one_of(
    BIT_ERRORS,
    BIT_ERRORS,
    st.builds(BitErrorRate, rate=st.sampled_from([0.001, 0.01]), at=victims),
    interval(StuckDominant),
    interval(CutOff),
    interval(Overrun),
    interval(QueueDelay, delay_us=st.integers(1, 200)),
    interval(Babble, identifier=st.sampled_from([0x7F, 0x400])),
)
SENDER = st.fixed_dictionaries(
    {},
    optional={
        "fifo": st.booleans(),
        "one_shot": st.booleans(),
        "discards": st.booleans(),
        "depth": st.integers(1, 3),
        "tec": st.sampled_from([0, 1, 100, 127, 130, 250]),
        "rec": st.sampled_from([0, 5, 127, 128, 200]),
    },
)
SETTINGS = st.one_of(SENDER, SENDER, SENDER, st.just({"listen_only": True}))
PER_NODE = st.fixed_dictionaries({}, optional=dict.fromkeys(NAMES, SETTINGS))
MODEST = settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def start(wire, traffic, settings_of, script=(), seed=0, fd=False):
    """A bus with its traffic ahead; asked is how many frames each node asks for."""
    bus = wire(NAMES, script, seed, data_bit_ns=200 if fd else None)
    for name, each in settings_of.items():
        bus.set(name, **each)
    for name, identifier, data, at in traffic:
        bus.send(name, identifier, data, at)
    return bus


def log_of(bus):
    """All that can be seen of a run."""
    events = [(t, event.port.name, event[2:]) for t, event in bus.events]
    return bus.frames, events, {name: bus.nodes[name].arrivals for name in NAMES}, counts_of(bus)


def visible(bus):
    """The same without the instants of Status: computed whole, a receiver counts 8 bits late, with the whole frame."""
    frames, events, arrivals, counts = log_of(bus)
    timed = [event for event in events if event[2][0] != STATUS]
    silent = not any(bus[name].queued for name in NAMES)
    busy = bus.kernel.bits_on_wire if silent else None  # whole frames are counted when they begin
    return frames, timed, busy, [event[1:] for event in events if event[2][0] == STATUS], arrivals, counts


def counts_of(bus):
    return {name: (bus[name].counts(), bus[name].queued, bus.counters(name)) for name in NAMES}


def check_accounts(bus, traffic):
    """Every frame that was asked for is sent, lost for a reason, or waits."""
    asked = Counter(name for name, *_ in traffic)
    for name in NAMES:
        controller = bus[name]
        lost = sum(controller.lost.values()) - controller.lost["receive overrun"]
        left = controller.sent + lost + controller.queued
        assert left >= asked[name]
        assert left == asked[name] or any(isinstance(f, Babble) and f.node == name for f in bus.script), name
        assert controller.queued <= controller.depth
        assert controller.received == len(bus.got(name)) + controller.lost["receive overrun"]
    assert sum(bus[name].sent for name in NAMES) == len(bus.frames)


def calm(bus, name, script, until_state):
    """Whether nothing ever touched this node and its flags were active throughout."""
    named = [fault for fault in script if name in getattr(fault, "at", (getattr(fault, "node", None),))]
    everybody = [fault for fault in script if getattr(fault, "at", None) == ()]
    states = {code for _, who, code in bus.states if who == name}
    return not named and not everybody and until_state(name) and states <= {ERROR_ACTIVE}


@pytest.mark.parametrize("fd", [False, True], ids=["classic", "FD"])
@settings(MODEST, max_examples=60)
@given(data=st.data())
def test_every_frame_is_accounted_for_and_reaches_whoever_is_undisturbed(wire, fd, data):
    traffic = data.draw(frames(fd))
    script = data.draw(st.lists(FAULTS, max_size=4))
    each = data.draw(PER_NODE)
    seed = data.draw(st.integers(0, 3))
    bus = start(wire, traffic, each, script, seed, fd)
    bus.script = script
    for at in range(0, SPAN, 250):
        bus.run(at)
    bus.run(END)
    check_accounts(bus, traffic)
    stuck = any(isinstance(fault, StuckDominant) for fault in script)
    good = {
        name
        for name in NAMES
        if calm(bus, name, script, lambda who: not set(each.get(who, {})) & {"listen_only", "tec", "rec"})
    }
    for sender in good if not stuck else ():
        for receiver in good - {sender}:
            sent = Counter(frame[2:] for frame in bus.frames if frame[1] == sender)
            got = Counter(arrival[1:] for arrival in bus.nodes[receiver].arrivals)
            assert sent <= got, (sender, receiver)
    again = start(wire, traffic, each, script, seed, fd).run(END)
    assert log_of(again) == log_of(bus)


class NothingVisible:
    """Makes every frame be played bit by bit, and disturbs none."""

    def flips(self, _sender, _identifier, _data):
        return {10**6: None}


@pytest.mark.parametrize("fd", [False, True], ids=["classic", "FD"])
@settings(MODEST, max_examples=60)
@given(data=st.data())
def test_frames_computed_whole_are_the_same_as_bit_by_bit(wire, fd, data):
    traffic, each = data.draw(frames(fd)), data.draw(PER_NODE)
    if fd:  # All before the first frame ends: bit by bit, a frame begins with a bit, and here they last fractions.
        traffic = [(name, identifier, content, at % 40) for name, identifier, content, at in traffic]
    whole, played = (start(wire, traffic, each, fd=fd) for _ in range(2))
    played.kernel.medium.faults = NothingVisible()
    played.kernel.medium.assess()
    for one, other in zip(visible(whole.run(END // 4)), visible(played.run(END // 4)), strict=True):
        assert one == other


@settings(MODEST, max_examples=40)
@given(traffic=frames(False), each=PER_NODE, at=st.lists(bits, max_size=6))
def test_going_on_bit_by_bit_from_anywhere_changes_nothing(wire, traffic, each, at):
    """In the middle of a frame, of an intermission, of a suspension."""
    whole, disturbed = (start(wire, traffic, each) for _ in range(2))
    for bit in at:
        disturbed.call(bit, disturbed.kernel.medium.disturb)
    for one, other in zip(visible(whole.run(END // 4)), visible(disturbed.run(END // 4)), strict=True):
        assert one == other


@pytest.mark.parametrize("at", [0.5, 20.3, 61.9, 62.5, 64.7, 65.1])
def test_going_on_bit_by_bit_from_between_two_bits_changes_nothing(wire, at):
    bus = wire("ab").send("a", 0x2AA, b"\x55\x33").send("a", 0x555)
    bus.call(at, bus.kernel.medium.disturb).run(200)
    assert bus.ends() == bus.got("b") == [62, 65 + 45]
