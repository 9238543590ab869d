"""Driving a node by the machine's clock: the DSP alone owns the period, all others follow its Sync.

Set-up is that of hil/sync_drive.py: it lasts until all are ready, as fast as they answer. From Sync 0 on the DSP sends
Sync k at t0 + kT, an absolute deadline. A deadline that it missed by a period or more is skipped and counted, never
made up for in a burst. The arm's time is counted in Syncs, one period each, so the host's jitter does not move the arm;
from Sync on it is the frames' own stamps: a current acts when its frame came (or at its action delay, if that is later
and the fidelity `functional`).

Sans-I/O: times of the machine are handed in, in ns of CLOCK_MONOTONIC. `clock.pace`: emulated seconds a second.
"""

from array import array
from heapq import heappop, heappush
from typing import Any

from dbc.codec import Codec
from hil.node import SILENT, Node, Reaction
from hil.scenario import Scenario
from hil.sync_drive import DSPDrive, Frame, JointDrive, PlantDrive, SyncDrive
from plant.node import MISSES_TO_FAULT, RUN, Plant

SILENCE = 3.25
"""Periods after a Sync until the plant takes the link for lost: the third one that is missing is a quarter late."""


LATE_END = MISSES_TO_FAULT + 1
"""Cycles behind the last Sync at which a Stop may still be that of the end: three may have been skipped or lost."""


class WallDrive(SyncDrive):
    """What the drives share: emulated time laid on the machine's, and frames that are to be sent later."""

    owns_period = False
    """Whether its deadline goes before what it could hear; to the others silence is what nobody has said."""

    def __init__(self, node: Node, scenario: Scenario, codec: Codec) -> None:
        super().__init__(node, scenario, codec)
        self.stretch = 1.0 / scenario.clock.pace
        self.came_ns = self.wall_ns = 0
        self._laid = (0, 0)
        self._outbox: list[tuple[int, Frame]] = []

    @property
    def in_run(self) -> bool:
        """Whether time is the machine's: from Sync 0 on."""
        return self.cycle >= 0

    @property
    def wake_ns(self) -> int | None:
        """When there is something to do though no frame comes; None: never."""
        due = [at_ns for at_ns in (self._deadline_ns(), *(at_ns for at_ns, _ in self._outbox[:1])) if at_ns is not None]
        return min(due, default=None)

    def hear_at(self, identifier: int, data: bytes, came_ns: int, wall_ns: int) -> list[Frame]:
        """Take a frame that came then, at this later time; return those to send at once."""
        self.came_ns, self.wall_ns = came_ns, wall_ns
        return self.hear(identifier, data)

    def tick(self, wall_ns: int) -> list[Frame]:
        """Return what is due at this time."""
        self.wall_ns = wall_ns
        deadline_ns = self._deadline_ns()
        frames = [] if deadline_ns is None or deadline_ns > wall_ns else self._at_deadline(wall_ns - deadline_ns)
        while self._outbox and self._outbox[0][0] <= wall_ns:
            frames.append(heappop(self._outbox)[1])
        return frames

    def counters(self) -> dict[str, Any]:
        """Return what a run by the wall clock counts beside the node's own."""
        return {}

    def _lay(self, at_ns: int, wall_ns: int) -> None:
        """Say that it was this emulated time at that time of the machine."""
        self._laid = at_ns, wall_ns

    def _wall(self, at_ns: int) -> int:
        """Return when it is that emulated time."""
        return self._laid[1] + round((at_ns - self._laid[0]) * self.stretch)

    def _emulated(self, wall_ns: int) -> int:
        """Return which emulated time it is then."""
        return self._laid[0] + round((wall_ns - self._laid[1]) / self.stretch)

    def _deadline_ns(self) -> int | None:
        """Return when the node's own timer is due."""
        return None if not self.in_run or self.timer_ns is None else self._wall(self.timer_ns)

    def _at_deadline(self, _late_ns: int) -> list[Frame]:
        """Call the node's timer."""
        assert self.timer_ns is not None
        return self._frames(self.node.on_timer(self.timer_ns))

    def _frames(self, reaction: Reaction) -> list[Frame]:
        """Return what is to be sent now; what shall wait longer than for its computing goes out later (State)."""
        busy_ns, self.timer_ns, sends = reaction
        now = [(identifier, data) for delay_ns, identifier, data in sends if delay_ns <= busy_ns or not self.in_run]
        for delay_ns, identifier, data in sends:
            if delay_ns > busy_ns and self.in_run:
                heappush(self._outbox, (self._wall(self.now_ns + delay_ns), (identifier, data)))
        return now


class WallJoint(WallDrive, JointDrive):
    """A joint: it answers with the reference that is there. Its time is Sync's, or Encoder's where that is lost."""

    def __init__(self, node: Node, scenario: Scenario, codec: Codec) -> None:
        super().__init__(node, scenario, codec)
        self._encoder_came_ns = 0

    def hear(self, identifier: int, data: bytes) -> list[Frame]:
        """Take a frame."""
        if identifier == self.encoder:
            self._encoder_came_ns = self.came_ns
        elif identifier == self.sync.identifier and (ahead := self._ahead(data)):
            self._lay(self.now_ns + ahead * self.period_ns, self.came_ns)
        return super().hear(identifier, data)

    def _waits(self, cycle: int) -> bool:
        """Enter run with a reference; later a missing one is a strike."""
        return cycle == 0

    def _answer(self, identifier: int, data: bytes) -> list[Frame]:
        if identifier == self.encoder:
            if self._laid[0] < self.now_ns:
                self._lay(self.now_ns, self._encoder_came_ns)
            self._forget()
        return super()._answer(identifier, data)

    def _forget(self) -> None:
        """Drop references that came too late: 256 cycles on they would look like new ones."""
        for byte in list(self._references):
            if byte is None or (byte - self.cycle) & 0xFF >= 0x80:
                del self._references[byte]


