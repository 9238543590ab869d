"""Error frames in words: what a controller tells of its bus, counted by cause, and when a run cannot go on.

Each cause has a cure. bus-off ends a run at once; any other trouble when nothing but trouble has come for PERSISTENT_S,
since a controller repeats a disturbed frame by itself, and a board may be switched on later than the rig.

Ref: linux/can/error.h; drivers/net/can/sja1000/sja1000.c (a controller that tells only where an error was, for which a
missing acknowledgement is an error in the ACK slot while it sends).
"""

from collections import Counter
from collections.abc import Mapping

from hil.errors import NodeError
from hil.wire import events

WIRES = "look for a node at another bit rate, a missing terminator (CAN-H to CAN-L: 60 ohm), a bad wire"
PERSISTENT_S = 5.0
"""Wall time of nothing but trouble that ends a run."""
PAUSE_S = 1.0
"""Wall time without an error frame after which the next one is another trouble."""

RECEIVE_OVERRUN, SEND_OVERRUN = "receive FIFO overrun", "transmit buffer overrun"
NO_ACK, OFF, PASSIVE = "no acknowledgement", "bus-off", "error-passive"
CLASSES = {
    events.PROTOCOL: "protocol violation",
    events.NO_ACK: NO_ACK,
    events.OFF: OFF,
    events.RESTARTED: "restarted",
    events.LOST_ARBITRATION: "arbitration lost",
    0x001: "transmission timed out",
    0x010: "transceiver trouble",
}
CONTROLLER_TROUBLE = {
    events.RX_OVERFLOW: RECEIVE_OVERRUN,
    0x02: SEND_OVERRUN,
    events.RX_WARNING | events.TX_WARNING: "error counter at the warning limit",
    events.RX_PASSIVE | events.TX_PASSIVE: PASSIVE,
}
"""By the bits of byte 1."""
VIOLATIONS = {
    0x01: "bit error",
    0x02: "form error",
    0x04: "stuff error",
    0x08: "cannot send a dominant bit",
    0x10: "cannot send a recessive bit",
    0x20: "overload frame",
}
"""By the bits of byte 2."""
CURES = {
    RECEIVE_OVERRUN: "frames were lost: the controller's FIFO is too small for the machine's interrupt latency",
    SEND_OVERRUN: "frames were lost: the driver was given more than it can hold",
    NO_ACK: "nobody else is awake on this bus: switch a node on, at the same bit rate; check the wires",
    "restarted": "it came back from bus-off: " + WIRES,
    "transmission timed out": "the driver could not get rid of a frame: " + WIRES,
}
LOST = (RECEIVE_OVERRUN, SEND_OVERRUN)
HARMLESS = ("arbitration lost",)
FIELDS = {code: field for field, code in reversed(events.WHERE.items())} | {events.WHERE["r1"]: "reserved bit"}
ACK_SLOT = events.WHERE["ACK slot"]


def explain(identifier: int, data: bytes) -> list[str]:
    """Return the causes that an error frame names; none for a return to error-active, or counters alone."""
    data = data.ljust(8, b"\0")
    said = [text for bit, text in CLASSES.items() if identifier & bit]
    if identifier & events.PROTOCOL and data[3] == ACK_SLOT and data[2] == events.WHILE_SENDING:
        said[0] = NO_ACK
    if identifier & events.CONTROLLER:
        said += [text for bits, text in CONTROLLER_TROUBLE.items() if data[1] & bits]
    return list(dict.fromkeys(said))


def describe(identifier: int, data: bytes) -> str:
    """Return an error frame whole: causes, which rule was broken, where, and the error counters."""
    data = data.ljust(8, b"\0")
    said = ", ".join(explain(identifier, data))
    if identifier & events.PROTOCOL:
        what = [text for bit, text in VIOLATIONS.items() if data[2] & bit]
        where = [f"in {FIELDS[data[3]]}"] if data[3] in FIELDS else []
        way = "while sending" if data[2] & events.WHILE_SENDING else "while receiving"
        said += f": {' '.join([*what, *where, way])}"
    return said + _counters(identifier, data)


def _counters(identifier: int, data: bytes) -> str:
    """Return the error counters, where the driver tells them (older ones do without saying so)."""
    told = identifier & events.COUNTERS or any(data[6:8])
    return f" (error counters: transmit {data[6]}, receive {data[7]})" if told else ""


class BusErrors:
    """What one interface has told. counts: error frames by cause; those in LOST stand for at least a frame each."""

    def __init__(self, interface: str, channel: str) -> None:
        self.counts: Counter[str] = Counter()
        self._interface, self._channel = interface, channel
        self._last = ""
        self._first_s = self._last_s = 0.0
        self._passive = False

    def hear(self, identifier: int, data: bytes, now_s: float) -> None:
        """Take an error frame; raise NodeError if the bus is off, or nothing works for too long."""
        causes = explain(identifier, data)
        self.counts.update(causes)
        if OFF in causes:
            counters = _counters(identifier, data.ljust(8, b"\0"))
            raise NodeError(self._message(f"the bus is off{counters}", f"{WIRES}{self._restart()}"))
        if identifier & events.CONTROLLER:
            self._passive = PASSIVE in causes
        if not set(causes) - {*LOST, *HARMLESS}:
            return
        if not self._last or (not self._passive and now_s - self._last_s > PAUSE_S):
            self._first_s = now_s
        self._last, self._last_s = describe(identifier, data), now_s
        self.check(now_s)

    def works(self) -> None:
        """Take note of a frame that came whole."""
        self._last = ""

    def check(self, now_s: float) -> None:
        """Raise NodeError if nothing but trouble has come for too long: errors again and again, or error-passive."""
        lasted_s = (now_s if self._passive else self._last_s) - self._first_s
        if self._last and lasted_s >= PERSISTENT_S:
            passive = self._passive and NO_ACK not in self._last
            cure = f"{CURES[NO_ACK]}; {WIRES}" if passive else CURES[NO_ACK] if NO_ACK in self._last else WIRES
            raise NodeError(self._message(f"no frame, only errors for {lasted_s:.0f} s, the last: {self._last}", cure))

    def _restart(self) -> str:
        if self._interface != "socketcan":
            return ""
        link = f"sudo ip link set {self._channel}"
        return f"; then `{link} down; {link} type can restart-ms 100; {link} up`"

    def _message(self, what: str, cure: str) -> str:
        return f"{self._interface} {self._channel}: {what}: {cure}; {see_doctor(self._interface, self._channel)}"


def as_wire(counts: Mapping[str, int]) -> dict[str, Mapping[str, int]]:
    """Return errors and losses, from counts by cause, as a controller of the emulated wire has them."""
    errors = {cause: count for cause, count in counts.items() if cause not in (*LOST, *HARMLESS)}
    return {"errors": errors, "lost": {cause: count for cause, count in counts.items() if cause in LOST}}


def see_doctor(interface: str, channel: str) -> str:
    """Return whom to ask about an interface."""
    return f"see `hil doctor -i {interface} -c {channel}`"
