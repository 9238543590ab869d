"""The set-up protocol from the DSP's side: one entry of one joint's parameter table at a time, until all are confirmed.

The last index carries the CRC-16 of the table; the joint that computes the same becomes ready.
"""

from collections.abc import Sequence

from dbc.codec import Codec
from dbc.crc import crc16

CYCLES_TO_REPEAT = 5
"""Cycles without the acknowledgement until an entry is sent again; an answer takes two."""


def to_int16(value: int) -> int:
    """Return a 16-bit pattern as the signed value that a Parameter frame carries."""
    return value - 0x10000 if value & 0x8000 else value


class Setup:
    """tables: for each joint, its parameter values in index order (int16), without the CRC.

    version: of the database. refusal: why a joint cannot be set up at all, if it cannot.
    """

    def __init__(self, codec: Codec, tables: Sequence[Sequence[int]], version: int) -> None:
        self.parameter = [codec[f"Parameter_{n}"] for n in range(1, len(tables) + 1)]
        self.acknowledge = [codec[f"Acknowledge_{n}"] for n in range(1, len(tables) + 1)]
        self.version = version
        self.tables = [self._with_crc(table) for table in tables]
        self.joint = 0
        self.index = 0
        self.age = 0
        self.sent = False
        self.repeats = 0
        self.crc_errors = 0
        self.refusal = ""
        self.answers = {frame.identifier: n for n, frame in enumerate(self.acknowledge)}

    @staticmethod
    def _with_crc(table: Sequence[int]) -> list[int]:
        check = crc16(b"".join((value & 0xFFFF).to_bytes(2, "little") for value in table))
        return [*table, to_int16(check)]

    @property
    def complete(self) -> bool:
        """All joints have confirmed."""
        return self.joint == len(self.tables)

    def store(self, identifier: int, data: bytes) -> None:
        """Take an acknowledgement; go on to the next entry if it is the one awaited."""
        joint = self.answers[identifier]
        fields = self.acknowledge[joint].unpack(data)
        self.crc_errors += fields is None
        if fields is None or self.complete or joint != self.joint:
            return
        index, value, version, table_crc = fields
        if version != self.version:
            self.refusal = (
                f"joint{joint + 1} was made from version {version} of arm.dbc, the DSP from version {self.version}: "
                "rebuild the board's code from dbc/arm.dbc"
            )
            return
        table = self.tables[joint]
        if (index, value) != (self.index, table[self.index]):
            return
        self.age = 0
        self.sent = False
        self.index += 1
        if self.index == len(table):
            confirmed = to_int16(table_crc) == table[-1]
            self.joint += confirmed
            self.index = 0

    def next_frame(self) -> tuple[int, bytes] | None:
        """Return the Parameter frame (identifier, data) to send in this cycle, if any; to be called once a cycle."""
        if self.complete:
            return None
        due = self.age == 0
        self.age = (self.age + 1) % (CYCLES_TO_REPEAT + 1)
        if not due:
            return None
        self.repeats += self.sent
        self.sent = True
        frame = self.parameter[self.joint]
        return frame.identifier, frame.pack(self.index, self.tables[self.joint][self.index], self.version)