class WallPlant(WallDrive, PlantDrive):
    """The plant: a Sync carries the arm to its cycle, whatever has come; without Sync the brakes engage."""

    node: Plant

    def __init__(self, node: Node, scenario: Scenario, codec: Codec) -> None:
        super().__init__(node, scenario, codec)
        self.old_stamps = 0
        self._cycles = scenario.cycles
        self._sync_came_ns = 0

    def hear(self, identifier: int, data: bytes) -> list[Frame]:
        """Take a frame."""
        if identifier == self.stop.identifier or (identifier == self.sync.identifier and self._ahead(data)):
            self._sync_came_ns = self.came_ns
        return super().hear(identifier, data)

    def counters(self) -> dict[str, Any]:
        """Count frames whose stamps are older than the plant's present."""
        return {"old_stamps": self.old_stamps}

    @property
    def _complete(self) -> bool:
        return self.in_run or super()._complete

    def _advance(self, identifier: int, data: bytes) -> list[Frame]:
        """Carry the arm to the cycle of a Sync, through those that the DSP skipped."""
        ahead = 1
        if self.in_run:
            ahead = self._ahead(data) if identifier == self.sync.identifier else self._to_the_end()
        reaction = SILENT
        for _ in range(ahead):
            self.cycle += 1
            reaction = self.node.on_timer(self.now_ns)
            if self.node.finished:
                break
        self._lay(self.now_ns, self._sync_came_ns)
        return self._frames(reaction)

    def _to_the_end(self) -> int:
        """Return by how many cycles a Stop goes on that stands for the Sync behind the last: some may be missing."""
        left = self._cycles - self.cycle
        return left if left <= LATE_END else 1

    def _end(self, data: bytes) -> list[Frame]:
        """Engage the brakes now, which is when this process comes to do it."""
        self.node.store(self.stop.identifier, data, max(self.now_ns, self._emulated(self.wall_ns)))
        self.stopped = True
        return []

    def _instant(self) -> int:
        """Return when a frame came: within its cycle, which only a Sync can end, and never in the past."""
        if not self.in_run:
            return self.now_ns
        at_ns = self._emulated(self.came_ns)
        self.old_stamps += at_ns < self.now_ns
        return min(max(at_ns, self.now_ns), self.now_ns + self.period_ns - 1)

    def _deadline_ns(self) -> int | None:
        return self._wall(self._lost_ns) if self.node.state == RUN and not self.finished else None

    @property
    def _lost_ns(self) -> int:
        return self.cycle * self.period_ns + round(SILENCE * self.period_ns)

    def _at_deadline(self, late_ns: int) -> list[Frame]:
        lost_ns = self._lost_ns + round(late_ns / self.stretch)
        for _ in range(int(SILENCE)):
            self.cycle += 1
            self.node.on_timer(self.now_ns)
        return self._frames(self.node.lose(lost_ns, "Sync"))


class WallDSP(WallDrive, DSPDrive):
    """The DSP: from Sync 0 on a period is over when its time is. late_ns: of each Sync, behind its deadline."""

    owns_period = True

    def __init__(self, node: Node, scenario: Scenario, codec: Codec) -> None:
        super().__init__(node, scenario, codec)
        self.late_ns = array("q")
        self.overruns = self.skipped_cycles = 0

    def counters(self) -> dict[str, Any]:
        """Count periods that were skipped, and how late each Sync was."""
        return {"overruns": self.overruns, "skipped_cycles": self.skipped_cycles, "late_ns": self.late_ns.tolist()}

    def _over(self) -> bool:
        return not self.in_run and super()._over()

    def _awaited(self) -> list[int]:
        """Once in run a lost Encoder is not waited for: the plant's frames come in its order, so the last one tells."""
        return self.encoders[-1:] if self.in_run else self.encoders

    def _next_cycle(self) -> list[Frame]:
        if self.cycle == -1:
            self._lay(0, self.wall_ns)
        return super()._next_cycle()

    def _deadline_ns(self) -> int | None:
        return self._wall(self.now_ns + self.period_ns) if self.in_run and not self.finished else None

    def _at_deadline(self, late_ns: int) -> list[Frame]:
        """Begin the cycle whose time it is; one that is over already never was."""
        self.late_ns.append(late_ns)
        skipped = int(late_ns / (self.period_ns * self.stretch))
        self.overruns += skipped > 0
        self.skipped_cycles += skipped
        self.cycle += skipped
        return self._next_cycle()


WALL_DRIVES: dict[str, type[WallDrive]] = {"plant": WallPlant, "dsp": WallDSP}


def make_wall_drive(node: Node, scenario: Scenario, codec: Codec) -> WallDrive:
    """Return the drive of a node by its part."""
    return WALL_DRIVES.get(node.name, WallJoint)(node, scenario, codec)
