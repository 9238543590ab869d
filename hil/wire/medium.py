"""One bus: whose frame goes next, when it ends, who gets it.

An undisturbed frame is computed whole: it starts, and ends its exact number of bits later. Where a fault touches the
bus, its controllers are played bit by bit (bit_play.py) until all are idle again.

Ref: ISO 11898-1:2015, 10.4.6 (intermission), 10.8 (arbitration), 12.1.4 (fault confinement).
"""

from collections.abc import Sequence

from hil.wire import controller as cause
from hil.wire.agenda import ARBITRATE, DELIVER, QUEUE, Agenda
from hil.wire.bit_level import INTERMISSION_BITS, SUSPEND_BITS
from hil.wire.bit_play import BitPlay, Faults, Flips
from hil.wire.controller import Entry
from hil.wire.delivery import Delivery
from hil.wire.duration import duration_ns, plan_of
from hil.wire.frame_plan import first_difference
from hil.wire.identifier import ESI, FD
from hil.wire.outcome import TAIL_BITS, acknowledged, not_acknowledged
from hil.wire.port import LONG_AGO_NS, Port
from hil.wire.rates import Rates
from hil.wire.recovery import Recovery
from hil.wire.reporter import Reporter
from hil.wire.transmit_queues import TransmitQueues, losers


