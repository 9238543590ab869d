"""Frames as the nodes pack and unpack them: raw integers to bytes and back, by a table the compiler made from the DBC.

A protected message ends with a CRC-8 over its identifier and its payload. The codec adds and checks that byte itself,
so that nobody sees it among the values. Both directions run some thirty times a simulated millisecond: hence local
names and a CRC that starts behind the identifier.
"""

import struct

from dbc.crc import CRC8_INVERT, CRC8_RESIDUE, CRC8_TABLE, crc8_register

Row = tuple[str, int, list[tuple[str, str, float]], bool]
"""What a message's codec is built from."""
CRC_SIGNAL = "Crc"
"""Name of the last signal of a protected message."""

_RANGES = {"B": (0, 0xFF), "H": (0, 0xFFFF), "I": (0, 0xFFFFFFFF)}
_RANGES |= {"b": (-0x80, 0x7F), "h": (-0x8000, 0x7FFF), "i": (-0x80000000, 0x7FFFFFFF)}
_CRC_BYTE = [bytes([register ^ CRC8_INVERT]) for register in range(256)]


class CodecError(ValueError):
    """A database, name or value that the codec refuses; the text says which, the limit and the cure."""


class MessageCodec:
    """One message: its name, identifier, length in bytes, signals without the CRC and their formats, as of struct."""

    __slots__ = (
        "_factors",
        "_pack",
        "_register",
        "_unpack",
        "formats",
        "identifier",
        "layout",
        "length",
        "name",
        "protected",
        "signals",
    )

    def __init__(self, name: str, identifier: int, layout: list[tuple[str, str, float]], protected: bool):
        """Build the codec of a message from the (name, struct format, factor) of its signals; the CRC is not listed."""
        self.name = name
        self.identifier = identifier
        self.layout = layout
        self.signals = tuple(signal for signal, _, _ in layout)
        self.formats = "".join(code for _, code, _ in layout)
        self._factors = {signal: factor for signal, _, factor in layout}
        payload = struct.Struct("<" + self.formats)
        self.length = payload.size + protected
        self._pack = payload.pack
        self._unpack = payload.unpack_from
        self.protected = protected
        self._register = crc8_register(identifier.to_bytes(2, "big"))

    def pack(self, *values: int) -> bytes:
        """Return the frame's data; raise CodecError if a raw value does not fit its signal."""
        try:
            payload = self._pack(*values)
        except struct.error:
            raise self._refusal(values) from None
        if not self.protected:
            return payload
        table = CRC8_TABLE
        register = self._register
        for byte in payload:
            register = table[register ^ byte]
        return payload + _CRC_BYTE[register]

    def unpack(self, data: bytes) -> tuple[int, ...] | None:
        """Return the raw values, or None if the length or the CRC is wrong."""
        if len(data) != self.length:
            return None
        if self.protected:
            table = CRC8_TABLE
            register = self._register
            for byte in data:
                register = table[register ^ byte]
            if register != CRC8_RESIDUE:
                return None
        return self._unpack(data)

    def factor(self, signal: str) -> float:
        """Return what one count of a signal means in its physical unit."""
        if signal not in self._factors:
            raise CodecError(f"message {self.name} has no signal {signal!r}: it has {', '.join(self.signals)}")
        return self._factors[signal]

    def _refusal(self, values: tuple[int, ...]) -> CodecError:
        """Return the reason why values cannot be packed."""
        if len(values) != len(self.signals):
            wanted = ", ".join(self.signals)
            return CodecError(f"message {self.name} takes {len(self.signals)} values ({wanted}), got {len(values)}")
        for signal, code, value in zip(self.signals, self.formats, values, strict=True):
            low, high = _RANGES[code]
            if not hasattr(value, "__index__"):
                return CodecError(
                    f"{self.name}.{signal}: {value!r} is not a raw integer: divide by the factor and round"
                )
            if not low <= value <= high:
                return CodecError(
                    f"{self.name}.{signal}: raw value {value} is outside {low}..{high}: saturate it first"
                )
        raise AssertionError(f"struct refused values in range: {self.name}{values}")


class Codec(dict[str, MessageCodec]):
    """All messages of a database by name, `by_identifier` by identifier. version: of the database, 0 if it has none."""

    def __init__(self, messages: list[MessageCodec], version: int = 0):
        super().__init__((message.name, message) for message in messages)
        self.by_identifier = {message.identifier: message for message in messages}
        self.version = version

    def table(self) -> tuple[list[Row], int]:
        """Return what `of_table` makes the same codec of, as JSON can hold it: a node of a run reads no database."""
        return [(each.name, each.identifier, each.layout, each.protected) for each in self.values()], self.version

    @classmethod
    def of_table(cls, rows: list[Row], version: int) -> "Codec":
        """Return the codec of such a table."""
        return cls([MessageCodec(*row) for row in rows], version)

    def __missing__(self, name: str) -> MessageCodec:
        """Refuse an unknown name."""
        nearest = sorted(self, key=lambda known: _likeness(name, known), reverse=True)[:3]
        raise CodecError(f"no message {name!r} in the database: did you mean {', '.join(nearest)}?")

    def scale(self, message: str, signal: str) -> float:
        """Return what one count of a signal means in its physical unit."""
        return self[message].factor(signal)


def _likeness(name: str, other: str) -> float:
    """Return the share of neighbouring letters that two names have in common, 0 to 1."""
    pairs, others = ({text[i : i + 2] for i in range(len(text) - 1)} for text in (name.lower(), other.lower()))
    return 2 * len(pairs & others) / (len(pairs) + len(others) or 1)
