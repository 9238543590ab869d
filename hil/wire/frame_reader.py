"""A frame as a controller reads it from the bus, bit by bit; who sends reads along, and compares.

An error is an exception that ends the frame where it is detected. Every step is a generator: it yields the level that
it drives for one bit (None: that of the plan, or recessive) and is sent the level that it saw.

Ref: ISO 11898-1:2015, 10.4 to 10.11 (frames, errors); Bosch, CAN Specification 2.0, part B.
Not implemented: protocol exception on a recessive res bit (a form error here), an acknowledgement two bits long in FD.
"""

from collections.abc import Generator

from hil.wire.confinement import Confinement
from hil.wire.fd_bits import LONGEST_CRC17
from hil.wire.frame_plan import DOMINANT, RECESSIVE, FramePlan, crc15, crc17, crc21, stuff_count
from hil.wire.identifier import BRS, ESI, EXTENDED, FD, FD_LENGTHS, LONGEST_CLASSIC, REMOTE

BIT_ERROR, STUFF_ERROR, FORM_ERROR, CRC_ERROR, ACK_ERROR, OVERLOAD = range(1, 7)
"""Numbered as in FMI-LS-BUS 1.0 (CAN, Bus Error operation); an overload is no error."""

EOF_BITS = 7

BASE_IDENTIFIER = ("ID 28-21", 8), ("ID 20-18", 3)
IDENTIFIER_EXTENSION = ("ID 17-13", 5), ("ID 12-5", 8), ("ID 4-0", 5)
"""Parts and widths, as linux/can/error.h tells them apart; the first two are the bits 10 to 3 and 2 to 0 of 11."""

Bits = Generator[int | None, int, None]
Value = Generator[int | None, int, int]

RECEIVED, CONFIRM, ARBITRATION_LOST, BUS_ERROR = "Received", "Confirm", "Arbitration Lost", "Bus Error"

Happening = tuple[str, int, bytes, str]
"""(what, identifier or error code, data, field of the frame)"""


class Detected(Exception):
    """A controller detects an error, or the condition of an overload frame. counts: the error counters move."""

    def __init__(self, code: int, counts: bool = True, in_flag: bool = False) -> None:
        super().__init__(code)
        self.code = code
        self.counts = counts
        self.in_flag = in_flag


