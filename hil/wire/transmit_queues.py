"""What the controllers of one bus have to send: who takes part in arbitration, and with which frame."""

from collections.abc import Collection, Iterable
from heapq import heapify, heappop, heappush

from hil.wire.controller import Entry
from hil.wire.identifier import REMOTE, arbitration_key
from hil.wire.port import Port


class TransmitQueues:
    """The frames that take part in arbitration, as a heap: all of a queue by priority, the head of one in order.

    queued_ns: since when the frame waited that was sent last.
    """

    def __init__(self) -> None:
        self.pending: list[Entry] = []
        self.queued_ns = 0
        self._sequence = 0

    def enter(self, port: Port, identifier: int, data: bytes, now_ns: int) -> None:
        """Add a frame; in a first-in-first-out queue it waits for those before it."""
        if identifier & REMOTE:
            data = bytes(len(data))  # all that it carries is the length
        self._sequence += 1
        entry = (arbitration_key(identifier), port.order, now_ns, self._sequence, identifier, data)
        if port.controller.fifo:
            port.controller.waiting.append(entry)
            if len(port.controller.waiting) > 1:
                return
        heappush(self.pending, entry)

    def put(self, entries: Iterable[Entry]) -> None:
        """Let frames take part that did before."""
        for entry in entries:
            heappush(self.pending, entry)

    def pop(self) -> Entry:
        """Take out the frame that wins arbitration if everybody takes part."""
        return heappop(self.pending)

    def take(self, entry: Entry) -> None:
        """Take out a certain frame."""
        self.pending.remove(entry)
        heapify(self.pending)

    def take_all(self, port: Port) -> list[Entry]:
        """Take out whatever somebody has to send."""
        taken = [entry for entry in self.pending if entry[1] == port.order]
        self.pending = [entry for entry in self.pending if entry[1] != port.order]
        heapify(self.pending)
        return sorted(taken)

    def head(self, port: Port) -> Entry | None:
        """Return what somebody would send now."""
        return min((entry for entry in self.pending if entry[1] == port.order), default=None)

    def holds(self, port: Port, identifier: int) -> bool:
        """Return whether such a frame of somebody waits."""
        return any(entry[1] == port.order and entry[4] == identifier for entry in self.pending)

    def sent(self, port: Port, entry: Entry) -> None:
        """Count a frame that was sent, and acknowledged."""
        self.queued_ns = entry[2]
        port.controller.sent += 1
        port.controller.unheard = False

    def leave(self, port: Port, reason: str | None) -> None:
        """Count a frame out: sent, or lost for a reason; a first-in-first-out queue moves up."""
        controller = port.controller
        self.count_out(port, reason)
        if controller.fifo:
            controller.waiting.popleft()
            if controller.waiting:
                heappush(self.pending, controller.waiting[0])

    @staticmethod
    def count_out(port: Port, reason: str | None, frames: int = 1) -> None:
        """Count frames out that have not yet taken part in arbitration, or do no longer."""
        controller = port.controller
        controller.queued -= frames
        if reason is not None:
            controller.lost[reason] += frames

    def flush(self, port: Port, reason: str, sending: Entry | None) -> None:
        """Drop what somebody has to send; what is being sent now is not sent again."""
        controller = port.controller
        own = sending if sending is not None and sending[1] == port.order else None
        taken = self.take_all(port)
        if own in taken:  # played bit by bit, it waits until it is confirmed
            taken.remove(own)
            self.put([own])
        dropped = len(controller.waiting) - (own is not None) if controller.fifo else len(taken)
        controller.waiting.clear()
        if own is not None and controller.fifo:
            controller.waiting.append(own)
        controller.given_up = own
        self.count_out(port, reason, dropped)


def losers(able: Iterable[Entry], winner: Entry, discarding: Collection[int]) -> list[Entry]:
    """Return the frames that are given up because they lose: heads of those who do so."""
    heads: dict[int, Entry] = {}
    for entry in able:
        if entry[1] in discarding and entry[1] != winner[1]:
            heads[entry[1]] = min(entry, heads.get(entry[1], entry))
    return [heads[order] for order in sorted(heads) if heads[order][0] != winner[0]]
