"""When everything of an inline run happened: each frame queued, started and ended, each node's computing."""

from collections.abc import Iterator
from typing import NamedTuple

from hil.drive import Direct
from hil.node import Node, Reaction
from hil.rig import Outcome, Progress, no_progress, run_inline
from hil.scenario import Scenario
from hil.wire.duration import duration_ns
from hil.wire.kernel import Arrival, Kernel


class FrameTime(NamedTuple):
    """One frame on the bus; times in ns behind cycle 0. starts_ns: of the attempt that was acknowledged."""

    queued_ns: int
    starts_ns: int
    ends_ns: int
    identifier: int
    data: bytes
    sender: str


class Computing(NamedTuple):
    """One wake-up of a node: when, and how long it computed."""

    begins_ns: int
    lasts_ns: int


class Timeline:
    """Follows a run from its set-up on. frames: in the order of the bus; computing, unanswered: of each node.

    unanswered: when a frame woke it to which it queued nothing.
    """

    def __init__(self) -> None:
        self.frames: list[FrameTime] = []
        self.computing: dict[str, list[Computing]] = {}
        self.unanswered_ns: dict[str, list[int]] = {}

    def seat(self, kernel: Kernel, node: Node) -> None:
        """Let a node take part, and look on."""
        if not self.computing:
            self._follow(kernel)
        own = self.computing.setdefault(node.name, []), self.unanswered_ns.setdefault(node.name, [])
        kernel.join(_Watched(node, *own))

    def _follow(self, kernel: Kernel) -> None:
        def watch(end_ns: int, identifier: int, data: bytes, sender: str) -> None:
            starts_ns = end_ns - duration_ns(identifier, data, kernel.rates)
            self.frames.append(FrameTime(kernel.queued_ns, starts_ns, end_ns, identifier, data, sender))

        kernel.watchers.append(watch)

    def between(self, begins_ns: int, ends_ns: int) -> Iterator[FrameTime]:
        """Yield the frames that were queued from one instant on and before another."""
        return (frame for frame in self.frames if begins_ns <= frame.queued_ns < ends_ns)

    def silent(self, period_ns: int, cycles: int) -> dict[str, list[bool]]:
        """Return of each node in which cycles of a run it was woken by a frame, and queued none."""
        found = {}
        for name, woken_ns in self.unanswered_ns.items():
            unanswered = {at_ns // period_ns for at_ns in woken_ns}
            found[name] = [cycle in unanswered for cycle in range(cycles)]
        return found


class _Watched(Direct):
    """A node whose computing is written down."""

    def __init__(self, node: Node, computing: list[Computing], unanswered_ns: list[int]) -> None:
        super().__init__(node)
        self._computing, self._unanswered_ns = computing, unanswered_ns

    def wake(self, now_ns: int, stored: list[Arrival], cause: Arrival | None) -> Reaction:
        """Hand over, and note how long it computes."""
        reaction = super().wake(now_ns, stored, cause)
        self._computing.append(Computing(now_ns, reaction[0]))
        if cause is not None and not reaction[2]:
            self._unanswered_ns.append(now_ns)
        return reaction


def run_with_timeline(scenario: Scenario, progress: Progress = no_progress) -> tuple[Outcome, Timeline]:
    """Run a scenario inline; under `bits`, since frames take no time under `functional`."""
    timeline = Timeline()
    return run_inline(scenario, progress, seat=timeline.seat), timeline