class FrameReader:
    """One controller in the middle of a frame. fast: it is in the data phase. happened: since that was read last.

    listen_only: it never drives the bus, takes what it would drive for what it sees, and counts no errors.
    """

    def __init__(self, confinement: Confinement, listen_only: bool) -> None:
        self.confinement = confinement
        self.listen_only = listen_only
        self.fast = False
        self.suspended = False
        self.field = "idle"
        self.happened: list[Happening] = []
        self._plan: FramePlan | None = None
        self._transmitter = False
        self._position = 0
        self._raw: list[int] = []
        self._plain: list[int] = []
        self._stuffed = self._run = 0

    def _frame(self) -> Bits:
        """Read a frame whose SOF was just seen, sending along if there is a plan."""
        self._raw, self._plain, self._stuffed, self._run = [DOMINANT], [DOMINANT], 0, 1
        self.suspended = False
        identifier = yield from self._arbitration_field()
        self.field = "r0" if not identifier & EXTENDED else "r1"
        if (yield from self._read(1)) == RECESSIVE:
            identifier |= yield from self._fd_control()
        elif identifier & EXTENDED:
            self.field = "r0"
            yield from self._read(1)
        self.field = "DLC"
        dlc = yield from self._read(4)
        length = FD_LENGTHS[dlc] if identifier & FD else min(dlc, LONGEST_CLASSIC)
        data = bytearray()
        self.field = "data"
        for _ in range(0 if identifier & REMOTE else length):
            data.append((yield from self._read(8)))
        self.field = "CRC"
        intact = yield from (self._fd_crc(length) if identifier & FD else self._crc())
        yield from self._tail(intact)
        content = bytes(length) if identifier & REMOTE else bytes(data)
        yield from self._end_of_frame(identifier, content)

    def _arbitration_field(self) -> Value:
        identifier = yield from self._identifier(BASE_IDENTIFIER, 0)
        self.field = "SRTR"
        remote = yield from self._read(1)
        self.field = "IDE"
        if (yield from self._read(1)) == RECESSIVE:
            identifier = EXTENDED | (yield from self._identifier(IDENTIFIER_EXTENSION, identifier))
            self.field = "RTR"
            remote = yield from self._read(1)
        return identifier | REMOTE * remote

    def _identifier(self, parts: tuple[tuple[str, int], ...], identifier: int) -> Value:
        for self.field, width in parts:
            identifier = identifier << width | (yield from self._read(width))
        return identifier

    def _fd_control(self) -> Value:
        """Read what follows FDF: res, BRS, ESI."""
        self.field = "res"
        if (yield from self._read(1)) == RECESSIVE:
            raise Detected(FORM_ERROR)
        self.field = "BRS"
        switches = yield from self._read(1)
        self.fast = bool(switches)
        self.field = "ESI"
        return FD | BRS * switches | ESI * (yield from self._read(1))

    def _crc(self) -> Value:
        expected = crc15(self._plain)
        found = yield from self._read(15)
        if self._run == 5:
            yield from self._stuff_bit()
        return int(found == expected)

    def _fd_crc(self, length: int) -> Value:
        """Read stuff count and CRC, a fixed stuff bit before every four bits."""
        width, crc = (17, crc17) if length <= LONGEST_CRC17 else (21, crc21)
        count = stuff_count(self._stuffed)
        expected = count << width | crc([*self._raw, *(count >> bit & 1 for bit in (3, 2, 1, 0))])
        found, last = 0, self._raw[-1]
        for index in range(4 + width):
            if index % 4 == 0:
                fixed = yield from self._bit()
                if fixed == last:
                    raise Detected(FORM_ERROR)
            last = yield from self._bit()
            found = found << 1 | last
        return int(found == expected)

    def _tail(self, intact: int) -> Bits:
        """Pass CRC delimiter, ACK slot and ACK delimiter."""
        self.field = "CRC delimiter"
        if (yield from self._bit()) == DOMINANT:
            raise Detected(FORM_ERROR)
        self.fast = False
        self.field = "ACK slot"
        if self._transmitter:
            if (yield RECESSIVE) == RECESSIVE:
                raise Detected(ACK_ERROR)
        elif intact:
            if (yield DOMINANT) == RECESSIVE and not self.listen_only:
                raise Detected(BIT_ERROR)
            if not self.listen_only:
                self.confinement.received()
        else:
            yield RECESSIVE
        self._position += 1
        self.field = "ACK delimiter"
        if (yield from self._bit()) == DOMINANT:
            raise Detected(FORM_ERROR)
        if not intact:
            raise Detected(CRC_ERROR)

    def _end_of_frame(self, identifier: int, data: bytes) -> Bits:
        """Pass EOF. A receiver holds the frame valid one bit before its sender does."""
        self.field = "EOF"
        for _ in range(EOF_BITS - 1):
            if (yield from self._bit()) == DOMINANT:
                raise Detected(FORM_ERROR)
        if self._transmitter:
            yield from self._bit()
            self.confinement.transmitted()
            self._say(CONFIRM, identifier, data)
            return
        last = yield RECESSIVE
        self._say(RECEIVED, identifier, data)
        if last == DOMINANT:
            raise Detected(OVERLOAD)

    # -- bits --

    def _read(self, count: int) -> Value:
        """Read some bits of a stuffed field."""
        value = 0
        for _ in range(count):
            if self._run == 5:
                yield from self._stuff_bit()
            bit = yield from self._bit()
            self._run = self._run + 1 if bit == self._raw[-1] else 1
            self._raw.append(bit)
            self._plain.append(bit)
            value = value << 1 | bit
        return value

    def _stuff_bit(self) -> Bits:
        bit = yield from self._bit()
        if bit == self._raw[-1]:
            raise Detected(STUFF_ERROR)
        self._raw.append(bit)
        self._stuffed += 1
        self._run = 1

    def _bit(self) -> Value:
        """Read one bit, and compare it with what is sent."""
        seen = yield None
        if self._transmitter and self._plan is not None and seen != self._plan.levels[self._position]:
            self._differs(self._plan, seen)
        self._position += 1
        return seen

    def _differs(self, plan: FramePlan, seen: int) -> None:
        arbitrating = self._position < plan.arbitration_end and seen == DOMINANT
        if not arbitrating:
            raise Detected(BIT_ERROR)
        if plan.stuff[self._position]:
            raise Detected(STUFF_ERROR, counts=False)  # rule 3, exception 2
        self._plan, self._transmitter = None, False
        self._say(ARBITRATION_LOST, self._position, b"")

    def _say(self, what: str, number: int, data: bytes) -> None:
        self.happened.append((what, number, data, self.field))
