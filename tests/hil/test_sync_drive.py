"""Nodes driven by the Sync frame on a bus that only keeps the order: the payloads are those of `functional`."""

import random
from collections import defaultdict, deque

import pytest

from dbc.compiler import load_arm
from hil import scenario_file
from hil.assemble import build_nodes
from hil.rig import run_inline
from hil.scenario import Scenario
from hil.sync_drive import SyncDrive, make_drive
from hil.witness import Witness

CODEC = load_arm()
Payloads = dict[int, list[tuple[int, bytes]]]
SHORT = {"duration_s": 0.3, "trajectory.time_s": 0.25}


class Ether:
    """A bus in its barest form: frames in the order in which they were sent, heard by all others.

    shuffle: whose frames come next is drawn; each sender's stay in their order, as on any bus with several sockets.
    """

    def __init__(self, scenario: Scenario, shuffle: int | None = None) -> None:
        self.drives = {node.name: make_drive(node, scenario, CODEC) for node in build_nodes(scenario)}
        self.waiting: dict[str, deque[tuple[int, bytes]]] = {name: deque() for name in self.drives}
        self.witness = Witness(scenario, CODEC)
        self.random = None if shuffle is None else random.Random(shuffle)
        self.order: deque[str] = deque()

    def say(self, name: str, frames: list[tuple[int, bytes]]) -> None:
        self.waiting[name] += frames
        self.order += [name] * len(frames)

    def start(self) -> None:
        for name, drive in self.drives.items():
            self.say(name, drive.start())

    def carry(self, deaf: str = "") -> None:
        """Carry one frame; `deaf` is not there to hear it."""
        if self.random is not None:
            self.random.shuffle(self.order)
        name = self.order.popleft()
        identifier, data = self.waiting[name].popleft()
        if not self.witness.stopped:
            self.witness.hear(identifier, data)
        for other, drive in self.drives.items():
            if other not in (name, deaf) and identifier in drive.listens and not drive.finished:
                self.say(other, drive.hear(identifier, data))

    def run(self) -> Payloads:
        self.start()
        while self.order:
            self.carry()
        return payloads(self.witness.log.frames)


class Scatter(Ether):
    """A bus whose sockets hear the frames of different senders in different orders; of one sender, in its order."""

    def run(self) -> Payloads:
        assert self.random is not None
        ways: dict[tuple[str, str], deque[tuple[int, bytes]]] = {}
        self.start()
        while self.order or any(ways.values()):
            while self.order:
                name = self.order.popleft()
                identifier, data = self.waiting[name].popleft()
                if not self.witness.stopped:
                    self.witness.hear(identifier, data)
                for other, drive in self.drives.items():
                    if other != name and identifier in drive.listens:
                        ways.setdefault((name, other), deque()).append((identifier, data))
            sender, other = self.random.choice([way for way, frames in ways.items() if frames])
            identifier, data = ways[sender, other].popleft()
            if not self.drives[other].finished:
                self.say(other, self.drives[other].hear(identifier, data))
        return payloads(self.witness.log.frames)


def payloads(frames) -> Payloads:
    found = defaultdict(list)
    for t_ns, identifier, data, _ in frames:
        found[identifier].append((t_ns, data))
    return found


def data_of(found: Payloads) -> dict[int, list[bytes]]:
    return {identifier: [data for _, data in frames] for identifier, frames in found.items()}


def load(name: str, **settings: object) -> Scenario:
    return scenario_file.load(name, ["bus.fidelity=functional", *(f"{key}={value}" for key, value in settings.items())])


@pytest.mark.parametrize("name", ["paper-joint", "paper-task", "load-step", "one-joint", "five-joints"])
def test_payloads_are_those_of_functional(name: str) -> None:
    scenario = load(name)
    assert Ether(scenario).run() == payloads(run_inline(scenario).log.frames)


