"""What happens when, in virtual time: one heap, shared by every bus of a server.

Entries are ordered by (time, phase, node order, since when due, sequence). The phases of an instant, in this order:
faults of the script act; a frame ends and is delivered; nodes that are due wake; what they send is queued; a bus that
is idle starts the frame that wins arbitration. So all wake-ups due at t are handled before a bus starts a frame at t.
"""

from collections.abc import Callable
from heapq import heapify, heappop, heappush
from typing import Any

FAULT, DELIVER, WAKE, QUEUE, ARBITRATE = range(-1, 4)

Action = Callable[[Any], None]

FEW = 64
"""Entries called off that are not worth clearing away."""


class Agenda:
    """Virtual time: an integer number of nanoseconds that moves from entry to entry.

    acting: the participant called last, for whoever must say which one failed. joined: participants so far.
    """

    __slots__ = ("_called_off", "_entries", "_sequence", "acting", "joined", "now_ns", "stopped")

    def __init__(self, start_ns: int = 0) -> None:
        self.now_ns = start_ns
        self.stopped = False
        self.acting = ""
        self.joined = 0
        self._entries: list[tuple[int, int, int, int, int, Action, Any]] = []
        self._called_off: set[int] = set()
        self._sequence = 0

    def at(self, t_ns: int, phase: int, order: int, action: Action, argument: Any, due_ns: int | None = None) -> int:
        """Put an action down; return its number. due_ns: since when it is due, where it had to wait for a node."""
        self._sequence = sequence = self._sequence + 1
        heappush(self._entries, (t_ns, phase, order, t_ns if due_ns is None else due_ns, sequence, action, argument))
        return sequence

    def call_off(self, number: int) -> None:
        """Take an entry off that has not come yet; those of the far future must not pile up."""
        self._called_off.add(number)
        if len(self._called_off) > max(FEW, len(self._entries) // 2):
            self._entries[:] = [entry for entry in self._entries if entry[4] not in self._called_off]
            heapify(self._entries)
            self._called_off.clear()

    def forget(self, owner: object) -> None:
        """Drop the actions of an object that takes no more part."""
        self._entries[:] = [entry for entry in self._entries if getattr(entry[5], "__self__", None) is not owner]
        heapify(self._entries)

    def run(self, until_ns: int, most: int = -1) -> None:
        """Carry out what is due up to and at until_ns, at most so many entries (-1: all), or until stopped."""
        entries, called_off = self._entries, self._called_off
        while entries and entries[0][0] <= until_ns and not self.stopped:
            if most == 0:
                return
            most -= 1
            entry = heappop(entries)
            if called_off and entry[4] in called_off:
                called_off.remove(entry[4])
                continue
            self.now_ns = entry[0]
            entry[5](entry[6])
        if not self.stopped:
            self.now_ns = max(self.now_ns, until_ns)

    def has_due(self, until_ns: int) -> bool:
        """Return whether something is due up to and at until_ns."""
        return bool(self._entries) and self._entries[0][0] <= until_ns

    @property
    def next_ns(self) -> int | None:
        """When something is due next."""
        return self._entries[0][0] if self._entries else None
