"""A disturbed bus, bit by bit: every controller drives and reads each bit, until all are idle again.

Dominant (0) overwrites recessive (1). A bit lasts as long as the phase of the frame says; while some controllers have
left the data phase of an FD frame by an error and others have not yet seen it, those read several bits in one.
"""

from typing import TYPE_CHECKING, Protocol

from hil.wire.agenda import ARBITRATE, DELIVER
from hil.wire.bit_level import BitLevel
from hil.wire.controller import Entry
from hil.wire.duration import plan_of
from hil.wire.frame_plan import DOMINANT, RECESSIVE
from hil.wire.frame_reader import ARBITRATION_LOST, BUS_ERROR, CONFIRM

if TYPE_CHECKING:
    from hil.wire.medium import Medium
    from hil.wire.port import Port

Flips = dict[int, frozenset[str] | None]
"""Inverted bits of a frame, counted from SOF: who sees them so (None: everybody)."""


class Faults(Protocol):
    """What disturbs frames."""

    def flips(self, sender: str, identifier: int, data: bytes) -> Flips:
        """Return the bits of this frame that are inverted, and for whom."""


class BitPlay:
    """The controllers of a medium while something disturbs it.

    flips: of the frame that begins now (None: to be asked for). begun: a frame that is on the wire since since_ns.
    sender: of the frame behind which an intermission began at since_ns.
    """

    def __init__(
        self,
        medium: "Medium",
        flips: Flips | None,
        begun: Entry | None = None,
        since_ns: int = 0,
        sender: "Port | None" = None,
    ) -> None:
        self._medium = medium
        self._agenda = medium.agenda
        self._flips = flips
        self._index = 0
        self._sides = {port: self._side(port, sender) for port in medium.ports}
        self._sending: dict[Port, Entry] = {}
        self._bit_since_ns = since_ns
        if begun is not None:
            self._send(next(port for port in self._sides if port.order == begun[1]), begun)
        self._is_late = begun is not None or sender is not None

    def begin(self) -> None:
        """Begin with the bit that comes, or catch up with what has begun."""
        if self._is_late:
            self._catch_up()
        else:
            self._bit_begins(None)

    def _side(self, port: "Port", sender: "Port | None") -> BitLevel:
        controller = port.controller
        new = port in self._medium.newcomers
        return BitLevel(controller.confinement, controller.listen_only, new, sender is not None, port is sender)

    def _catch_up(self) -> None:
        """Play what has gone undisturbed so far."""
        while (lasts_ns := self._lasts_ns()) <= self._agenda.now_ns - self._bit_since_ns:
            self._bit_since_ns += lasts_ns
            level = self._driven()
            self._medium.busy_ns += lasts_ns if self._occupied(level) else 0
            self._sample(level)
        if self._bit_since_ns == self._agenda.now_ns:
            self._agenda.at(self._bit_since_ns, ARBITRATE, -1, self._bit_begins, None)
        else:
            self._agenda.at(self._bit_since_ns + lasts_ns, DELIVER, -1, self._bit_ends, None)
        self._report()

    def sending(self, port: "Port") -> Entry | None:
        """Return the frame that a participant has on the wire."""
        return self._sending.get(port)

    def drop(self, port: "Port") -> None:
        """Take a participant off the bus at once."""
        del self._sides[port]
        self._sending.pop(port, None)
        if not self._sending:
            self._flips = None

    def add(self, port: "Port") -> None:
        """Let a participant take part as soon as it has heard 11 recessive bits."""
        self._sides[port] = BitLevel(port.controller.confinement, port.controller.listen_only, integrating=True)

    # -- a bit --

    def _lasts_ns(self) -> int:
        """Return the length of the bit that comes: of the data phase, unless somebody flags an error in it."""
        rates = self._medium.rates
        if rates.data_bit_ns is None or not any(side.fast for side in self._sides.values()):
            return rates.bit_ns
        flagged = any(side.drives == DOMINANT and not side.fast for side in self._sides.values())
        return rates.bit_ns if flagged else rates.data_bit_ns

    def _bit_begins(self, _: None) -> None:
        if self._medium.play is not self:
            return
        self._begin_frames()
        self._bit_since_ns = self._agenda.now_ns
        self._agenda.at(self._bit_since_ns + self._lasts_ns(), DELIVER, -1, self._bit_ends, None)

    def _bit_ends(self, _: None) -> None:
        if self._medium.play is not self:
            return
        level = self._level()
        self._note(level)
        late = [side for side in self._sides.values() if side.fast] if self._was_nominal() else []
        self._sample(level)
        self._sample_late(late, level)
        self._report()
        if self._medium.stuck or any(side.busy for side in self._sides.values()):
            self._agenda.at(self._agenda.now_ns, ARBITRATE, -1, self._bit_begins, None)
        else:
            self._medium.resume()

    def _was_nominal(self) -> bool:
        return self._agenda.now_ns - self._bit_since_ns == self._medium.rates.bit_ns != self._medium.rates.data_bit_ns

    def _level(self) -> int:
        return DOMINANT if self._medium.stuck else self._driven()

    def _driven(self) -> int:
        return min((side.drives for side in self._sides.values()), default=RECESSIVE)

    def _sample(self, level: int) -> None:
        struck = self._flips is not None and self._index in self._flips
        victims = self._flips[self._index] if self._flips is not None and struck else None
        for port, side in self._sides.items():
            side.sample(level ^ (struck and (victims is None or port.name in victims)))
        self._index += 1

    def _sample_late(self, late: list[BitLevel], level: int) -> None:
        """Let those that are still in the data phase see the rest of a nominal bit."""
        rates = self._medium.rates
        for side in late:
            for _ in range(rates.bit_ns // (rates.data_bit_ns or rates.bit_ns) - 1):
                if side.fast:
                    side.sample(level)

    def _note(self, level: int) -> None:
        """Keep account of recessive bits and of a busy bus."""
        medium = self._medium
        if level == DOMINANT:
            medium.recovery.dominant(self._bit_since_ns)
        elif not medium.recovery.listening:
            medium.recovery.recessive(self._bit_since_ns)
        if self._occupied(level):
            medium.busy_ns += self._agenda.now_ns - self._bit_since_ns

    def _occupied(self, level: int) -> bool:
        return level == DOMINANT or any(side.occupied for side in self._sides.values())

    # -- frames --

    def _begin_frames(self) -> None:
        """Let everybody who may and wants to send begin; of equal identifiers the first node only."""
        begins: dict[int, tuple[Port, Entry]] = {}
        for port, side in self._sides.items():
            controller = port.controller
            suspended = controller.suspended_until_ns > self._agenda.now_ns
            if (side.idle or side.joining) and controller.sends and not suspended:
                entry = self._medium.queues.head(port)
                if entry is not None and entry[0] not in begins:
                    begins[entry[0]] = port, entry
        for port, entry in begins.values():
            self._send(port, entry)
        if begins:
            self._index = 1 if any(self._sides[port].joining for port, _ in begins.values()) else 0
            if self._flips is None:
                entry = begins[min(begins)][1]
                self._flips = self._medium.flips(entry)

    def _send(self, port: "Port", entry: Entry) -> None:
        self._sending[port] = entry
        self._sides[port].begin(plan_of(self._medium.identifier(entry), entry[5]))

    def _report(self) -> None:
        """Carry out what the controllers found in this bit."""
        for port, side in list(self._sides.items()):
            happened, side.happened = side.happened, []
            for what, number, data, field in happened:
                if what == CONFIRM:
                    self._medium.confirm(port, self._sending.pop(port), number)
                    self._flips = None
                elif what == ARBITRATION_LOST:
                    self._lose(port, number)
                elif what == BUS_ERROR:
                    self._fail(port, number, field)
                else:
                    self._medium.delivery.receive(port, self._agenda.now_ns, number, data)
        if any(port.controller.standing != port.controller.told for port in self._sides):
            self._medium.reporter.check_states()

    def _lose(self, port: "Port", bit: int) -> None:
        entry = self._sending.pop(port)
        if port.controller.discards:
            self._medium.lose(port, entry, bit)

    def _fail(self, port: "Port", code: int, field: str) -> None:
        entry = self._sending.pop(port, None)
        if not self._sending:
            self._flips = None
        if entry is None:
            self._medium.reporter.bus_error(port, code, field)
        else:
            self._medium.queues.take(entry)
            self._medium.failed(port, entry, code, field)
