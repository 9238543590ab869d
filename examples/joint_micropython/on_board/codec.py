"""Frames as a joint packs and unpacks them: stands for dbc/codec.py, which takes more of Python than a board has.

Not implemented: refusal of a value that does not fit its signal (the joint's are saturated), factors.
"""

import struct

from dbc.crc import CRC8_INVERT, CRC8_RESIDUE, crc8_register


class Message:
    """One message: identifier, format of its signals in struct's letters, whether a CRC-8 is its last byte."""

    def __init__(self, identifier, form, protected):
        self.identifier = identifier
        self.form = "<" + form
        self.length = struct.calcsize(self.form) + protected
        self.protected = protected
        self.register = crc8_register(identifier.to_bytes(2, "big"))

    def pack(self, *values):
        """Return the frame's data."""
        payload = struct.pack(self.form, *values)
        if not self.protected:
            return payload
        return payload + bytes((crc8_register(payload, self.register) ^ CRC8_INVERT,))

    def unpack(self, data):
        """Return the raw values, or None if the length or the CRC is wrong."""
        if len(data) != self.length:
            return None
        if self.protected and crc8_register(data, self.register) != CRC8_RESIDUE:
            return None
        return struct.unpack_from(self.form, data)


class Codec:
    """The messages of a table, by name; version: of the database that it was made from."""

    def __init__(self, table, version):
        self.version = version
        self.messages = {name: Message(*layout) for name, *layout in table}

    def __getitem__(self, name):
        return self.messages[name]
