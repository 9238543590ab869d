"""What happens when, in virtual time: one heap, shared by every bus of a server.

Entries are ordered by (time, phase, node order, since when due, sequence). The phases of an instant, in this order:
faults of the script act; a frame ends and is delivered; nodes that are due wake; what they send is queued; a bus that
is idle starts the frame that wins arbitration. So all wake-ups due at t are handled before a bus starts a frame at t.
"""

from collections.abc import Callable
from heapq import heappop, heappush
from typing import Any

FAULT, DELIVER, WAKE, QUEUE, ARBITRATE = range(-1, 4)

Action = Callable[[Any], None]


class Agenda:
    """Virtual time: an integer number of nanoseconds that moves from entry to entry.

    acting: the participant called last, for whoever must say which one failed. joined: participants so far.
    """

    __slots__ = ("_entries", "_sequence", "acting", "joined", "now_ns", "stopped")

    def __init__(self, start_ns: int = 0) -> None:
        self.now_ns = start_ns
        self.stopped = False
        self.acting = ""
        self.joined = 0
        self._entries: list[tuple[int, int, int, int, int, Action, Any]] = []
        self._sequence = 0

    def at(self, t_ns: int, phase: int, order: int, action: Action, argument: Any, due_ns: int | None = None) -> None:
        """Put an action down. due_ns: since when it is due, for what had to wait for a node that computed."""
        self._sequence = sequence = self._sequence + 1
        heappush(self._entries, (t_ns, phase, order, t_ns if due_ns is None else due_ns, sequence, action, argument))

    def run(self, until_ns: int) -> None:
        """Carry out everything due up to and at until_ns, or until stopped."""
        entries = self._entries
        while entries and entries[0][0] <= until_ns and not self.stopped:
            entry = heappop(entries)
            self.now_ns = entry[0]
            entry[5](entry[6])
        if not self.stopped:
            self.now_ns = max(self.now_ns, until_ns)

    @property
    def next_ns(self) -> int | None:
        """When something is due next."""
        return self._entries[0][0] if self._entries else None