class Medium:
    """One bus. `functional`: frames take no time, and nothing disturbs them."""

    def __init__(self, agenda: Agenda, rates: Rates, functional: bool = False) -> None:
        self.agenda = agenda
        self.rates = rates
        self.functional = functional
        self.ports: list[Port] = []
        self.delivery = Delivery(self)
        self.faults: Faults | None = None
        self.stuck: set[Port] = set()
        self.play: BitPlay | None = None
        self.newcomers: set[Port] = set()
        self.recovery = Recovery(self)
        self.busy_ns = 0
        self.queues = TransmitQueues()
        self.reporter = Reporter(self)
        self._bit_ns = 0 if functional else rates.bit_ns
        self._by_order: dict[int, Port] = {}
        self._idle = True
        self._plain = False
        self._free_from_ns = LONG_AGO_NS
        self._current: Entry | None = None
        self._sender: Port | None = None
        self._since_ns = 0
        self._planned_ns = 0

    # -- who takes part --

    def attach(self, port: Port, mended: bool = False) -> None:
        """Add a participant; on a busy bus, or with a mended cable, it takes part behind 11 recessive bits."""
        port.medium, port.agenda = self, self.agenda
        if not self.functional and (mended or self._current is not None or self.agenda.now_ns < self._free_from_ns):
            self.disturb()
            self.newcomers.add(port)
        self.ports.append(port)
        self.ports.sort(key=lambda each: each.order)
        self._by_order[port.order] = port
        if self.play is not None:
            self.play.add(port)
        self.assess()

    def detach(self, port: Port) -> list[Entry]:
        """Take a participant off the bus, in the middle of a frame if it must be; return what it had to send."""
        if self._current is not None and self._matters(port, self._current):
            self.disturb()
        entries = self.queues.take_all(port)
        self.ports.remove(port)
        del self._by_order[port.order]
        self.stuck.discard(port)
        self.newcomers.discard(port)
        if self.play is not None:
            self.play.drop(port)
        self.assess()
        return entries

    def _matters(self, port: Port, current: Entry) -> bool:
        """Return whether a frame on the wire needs this participant: its sender, or the only one to acknowledge it."""
        others = [each for each in self.ports if each is not port and each.order != current[1]]
        return port.order == current[1] or not any(each.controller.acknowledges for each in others)

    def assess(self) -> None:
        """Look at everybody anew: after a change of who takes part, of filters, of error states."""
        self.delivery.forget()
        ready = [port for port in self.ports if port.controller.acknowledges]
        self._plain = self.functional or (
            self.faults is None
            and not self.stuck
            and not self.newcomers
            and len(ready) > 1
            and all(port.controller.plain for port in self.ports)
        )
        self.recovery.off = [port for port in self.ports if port.controller.confinement.off]

    # -- transmit queues --

    def queue(self, port: Port, identifier: int, data: bytes) -> bool:
        """Transmit: put a frame into a controller's queue; return whether there was room."""
        controller = port.controller
        if controller.queued >= controller.depth or controller.listen_only:
            controller.lost[cause.LISTEN_ONLY if controller.listen_only else cause.QUEUE_FULL] += 1
            return False
        controller.queued += 1
        if controller.queue_delay_ns:
            due_ns = self.agenda.now_ns + controller.queue_delay_ns
            self.agenda.at(
                due_ns, QUEUE, port.order, lambda frame: port.medium._enter(*frame), (port, identifier, data)
            )
        else:
            self._enter(port, identifier, data)
        return True

    def _enter(self, port: Port, identifier: int, data: bytes) -> None:
        """Let a frame enter arbitration, at the earliest when all of this instant are queued."""
        if port.order not in self._by_order:
            return
        if port.controller.listen_only:
            self.queues.count_out(port, cause.LISTEN_ONLY)
            return
        self.queues.enter(port, identifier, data, self.agenda.now_ns)
        if self._idle:
            self._arbitrate_soon()

    def adopt(self, entries: Sequence[Entry]) -> None:
        """Take over what a participant had to send elsewhere."""
        self.queues.put(entries)
        self.rouse()

    def leave_queue(self, port: Port, reason: str | None = None) -> None:
        """Count a frame out of a queue: sent, or lost for a reason. A babbling node has the next one ready."""
        self.queues.leave(port, reason)
        babbles = port.controller.babbles
        if babbles is not None and not self.queues.holds(port, babbles[0]):
            self.queue(port, *babbles)

    def flush(self, port: Port, reason: str = cause.FLUSHED) -> None:
        """Drop what a controller has to send; what it has begun is not sent again."""
        self.queues.flush(port, reason, self._current if self.play is None else self.play.sending(port))

    def listen_only(self, port: Port, listen_only: bool) -> None:
        """Let a controller only listen, or take part again; what it had to send is lost."""
        if listen_only and not port.controller.listen_only:
            self.flush(port, cause.LISTEN_ONLY)
        port.controller.listen_only = listen_only
        self.assess()

    # -- arbitration --

    def rouse(self) -> None:
        """Arbitrate, if somebody waits and nobody sends: after a recovery, a return, a suspension."""
        if self.queues.pending and self._current is None and self.play is None:
            self._arbitrate_soon()

    def _arbitrate_soon(self) -> None:
        """Arbitrate as soon as the bus is free."""
        self._idle = False
        self.agenda.at(max(self.agenda.now_ns, self._free_from_ns), ARBITRATE, -1, self._arbitrate, None)

    def _arbitrate(self, _: None) -> None:
        """Start the frame that wins, unless somebody has started since this was put down."""
        if self._current is not None or self.play is not None or self.agenda.now_ns < self._free_from_ns:
            return
        if not self.queues.pending:
            self._idle = True
        elif self._plain:
            self._start(self.queues.pop())
        else:
            self._arbitrate_with_care()

    def _start(self, entry: Entry) -> None:
        self._current = entry
        end_ns = self._since_ns = self.agenda.now_ns
        if not self.functional:
            identifier = entry[4] if entry[4] < FD else self.identifier(entry)
            lasts_ns = duration_ns(identifier, entry[5], self.rates)
            self._planned_ns = lasts_ns + INTERMISSION_BITS * self._bit_ns
            self.busy_ns += self._planned_ns
            end_ns += lasts_ns
        self.agenda.at(end_ns, DELIVER, entry[1], self._deliver, entry)

    def identifier(self, entry: Entry) -> int:
        """Return a frame's identifier with its flags; an FD frame tells that its sender is error-passive."""
        passive = entry[4] & FD and self._by_order[entry[1]].controller.confinement.passive
        return entry[4] | ESI if passive else entry[4]

    def _arbitrate_with_care(self) -> None:
        """Arbitrate where somebody is passive, off, listening only, discards what loses, or a fault is due."""
        now_ns = self.agenda.now_ns
        able = [entry for entry in self.queues.pending if self._able(entry, now_ns)]
        if not able:
            waits = [self._by_order[entry[1]].controller.suspended_until_ns for entry in self.queues.pending]
            until_ns = min((wait for wait in waits if wait > now_ns), default=None)
            self._idle = True
            if until_ns is not None:
                self.agenda.at(until_ns, ARBITRATE, -1, self._arbitrate, None)
            return
        winner = min(able)
        self.recovery.dominant(now_ns)
        flips = self.flips(winner)
        if flips or self.stuck:
            self._play(BitPlay(self, flips))
            return
        for loser in losers(able, winner, {port.order for port in self.ports if port.controller.discards}):
            bit = first_difference(*(plan_of(self.identifier(entry), entry[5]) for entry in (loser, winner)))
            self.agenda.at(now_ns + (bit + 1) * self._bit_ns, DELIVER, loser[1], self._give_up, (loser, winner, bit))
        self.queues.take(winner)
        if any(port.controller.acknowledges for port in self.ports if port.order != winner[1]):
            self._start(winner)
        else:
            self._start_unacknowledged(winner)

    def _able(self, entry: Entry, now_ns: int) -> bool:
        port = self._by_order[entry[1]]
        off = port.controller.confinement.off or port in self.newcomers
        return not off and port.controller.suspended_until_ns <= now_ns

    def _give_up(self, lost: tuple[Entry, Entry, int]) -> None:
        entry, winner, bit = lost
        if self._current is winner and entry in self.queues.pending:
            self.lose(self._by_order[entry[1]], entry, bit)

    def lose(self, port: Port, entry: Entry, bit: int) -> None:
        """Arbitration Lost: give the frame up, and say so."""
        self.queues.take(entry)
        self.leave_queue(port, cause.ARBITRATION)
        self.reporter.arbitration_lost(port, bit)

    def flips(self, entry: Entry) -> Flips:
        """Return the bits of this frame that a fault inverts."""
        if self.faults is None:
            return {}
        return self.faults.flips(self._by_order[entry[1]].name, self.identifier(entry), entry[5])

    # -- the end of a frame --

    def _deliver(self, entry: Entry) -> None:
        if entry is not self._current:
            return
        self._current = None
        self._sender = port = self._by_order[entry[1]]
        self.queues.sent(port, entry)
        self.leave_queue(port)
        now_ns = self.agenda.now_ns
        identifier = entry[4] if entry[4] < FD else self.identifier(entry)
        self.delivery.deliver(port, now_ns, identifier, entry[5])
        self._free_from_ns = now_ns + INTERMISSION_BITS * self._bit_ns
        if not self._plain:
            acknowledged(self, port)
            self._settle(port)
        if self.queues.pending:
            self.agenda.at(self._free_from_ns, ARBITRATE, -1, self._arbitrate, None)
        else:
            self._idle = True

    def _settle(self, sender: Port) -> None:
        """Let a passive sender wait longer, and tell what the counters say now."""
        if sender.controller.confinement.passive:
            sender.controller.suspended_until_ns = self._free_from_ns + SUSPEND_BITS * self._bit_ns
        self.reporter.check_states()

    # -- nobody there --

    def _start_unacknowledged(self, entry: Entry) -> None:
        """Begin a frame that nobody will acknowledge: the error is due behind the ACK slot."""
        self._current, self._since_ns = entry, self.agenda.now_ns
        lasts_ns = duration_ns(self.identifier(entry), entry[5], self.rates) - TAIL_BITS * self._bit_ns
        self._planned_ns = lasts_ns
        self.busy_ns += lasts_ns
        self.agenda.at(self.agenda.now_ns + lasts_ns, DELIVER, entry[1], self._not_acknowledged, entry)

    def _not_acknowledged(self, entry: Entry) -> None:
        if entry is not self._current:
            return
        self._current = None
        self._sender = self._by_order[entry[1]]
        rest_ns = not_acknowledged(self, self._sender, entry)
        self.busy_ns += rest_ns
        self._free_from_ns = self.agenda.now_ns + rest_ns
        self._settle(self._sender)
        self._arbitrate_soon()

    def failed(self, port: Port, entry: Entry, code: int, field: str) -> None:
        """Bus Error of a sender: its frame waits again, or is given up where it has one shot."""
        controller = port.controller
        if controller.one_shot or entry is controller.given_up:
            self.leave_queue(port, cause.ONE_SHOT if controller.one_shot else cause.FLUSHED)
        else:
            controller.repeated += 1
            self.queues.put([entry])
        self.reporter.bus_error(port, code, field, sending=True)

    # -- bit by bit --

    def disturb(self) -> None:
        """Go on bit by bit from here: a fault begins or ends in the middle of something."""
        if self.play is not None or self.functional:
            return
        entry, self._current = self._current, None
        self._idle = False
        if entry is None:
            self.agenda.at(self.agenda.now_ns, ARBITRATE, -1, self._play_from_here, None)
        else:
            self.busy_ns -= self._planned_ns
            self.queues.put([entry])
            self._play(BitPlay(self, None, entry, self._since_ns))

    def _play_from_here(self, _: None) -> None:
        """Go on between frames; an error frame that was computed whole ends first."""
        now_ns, rest_ns = self.agenda.now_ns, INTERMISSION_BITS * self._bit_ns
        suspended_ns = max((port.controller.suspended_until_ns for port in self.ports), default=now_ns)
        if self.play is not None:
            return
        if self._current is not None:
            self.disturb()
        elif now_ns < self._free_from_ns - rest_ns:
            self.agenda.at(self._free_from_ns - rest_ns, ARBITRATE, -1, self._play_from_here, None)
        elif now_ns < max(self._free_from_ns, suspended_ns) and self._sender in self.ports:
            self.busy_ns -= rest_ns
            self._play(BitPlay(self, None, None, self._free_from_ns - rest_ns, self._sender))
        else:
            self._play(BitPlay(self, None))

    def _play(self, play: BitPlay) -> None:
        self.play = play
        play.begin()

    def resume(self) -> None:
        """Compute frames whole again: everybody is idle."""
        self.play = None
        self.newcomers.clear()
        self._free_from_ns = self.agenda.now_ns
        self._idle = True
        self.assess()
        self.rouse()

    def confirm(self, port: Port, entry: Entry, identifier: int) -> None:
        """Confirm: a frame that was played bit by bit has gone out."""
        self.queues.take(entry)
        self.queues.sent(port, entry)
        self.leave_queue(port)
        self.delivery.confirm(port, self.agenda.now_ns, identifier, entry[5])
