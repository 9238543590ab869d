"""One CAN bus in virtual time: its agenda, its medium, and the participants at their ports.

Fidelity `bits`: frames take their exact time. `functional`: frames and computing take none.
"""

from collections.abc import Sequence

from hil.wire import controller as cause
from hil.wire.agenda import ARBITRATE, Agenda
from hil.wire.controller import Entry
from hil.wire.delivery import Watcher
from hil.wire.medium import Medium
from hil.wire.port import Arrival, Participant, Port
from hil.wire.rates import Rates
from hil.wire.reporter import Listener

__all__ = ["Arrival", "Kernel", "Participant", "Port", "Watcher"]

LINGER_NS = 100_000
"""Virtual time between two looks at whether somebody who leaves has sent all."""
LEAVE_NS = 1_000_000_000
"""Virtual time after which it goes, whatever it still had to send."""


class Kernel:
    """One bus. Several share their time by sharing an agenda."""

    def __init__(
        self,
        bit_ns: int,
        functional: bool = False,
        start_ns: int = 0,
        data_bit_ns: int | None = None,
        agenda: Agenda | None = None,
    ) -> None:
        self.agenda = agenda or Agenda(start_ns)
        self.medium = Medium(self.agenda, Rates(bit_ns, data_bit_ns), functional)
        self.ports: list[Port] = []
        self._apart: dict[Port, Medium] = {}

    # -- who takes part --

    def join(self, participant: Participant) -> Port:
        """Add a participant; the order of joining breaks ties."""
        port = Port(participant)
        self.adopt(port)
        return port

    def adopt(self, port: Port) -> None:
        """Add a port that was made elsewhere."""
        self.agenda.joined += 1
        port.order = self.agenda.joined
        self.ports.append(port)
        self.medium.attach(port)

    def retire(self, port: Port) -> None:
        """Let a participant go as soon as what it had to send is sent; where nobody is left to hear it, it is lost."""
        self.rejoin(port)
        if port.controller.leaving:
            return
        port.timer_ns = None
        port.controller.leaving = True
        self.medium.assess()
        deadline_ns = self.agenda.now_ns + LEAVE_NS
        self.agenda.at(self.agenda.now_ns, ARBITRATE, port.order, self._let_go, (port, deadline_ns))

    def _let_go(self, leaving: tuple[Port, int]) -> None:
        port, deadline_ns = leaving
        others = any(each.controller.acknowledges for each in self.medium.ports if each is not port)
        busy = (port.controller.queued and others) or port.delayed
        if busy and self.agenda.now_ns < deadline_ns:
            self.agenda.at(self.agenda.now_ns + LINGER_NS, ARBITRATE, port.order, self._let_go, leaving)
            return
        self.medium.flush(port, cause.LEFT)
        self.medium.detach(port)
        self.ports.remove(port)
        port.controller.depth = 0  # what it may still ask to send comes too late
        port.inbox.clear()
        self.agenda.forget(port)

    def start(self) -> None:
        """Tell every participant that time begins."""
        for port in self.ports:
            port.begin()

    def run(self, until_ns: int) -> None:
        """Carry out everything due up to and at until_ns, or until stopped."""
        self.agenda.run(until_ns)

    # -- a broken cable --

    def cut_off(self, port: Port) -> None:
        """Cut a participant off: it goes on alone, at its end of the cable."""
        if port not in self._apart:
            waiting = self.medium.detach(port)
            self._apart[port] = Medium(self.agenda, self.medium.rates, self.medium.functional)
            self._move(port, self._apart[port], waiting, False)

    def rejoin(self, port: Port) -> None:
        """Mend the cable; it takes part when it has heard 11 recessive bits."""
        if port in self._apart:
            waiting = self._apart.pop(port).detach(port)
            self._move(port, self.medium, waiting, True)

    def _move(self, port: Port, medium: Medium, waiting: Sequence[Entry], mended: bool) -> None:
        medium.reporter.listeners = self.medium.reporter.listeners
        medium.attach(port, mended)
        medium.adopt(waiting)

    # -- what others ask --

    @property
    def now_ns(self) -> int:
        """The present."""
        return self.agenda.now_ns

    @now_ns.setter
    def now_ns(self, now_ns: int) -> None:
        self.agenda.now_ns = now_ns

    @property
    def stopped(self) -> bool:
        """Whether time stands still for good."""
        return self.agenda.stopped

    @stopped.setter
    def stopped(self, stopped: bool) -> None:
        self.agenda.stopped = stopped

    @property
    def next_ns(self) -> int | None:
        """When something is due next."""
        return self.agenda.next_ns

    @property
    def waking(self) -> str:
        """The participant called last."""
        return self.agenda.acting

    @property
    def watchers(self) -> list[Watcher]:
        """Who is told of every frame."""
        return self.medium.delivery.watchers

    @property
    def queued_ns(self) -> int:
        """Since when the frame waited that watchers are told of."""
        return self.medium.queues.queued_ns

    @property
    def listeners(self) -> list[Listener]:
        """Who is told of errors, states, overruns and lost arbitration."""
        return self.medium.reporter.listeners

    @property
    def rates(self) -> Rates:
        """How long its bits last."""
        return self.medium.rates

    @property
    def functional(self) -> bool:
        """Whether frames take no time."""
        return self.medium.functional

    @property
    def bit_ns(self) -> int:
        """Nominal bit time; 0 where frames take none."""
        return 0 if self.medium.functional else self.medium.rates.bit_ns

    @property
    def bits_on_wire(self) -> int:
        """Nominal bits in which the bus was not idle, intermission counted."""
        return self.medium.busy_ns // self.medium.rates.bit_ns