@pytest.mark.parametrize("seed", range(5))
def test_order_in_which_sockets_get_their_turn_does_not_matter(seed: int) -> None:
    """Only when a State or Heartbeat gets out may differ: behind the next Sync, if its sender's turn comes late."""
    scenario = load("paper-joint", **SHORT)
    found, expected = Ether(scenario, shuffle=seed).run(), payloads(run_inline(scenario).log.frames)
    assert data_of(found) == data_of(expected)
    timed = [identifier for identifier in expected if identifier < 0x400]
    assert all(found[identifier] == expected[identifier] for identifier in timed)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("name", ["paper-joint", "five-joints"])
def test_sockets_may_hear_the_bus_in_different_orders(name: str, seed: int) -> None:
    """vcan0 hands a frame to one socket after the other; on two CPUs an answer may overtake what it answers."""
    scenario = load(name, duration_s=0.2)
    found, expected = Scatter(scenario, shuffle=seed).run(), payloads(run_inline(scenario).log.frames)
    assert data_of(found) == data_of(expected)


def test_without_one_joint_time_stands_still_and_its_name_is_known() -> None:
    ether = Ether(load("paper-joint", **SHORT))
    ether.start()
    while ether.order:
        ether.carry(deaf="joint2")
    assert ether.witness.cycle == -200
    assert ether.witness.missing() == "joint2"
    assert ether.witness.log.frames == []


def test_joint_that_comes_late_is_told_again_and_nothing_else_changes() -> None:
    scenario = load("paper-joint", **SHORT)
    ether = Ether(scenario)
    ether.start()
    while ether.order:
        ether.carry(deaf="joint2")
    for _ in range(3):  # the DSP says Sync again while nothing moves, and the plant where the arm is
        ether.say("dsp", ether.drives["dsp"].idle())
        while ether.order:
            ether.carry()
    assert payloads(ether.witness.log.frames) == payloads(run_inline(scenario).log.frames)


@pytest.mark.parametrize("seed", range(4))
def test_what_is_said_again_in_set_up_counts_once_wherever_it_gets_between(seed: int) -> None:
    """A slow machine: the DSP says Sync again though the first one was heard, at any moment, many times."""
    scenario = load("paper-joint", **SHORT)
    ether = Ether(scenario)
    ether.start()
    chance = random.Random(seed)
    while ether.order:
        if chance.random() < 0.05:
            ether.say("dsp", ether.drives["dsp"].idle())
        ether.carry()
    assert data_of(payloads(ether.witness.log.frames)) == data_of(payloads(run_inline(scenario).log.frames))


def test_in_the_run_nothing_is_said_twice() -> None:
    scenario = load("paper-joint", **SHORT)
    ether = Ether(scenario)
    ether.start()
    while ether.witness.cycle < 10:
        ether.carry()
    assert all(drive.idle() == [] for drive in ether.drives.values())


def test_fault_stops_the_run_as_under_functional() -> None:
    """A singular pose on the way: the DSP stops, with the same frames up to there.

    Under `functional` Stop goes first of its instant; here the Currents of the cycle may have gone before.
    """
    scenario = load("paper-task", **{"dsp.k2_1_s2": 0, "dsp.k1_1_s": 0, "joint.observer": "false", "duration_s": 1.0})
    expected = run_inline(scenario)
    found = Ether(scenario)
    frames, before = found.run(), payloads(expected.log.frames)
    assert found.witness.stopped
    for identifier, wanted in before.items():
        assert frames[identifier][: len(wanted)] == wanted
        assert len(frames[identifier]) <= len(wanted) + 1
    assert frames[0x010] == before[0x010] != [(1_000_000_000, b"\0")]


def test_lost_current_holds_time_until_it_is_there() -> None:
    """The DSP does not go on without every Current of its cycle, whatever else it hears."""
    ether = Ether(load("paper-joint", **SHORT))
    ether.start()
    while ether.witness.cycle < 5:
        ether.carry()
    dsp = ether.drives["dsp"]
    before = dsp.cycle
    old = CODEC["Current_1"].pack(0, 0, (before - 1) & 0xFF)
    assert dsp.hear(CODEC["Current_1"].identifier, old) == []
    assert dsp.cycle == before


