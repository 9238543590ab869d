"""What the controllers of one bus notice besides frames: counted, and told to whoever listens."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from hil.wire import controller as cause
from hil.wire.events import ERROR_NAMES, OVERRUN, STATUS, BusEvent
from hil.wire.frame_reader import ACK_ERROR, ARBITRATION_LOST, BUS_ERROR
from hil.wire.port import Port

if TYPE_CHECKING:
    from hil.wire.medium import Medium

Listener = Callable[[BusEvent], None]


class Reporter:
    """Counts and tells for one bus. listeners: who is told."""

    def __init__(self, medium: "Medium") -> None:
        self.listeners: list[Listener] = []
        self._medium = medium

    def bus_error(self, port: Port, code: int, field: str, sending: bool = False) -> None:
        """Count a bus error; that nobody acknowledges is told once, not at each attempt."""
        controller = port.controller
        controller.errors[ERROR_NAMES[code]] += 1
        if code == ACK_ERROR:
            told, controller.unheard = controller.unheard, True
            if told:
                return
        self._tell(BusEvent(self._medium.agenda.now_ns, port, BUS_ERROR, code, field, sending))

    def arbitration_lost(self, port: Port, bit: int) -> None:
        """Tell of a frame that was given up because it lost."""
        self._tell(BusEvent(self._medium.agenda.now_ns, port, ARBITRATION_LOST, number=bit))

    def overrun(self, port: Port) -> None:
        """Count a frame that a participant was too slow for."""
        port.controller.lost[cause.OVERRUN] += 1
        self._tell(BusEvent(self._medium.agenda.now_ns, port, OVERRUN))

    def check_states(self) -> None:
        """Tell of changed error states, and let the bus take note of them."""
        now_ns = self._medium.agenda.now_ns
        for port in self._medium.ports:
            controller = port.controller
            if controller.standing != controller.told:
                before, controller.told = controller.told[0], controller.standing
                if controller.confinement.off:
                    controller.off_since_ns = now_ns
                self._tell(BusEvent(now_ns, port, STATUS, controller.told[0], before=before))
        self._medium.assess()
        self._medium.recovery.expect()

    def _tell(self, event: BusEvent) -> None:
        for listener in self.listeners:
            listener(event)
