"""What a frame that is computed whole does to the counters: acknowledged, or by nobody.

The error frame of a sender whom nobody acknowledges is not played bit by bit either: alone, it sends without end.

Ref: ISO 11898-1:2015, 10.4.4 (error frame), 12.1.4.2 (error counters); Bosch, CAN Specification 2.0 (1991), part B, 8.
"""

from itertools import takewhile
from typing import TYPE_CHECKING

from hil.wire.agenda import DELIVER
from hil.wire.bit_level import DELIMITER_BITS, FLAG_BITS, INTERMISSION_BITS
from hil.wire.controller import Entry
from hil.wire.duration import plan_of
from hil.wire.frame_plan import RECESSIVE
from hil.wire.frame_reader import ACK_ERROR, EOF_BITS, FORM_ERROR

if TYPE_CHECKING:
    from hil.wire.medium import Medium
    from hil.wire.port import Port

TAIL_BITS = 1 + EOF_BITS
"""Behind the ACK slot."""


def acknowledged(medium: "Medium", sender: "Port") -> None:
    """Count a good frame for everybody (rules 7 and 8), at its end."""
    for port in medium.ports:
        if port is sender:
            port.controller.confinement.transmitted()
        elif port.controller.acknowledges:
            port.controller.confinement.received()
    medium.recovery.recessive(medium.agenda.now_ns - TAIL_BITS * medium.rates.bit_ns)


def not_acknowledged(medium: "Medium", port: "Port", entry: Entry) -> int:
    """End a frame whose ACK slot was recessive; return how long flag, delimiter and intermission last, in ns.

    A passive sender's flag disturbs and counts nothing: who only listens has its frame, whole.
    """
    agenda, bit_ns, confinement = medium.agenda, medium.rates.bit_ns, port.controller.confinement
    now_ns = agenda.now_ns

    def heard(_: None) -> None:
        for listener in _listeners(medium):
            medium.delivery.receive(listener, agenda.now_ns, identifier, entry[5])

    def torn(_: None) -> None:
        for listener in _listeners(medium):
            medium.reporter.bus_error(listener, FORM_ERROR, "ACK delimiter")

    identifier = medium.identifier(entry)
    if confinement.passive:
        medium.recovery.recessive(now_ns - _recessive_ns(medium, identifier, entry[5]))
        agenda.at(now_ns + TAIL_BITS * bit_ns, DELIVER, entry[1], heard, None)
    else:
        confinement.transmitter_error()
        medium.recovery.recessive(now_ns + FLAG_BITS * bit_ns)
        agenda.at(now_ns + bit_ns, DELIVER, entry[1], torn, None)
    medium.failed(port, entry, ACK_ERROR, "ACK slot")
    return (FLAG_BITS + DELIMITER_BITS + INTERMISSION_BITS) * bit_ns


def _listeners(medium: "Medium") -> list["Port"]:
    controllers = [(port, port.controller) for port in medium.ports]
    return [port for port, controller in controllers if controller.listen_only and not controller.confinement.off]


def _recessive_ns(medium: "Medium", identifier: int, data: bytes) -> int:
    """Return how long the bus has been recessive at the end of the ACK slot."""
    plan, rates = plan_of(identifier, data), medium.rates
    bits = zip(plan.levels[-1 - TAIL_BITS :: -1], plan.fast[-1 - TAIL_BITS :: -1], strict=True)
    recessive = takewhile(lambda bit: bit[0] == RECESSIVE, bits)
    return sum((rates.data_bit_ns or rates.bit_ns) if fast else rates.bit_ns for _, fast in recessive)