def test_sync_drive_of_a_user_s_node_needs_no_more_than_a_node_s_calls() -> None:
    class Listener:
        name, wakes_on, stores, finished = "ear", (0x101,), (0x130,), False

        def __init__(self) -> None:
            self.heard: list[tuple[str, int]] = []

        def on_start(self, _now_ns):
            return 0, 5_000_000, []

        def on_frame(self, _identifier, data, now_ns):
            self.heard.append(("frame", now_ns))
            return 0, 5_000_000, [(77, 0x7FF, data)]

        def on_timer(self, now_ns):
            self.heard.append(("timer", now_ns))
            return 0, None, []

        def store(self, _identifier, _data, at_ns):
            self.heard.append(("store", at_ns))

        def report(self):
            return {}

    node = Listener()
    drive = SyncDrive(node, load("paper-joint"), CODEC)
    assert drive.start() == []
    for cycle in range(-200, 8):
        drive.hear(0x080, bytes([cycle & 0xFF]))
    assert node.heard == [("timer", 5_000_000)]
    drive.hear(0x130, bytes(8))
    assert drive.hear(0x101, b"x") == [(0x7FF, b"x")]
    assert node.heard[1:] == [("store", 7_000_000), ("frame", 7_000_000)]


class Heard(list[tuple[int, bytes]]):
    """Keeps what a witness would hear."""

    stopped = False

    def hear(self, identifier: int, data: bytes) -> None:
        self.append((identifier, data))


def heard_of(scenario: Scenario) -> list[tuple[int, bytes]]:
    """Return the frames of a run in their order."""
    ether, heard = Ether(scenario), Heard()
    ether.witness = heard  # type: ignore[assignment]
    ether.start()
    while ether.order:
        ether.carry()
    return heard[: heard.index((CODEC["Stop"].identifier, b"\0")) + 1]


def swapped(frames: list[tuple[int, bytes]], name: str) -> list[tuple[int, bytes]]:
    """Return these frames with every third of this name behind the next Sync, as another socket may hear them."""
    count = 0
    late: list[tuple[int, bytes]] = []
    found: list[tuple[int, bytes]] = []
    for frame in frames:
        count += frame[0] == CODEC[name].identifier
        if frame[0] == CODEC[name].identifier and count % 3 == 0:
            late.append(frame)
            continue
        ends = frame[0] == CODEC["Stop"].identifier  # nobody listens behind it
        found += [*late, frame] if ends else [frame, *late] if frame[0] == CODEC["Sync"].identifier else [frame]
        if ends or frame[0] == CODEC["Sync"].identifier:
            late.clear()
    return found


@pytest.mark.parametrize("name", ["Current_1", "Current_3", "AccelRef", "Encoder_2"])
def test_frame_that_is_heard_behind_the_next_sync_is_not_lost(name: str) -> None:
    scenario = load("paper-joint", **SHORT)
    frames, plain, witness = heard_of(scenario), Witness(scenario, CODEC), Witness(scenario, CODEC)
    for each in frames:
        plain.hear(*each)
    for each in swapped(frames, name):
        witness.hear(*each)
    assert swapped(frames, name) != frames
    assert (plain.lost, witness.lost) == (0, 0)
    assert sorted(witness.log.frames) == sorted(plain.log.frames)


@pytest.mark.parametrize("name", ["Current_1", "AccelRef", "Encoder_2"])
def test_frame_that_is_not_heard_at_all_is_lost(name: str) -> None:
    scenario = load("paper-joint", **SHORT)
    frames, witness = heard_of(scenario), Witness(scenario, CODEC)
    lost = [k for k, each in enumerate(frames) if each[0] == CODEC[name].identifier][-100:-50:10]
    for k, each in enumerate(frames):
        if k not in lost:
            witness.hear(*each)
    assert witness.lost == len(lost) == 5
