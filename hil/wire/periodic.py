"""Frames that the bus itself sends for a client, every so often in virtual time, as Linux's broadcast manager does."""

from collections.abc import Sequence

from hil.wire.agenda import QUEUE
from hil.wire.port import Port

Frame = tuple[int, bytes]
"""(identifier, data)"""


class PeriodicTask:
    """One client's frames by turns, each period_ns, the first now; until ends_ns (None: until stopped)."""

    def __init__(self, port: Port, frames: Sequence[Frame], period_ns: int, duration_ns: int | None) -> None:
        self.frames = list(frames)
        self.stopped = False
        self._port = port
        self._period_ns = period_ns
        self._turn = 0
        now_ns = port.agenda.now_ns
        self._ends_ns = None if duration_ns is None else now_ns + duration_ns
        self._number = port.agenda.at(now_ns, QUEUE, port.order, self._send, now_ns)

    def stop(self) -> None:
        """Send no more."""
        if not self.stopped:
            self.stopped = True
            self._port.agenda.call_off(self._number)

    def _send(self, due_ns: int) -> None:
        if self._ends_ns is not None and due_ns >= self._ends_ns:
            self.stopped = True
            return
        self._port.medium.queue(self._port, *self.frames[self._turn % len(self.frames)])
        self._turn += 1
        due_ns += self._period_ns
        self._number = self._port.agenda.at(due_ns, QUEUE, self._port.order, self._send, due_ns)
