"""Another sender of our identifiers during a run on a bus, known by what it sends.

Nodes say the same again while somebody is not there, but never two things of one cycle, never something of an earlier
one, and nothing before its Sync. Only a joint takes its current back, when it hears Stop: then (0, 0) has the cycle of
its last answer, and the run does not go on.
CAN's own CRC keeps damage away, so a frame with our identifier and without our length and CRC-8 is not ours either.
"""

from dbc.codec import Codec
from hil.doctor.traffic import STRANGER
from hil.errors import ChannelError

EARLY = 3
"""Cycles by which a frame may be ahead of the last Sync heard: sockets need not hear two senders in one order, and a
controller's FIFO that overran may have lost a Sync or two."""


class TwoSenders:
    """Hears every frame; raises ChannelError for one that a single sender would not send.

    in_order: of a run by Sync, where no cycle is left out, none comes late, and no node begins anew.
    """

    def __init__(self, codec: Codec, in_order: bool = True) -> None:
        self._in_order = in_order
        self._codecs = codec.by_identifier
        self._sync = codec["Sync"].identifier
        self._of_cycles = {each.identifier for each in codec.values() if "Cycle" in each.signals}
        self._last: dict[int, tuple[int, bytes]] = {}
        self._doubt: tuple[int, ChannelError] | None = None

    def hear(self, identifier: int, data: bytes, cycle: int) -> None:
        """Take a frame; cycle: the present one, for the message."""
        message = self._codecs.get(identifier)
        if message is None:
            return
        fields = message.unpack(data)
        if fields is None:
            raise self._stranger(identifier, data, cycle, "whose length or CRC is not that of arm.dbc")
        if identifier not in self._of_cycles or (identifier != self._sync and self._sync not in self._last):
            return
        byte = fields[message.signals.index("Cycle")]
        why = self._objection(identifier, byte, data)
        if not why:
            self._last[identifier] = byte, data
        elif message.name.startswith("Current") and not any(fields[:-1]):
            self._doubt = self._doubt or (byte, self._stranger(identifier, data, cycle, why))
        else:
            raise self._stranger(identifier, data, cycle, why)
        if self._doubt is not None and identifier == self._sync and _ahead(byte, self._doubt[0]) > EARLY:
            raise self._doubt[1]

    def _objection(self, identifier: int, byte: int, data: bytes) -> str:
        """Return why a single sender would not send this, or nothing."""
        last_byte, last = self._last.get(identifier, (byte, data))
        sync_byte, _ = self._last.get(self._sync, (byte, data))
        if self._in_order and _ahead(byte, last_byte) < 0:
            return f"behind {_hex(last)} of a later cycle"
        if self._in_order and identifier != self._sync and _ahead(byte, sync_byte) > EARLY:
            return f"before Sync {byte}"
        return f"and {_hex(last)}, both of one cycle" if byte == last_byte and data != last else ""

    def _stranger(self, identifier: int, data: bytes, cycle: int, why: str) -> ChannelError:
        name = self._codecs[identifier].name
        return ChannelError(f"{name} {identifier:#05x} in cycle {cycle}: {_hex(data)} {why}: {STRANGER}")


def _ahead(byte: int, other: int) -> int:
    """Return by how many cycles one is ahead of another, from their lowest bytes."""
    return ((byte - other + 0x80) & 0xFF) - 0x80


def _hex(data: bytes) -> str:
    return data.hex(" ").upper() or "no data"
