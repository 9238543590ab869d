"""A machine with a clock of its own, in virtual time: processes that take a while, a bus that takes a while.

What a run by the clock `wall` does on a real machine, but repeatable to the nanosecond: a process may be frozen, a node
cut off its bus, a frame lost, a stamp wrong.
"""

from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from heapq import heappop, heappush

from dbc.compiler import load_arm
from hil.assemble import build_nodes
from hil.scenario import Scenario
from hil.two_senders import TwoSenders
from hil.wall_drive import WallDrive, make_wall_drive
from hil.wall_witness import WallWitness

CODEC = load_arm()
EPOCH_NS = 7_000_000_000
"""The clock's time at the start: nothing may take it for zero."""
WORK_NS = {"plant": 50_000, "dsp": 40_000, "joint1": 30_000, "joint2": 35_000, "joint3": 45_000}
BUS_NS = 60_000

Interval = tuple[int, int]
Says = tuple[int, bytes, int]
"""(identifier, data, when it came)"""


class Process:
    """A drive, what it has not read yet, and when it is free again."""

    def __init__(self, drive: WallDrive) -> None:
        self.drive = drive
        self.inbox: deque[Says] = deque()
        self.free_ns = 0
        self.wakes_ns: int | None = None


class Clockwork:
    """Runs a scenario. frozen, deaf: (from, until) in ns since Sync 0, by node; deaf: nothing in or out.

    lose: whether nobody gets this frame. shift: what a stamp is wrong by. reset: when a node begins anew, by node.
    external, errors: what the rig knows of somebody else's nodes, and of errors on its bus. Raises ChannelError where
    the rig would take one of its own nodes for somebody else.
    """

    def __init__(
        self,
        scenario: Scenario,
        frozen: Mapping[str, Sequence[Interval]] | None = None,
        deaf: Mapping[str, Sequence[Interval]] | None = None,
        lose: Callable[[int, bytes], bool] = lambda _identifier, _data: False,
        shift: Callable[[int, int], int] = lambda _identifier, _at_ns: 0,
        reset: Mapping[str, int] | None = None,
        external: Collection[str] = (),
        errors: Callable[[], int] = lambda: 0,
    ) -> None:
        self.scenario = scenario
        self.processes = {n.name: Process(make_wall_drive(n, scenario, CODEC)) for n in build_nodes(scenario)}
        self.reset = reset or {}
        self.witness = WallWitness(scenario, CODEC, external, errors)
        self.senders = TwoSenders(CODEC, in_order=False)
        self.stretch = 1.0 / scenario.clock.pace
        self.frozen, self.deaf, self.lose, self.shift = frozen or {}, deaf or {}, lose, shift
        self.began_ns: int | None = None
        self.sent_ns: list[tuple[int, int, bytes, str]] = []
        self._agenda: list[tuple[int, int, Callable[[int], None]]] = []
        self._sequence = 0

    def drive(self, name: str) -> WallDrive:
        return self.processes[name].drive

    def run(self, limit_s: float = 3600.0) -> None:
        """Run until everybody's part is over, or the time is."""
        for name, process in self.processes.items():
            self._send(name, process.drive.start(), EPOCH_NS)
        while self._agenda and self._agenda[0][0] < EPOCH_NS + limit_s * 1e9:
            at_ns, _, act = heappop(self._agenda)
            act(at_ns)

    def _at(self, at_ns: int, act: Callable[[int], None]) -> None:
        self._sequence += 1
        heappush(self._agenda, (at_ns, self._sequence, act))

    def _within(self, intervals: Sequence[Interval], at_ns: int) -> int | None:
        """Return the end of the interval that this instant lies in."""
        since_ns = None if self.began_ns is None else at_ns - self.began_ns
        ends = [until for begin, until in intervals if since_ns is not None and begin <= since_ns < until]
        return None if not ends or self.began_ns is None else ends[0] + self.began_ns

    def _send(self, name: str, frames: list[tuple[int, bytes]], at_ns: int) -> None:
        """Put frames on the bus, one behind the other."""
        for identifier, data in frames:
            if self._within(self.deaf.get(name, ()), at_ns) is not None or self.lose(identifier, data):
                continue
            at_ns += BUS_NS
            self.sent_ns.append((at_ns, identifier, data, name))
            self._at(at_ns, lambda now, i=identifier, d=data, n=name: self._deliver(n, i, d, now))

    def _deliver(self, sender: str, identifier: int, data: bytes, now_ns: int) -> None:
        if identifier == 0x080 and self.witness.cycle == -1 and self.began_ns is None:
            self.began_ns = now_ns
            for name, at_ns in self.reset.items():
                self._at(now_ns + at_ns, lambda _, name=name: self._begin_anew(name))
        if not self.witness.stopped:
            self.senders.hear(identifier, data, self.witness.cycle)
            self.witness.hear(identifier, data, now_ns)
        for name, process in self.processes.items():
            if name == sender or identifier not in process.drive.listens:
                continue
            if self._within(self.deaf.get(name, ()), now_ns) is None:
                process.inbox.append((identifier, data, now_ns + self.shift(identifier, now_ns)))
                self._wake(name, now_ns)

    def _begin_anew(self, name: str) -> None:
        (node,) = [each for each in build_nodes(self.scenario) if each.name == name]
        self.processes[name] = Process(make_wall_drive(node, self.scenario, CODEC))

    def _wake(self, name: str, at_ns: int) -> None:
        """Have a process look around then, at the latest."""
        process = self.processes[name]
        at_ns = max(at_ns, process.free_ns)
        if process.wakes_ns is None or at_ns < process.wakes_ns:
            process.wakes_ns = at_ns
            self._at(at_ns, lambda now: self._look(name, now))

    def _look(self, name: str, now_ns: int) -> None:
        process = self.processes[name]
        if process.drive.finished or process.wakes_ns != now_ns:
            return
        process.wakes_ns = None
        awake_ns = self._within(self.frozen.get(name, ()), now_ns)
        if awake_ns is not None:
            self._wake(name, awake_ns)
            return
        self._work(name, process, now_ns)
        if process.inbox:
            self._wake(name, now_ns)
        if process.drive.wake_ns is not None:
            self._wake(name, max(process.drive.wake_ns, now_ns + 1))

    def _work(self, name: str, process: Process, now_ns: int) -> None:
        """Do what the loop around a drive does in one turn."""
        drive = process.drive
        due = drive.wake_ns is not None and drive.wake_ns <= now_ns
        frames = drive.tick(now_ns) if due and (drive.owns_period or not process.inbox) else []
        if process.inbox and not drive.finished:
            identifier, data, came_ns = process.inbox.popleft()
            frames += drive.hear_at(identifier, data, came_ns, now_ns)
        process.free_ns = now_ns + WORK_NS[name]
        self._send(name, frames, process.free_ns)
