"""What happens on a bus besides frames, and how candump-style tools are told: the error frames of linux/can/error.h.

The names are those of FMI-LS-BUS 1.0 (CAN operations). Byte 5 of an error frame, which linux/can/error.h leaves to the
controller, is the number of the node on the bus; bytes 6 and 7 are its error counters, at most 255.

Ref: linux/can/error.h; FMI-LS-BUS 1.0, "CAN, CAN FD, CAN XL".
"""

from typing import NamedTuple

from hil.wire.confinement import BUS_OFF, ERROR_ACTIVE, ERROR_PASSIVE
from hil.wire.frame_reader import (
    ACK_ERROR,
    ARBITRATION_LOST,
    BIT_ERROR,
    BUS_ERROR,
    CRC_ERROR,
    FORM_ERROR,
    OVERLOAD,
    STUFF_ERROR,
)
from hil.wire.identifier import ERROR
from hil.wire.port import ALL_ERRORS, OWN_ERRORS, Port

STATUS, OVERRUN = "Status", "Receive Overrun"

ERROR_NAMES = {
    BIT_ERROR: "bit",
    STUFF_ERROR: "stuff",
    FORM_ERROR: "form",
    CRC_ERROR: "CRC",
    ACK_ERROR: "ACK",
    OVERLOAD: "overload",
}

# Classes, in the identifier.
LOST_ARBITRATION, CONTROLLER, PROTOCOL, NO_ACK = 0x002, 0x004, 0x008, 0x020
OFF, BUS_ERROR_CLASS, RESTARTED, COUNTERS = 0x040, 0x080, 0x100, 0x200
# Byte 1: of the controller.
RX_OVERFLOW, RX_WARNING, TX_WARNING, RX_PASSIVE, TX_PASSIVE, ACTIVE = 0x01, 0x04, 0x08, 0x10, 0x20, 0x40
# Byte 2: what was violated; byte 3: where.
WHAT = {BIT_ERROR: 0x01, FORM_ERROR: 0x02, STUFF_ERROR: 0x04, OVERLOAD: 0x20}
WHILE_SENDING = 0x80
WHERE = {
    "SOF": 0x03,
    "ID 28-21": 0x02,
    "ID 20-18": 0x06,
    "SRTR": 0x04,
    "ID 17-13": 0x07,
    "ID 12-5": 0x0F,
    "ID 4-0": 0x0E,
    "RTR": 0x0C,
    "IDE": 0x05,
    "r1": 0x0D,
    "r0": 0x09,
    "res": 0x0D,
    "BRS": 0x0D,
    "ESI": 0x0D,
    "DLC": 0x0B,
    "data": 0x0A,
    "CRC": 0x08,
    "CRC delimiter": 0x18,
    "ACK slot": 0x19,
    "ACK delimiter": 0x1B,
    "EOF": 0x1A,
    "intermission": 0x12,
    "active error flag": 0x11,
    "passive error flag": 0x16,
    "error delimiter": 0x17,
}


class BusEvent(NamedTuple):
    """Something that a controller noticed.

    name: Bus Error, Arbitration Lost, Status or Receive Overrun. code: of a bus error; of Status the state. field: of
    the frame. sending: whether it was the sender. number: the bit at which arbitration was lost. warning: of Status.
    before: the state before (Status).
    """

    time_ns: int
    port: Port
    name: str
    code: int = 0
    field: str = ""
    sending: bool = False
    number: int = 0
    before: int = ERROR_ACTIVE


def show(event: BusEvent) -> None:
    """Show an event as an error frame to whoever on its bus listens for those."""
    arrival = (event.time_ns, *error_frame(event))
    for port in event.port.medium.ports:
        if port.hears == ALL_ERRORS or (port.hears == OWN_ERRORS and port is event.port):
            port.hear(arrival)


def error_frame(event: BusEvent) -> tuple[int, bytes]:
    """Return (identifier with the flag ERROR, 8 bytes of data)."""
    confinement = event.port.controller.confinement
    data = bytearray(8)
    data[5] = event.port.order & 0xFF
    data[6], data[7] = min(confinement.tec, 255), min(confinement.rec, 255)
    kind = COUNTERS
    if event.name == BUS_ERROR:
        kind |= BUS_ERROR_CLASS | (NO_ACK if event.code == ACK_ERROR else PROTOCOL)
        data[2] = WHAT.get(event.code, 0) | WHILE_SENDING * event.sending
        data[3] = WHERE["CRC"] if event.code == CRC_ERROR else WHERE.get(event.field, 0)
    elif event.name == ARBITRATION_LOST:
        kind |= LOST_ARBITRATION
        data[0] = min(event.number, 255)
    elif event.name == OVERRUN:
        kind |= CONTROLLER
        data[1] = RX_OVERFLOW
    else:
        kind |= _status(event, data)
    return ERROR | kind, bytes(data)


def _status(event: BusEvent, data: bytearray) -> int:
    """Fill in a change of the error state; return its class."""
    confinement = event.port.controller.confinement
    if event.code == BUS_OFF:
        return OFF
    if event.before == BUS_OFF:
        return RESTARTED
    transmit = confinement.tec >= confinement.rec
    if event.code == ERROR_PASSIVE:
        data[1] = TX_PASSIVE if transmit else RX_PASSIVE
    elif confinement.warning:
        data[1] = TX_WARNING if transmit else RX_WARNING
    else:
        data[1] = ACTIVE
    return CONTROLLER
