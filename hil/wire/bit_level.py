"""One CAN controller, bit by bit: what it drives, what it makes of what it sees, and how it answers an error.

The wire plays its controllers this way only while a fault touches it; undisturbed frames are computed whole. Each
controller reads the bus by itself, the sender too: who loses arbitration goes on as a receiver without a seam.

The life of a controller is a generator: it yields the level that it drives for one bit (None: its plan's, or recessive)
and is sent the level that it saw. An error is an exception that ends the frame where it is detected.

Ref: ISO 11898-1:2015, 10.4 to 10.11 (frames, errors), 12.1.4 (confinement); Bosch, CAN Specification 2.0, part B.
Not implemented: protocol exception on a recessive res bit (a form error here), an acknowledgement two bits long in FD.
"""

from collections.abc import Generator

from hil.wire.confinement import RECOVERY_BITS, Confinement
from hil.wire.fd_bits import LONGEST_CRC17
from hil.wire.frame_plan import DOMINANT, RECESSIVE, FramePlan, crc15, crc17, crc21, stuff_count
from hil.wire.identifier import BRS, ESI, EXTENDED, FD, FD_LENGTHS, LONGEST_CLASSIC, REMOTE

BIT_ERROR, STUFF_ERROR, FORM_ERROR, CRC_ERROR, ACK_ERROR, OVERLOAD = range(1, 7)
"""Numbered as in FMI-LS-BUS 1.0 (CAN, Bus Error operation); an overload is no error."""

FLAG_BITS = 6
DELIMITER_BITS = 8
INTERMISSION_BITS = 3
SUSPEND_BITS = 8
EOF_BITS = 7

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


class BitLevel:
    """A controller on the bus. idle: it may begin a frame. fast: it is in the data phase. happened: since it was read.

    listen_only: it never drives the bus, and counts no errors. integrating: it has not heard the bus before.
    """

    def __init__(self, confinement: Confinement, listen_only: bool = False, integrating: bool = False) -> None:
        self.confinement = confinement
        self.listen_only = listen_only
        self.idle = False
        self.fast = False
        self.joining = False
        self.suspended = False
        self.field = "idle"
        self.happened: list[Happening] = []
        self._plan: FramePlan | None = None
        self._transmitter = False
        self._position = 0
        self._life = self._live(integrating)
        self._level = next(self._life)

    # -- what the wire does with it --

    @property
    def drives(self) -> int:
        """The level that it drives in the bit that comes."""
        if self._level is not None:
            return RECESSIVE if self.listen_only else self._level
        return RECESSIVE if self._plan is None else self._plan.levels[self._position]

    @property
    def busy(self) -> bool:
        """Whether it is in the middle of something."""
        return not self.idle and self.field != "bus-off"

    def begin(self, plan: FramePlan) -> None:
        """Send a frame, from the bit that comes: idle, from its SOF; joining another's SOF, from its identifier."""
        self._plan, self._transmitter = plan, True

    def sample(self, seen: int) -> None:
        """See the level of the bus in the bit that ends."""
        self.joining = False
        self._level = self._life.send(seen)

    # -- its life --

    def _live(self, integrating: bool) -> Bits:
        begun = False
        if self.confinement.off:
            yield from self._bus_off()
        elif integrating:
            yield from self._integrate()
        while True:
            try:
                if not begun:
                    yield from self._wait()
                yield from self._frame()
                begun = yield from self._rest(None)
            except Detected as error:
                begun = yield from self._rest(error)

    def _wait(self) -> Bits:
        self.field, self._transmitter, self._position = "idle", False, 0
        while True:
            self.idle = True
            seen = yield None
            self.idle = False
            if seen == DOMINANT:
                self._position = 1
                return
            if self._plan is not None:
                self.field = "SOF"
                raise Detected(BIT_ERROR)

    def _rest(self, error: Detected | None) -> Generator[int | None, int, bool]:
        """Pass error and overload frames until the intermission is over; return whether a frame has begun in it."""
        while True:
            try:
                if error is not None:
                    yield from self._flag(error)
                    if not self.confinement.off:
                        yield from self._delimiter(error)
                    if self.confinement.off:
                        yield from self._bus_off()
                        return False
                return (yield from self._intermission())
            except Detected as again:
                error = again

    def _integrate(self) -> Bits:
        """Wait for eleven recessive bits, before which nobody new takes part."""
        self.field, run = "integrating", 0
        while run < RECOVERY_BITS:
            run = run + 1 if (yield RECESSIVE) == RECESSIVE else 0

    def _bus_off(self) -> Bits:
        self.field, self._plan = "bus-off", None
        while self.confinement.off:
            yield RECESSIVE

    # -- a frame --

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
        self.field = "ID"
        identifier = yield from self._read(11)
        self.field = "RTR"
        remote = yield from self._read(1)
        self.field = "IDE"
        if (yield from self._read(1)) == RECESSIVE:
            self.field = "ID"
            identifier = EXTENDED | identifier << 18 | (yield from self._read(18))
            self.field = "RTR"
            remote = yield from self._read(1)
        return identifier | REMOTE * remote

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
        else:
            yield DOMINANT if intact else RECESSIVE
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
        if not self.listen_only:
            self.confinement.received()
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

    # -- errors --

    def _flag(self, error: Detected) -> Bits:
        """Send an error flag, as the state before the error asks for, or an overload flag."""
        passive = (self.confinement.passive or self.listen_only) and error.code != OVERLOAD
        unacknowledged = passive and error.code == ACK_ERROR
        if not unacknowledged:
            self._count(error)
        self._say(BUS_ERROR, error.code, b"")
        self.fast, self._plan = False, None
        if not passive:
            yield from self._active_flag()
        elif (yield from self._passive_flag()) and unacknowledged:
            self._count(error)  # rule 3, exception 1: it does not count while no dominant bit is seen in the flag

    def _count(self, error: Detected) -> None:
        confinement = self.confinement
        if self.listen_only or not error.counts or error.code == OVERLOAD:
            return
        if error.in_flag:
            confinement.flag_disturbed(self._transmitter)
        elif self._transmitter:
            confinement.transmitter_error()
        else:
            confinement.receiver_error()

    def _active_flag(self) -> Bits:
        self.field = "active error flag"
        for _ in range(FLAG_BITS):
            if (yield DOMINANT) == RECESSIVE:
                raise Detected(BIT_ERROR, in_flag=True)

    def _passive_flag(self) -> Generator[int | None, int, bool]:
        """Wait for six equal bits; return whether a dominant one was seen."""
        self.field = "passive error flag"
        run, last, dominant = 0, -1, False
        while run < FLAG_BITS:
            seen = yield RECESSIVE
            dominant |= seen == DOMINANT
            run = run + 1 if seen == last else 1
            last = seen
        return dominant

    def _delimiter(self, error: Detected) -> Bits:
        """Wait for the end of everybody's flag, then for eight recessive bits in all."""
        self.field = "error delimiter"
        dominant = 0
        while (yield RECESSIVE) == DOMINANT:
            dominant += 1
            if self.listen_only:
                continue
            if dominant == 1 and not self._transmitter and error.code != OVERLOAD:
                self.confinement.first_after_flag()
            if dominant % 8 == 0:
                self.confinement.long_dominant(self._transmitter)
                if self.confinement.off:
                    return
        for remaining in reversed(range(DELIMITER_BITS - 1)):
            if (yield RECESSIVE) == DOMINANT:
                raise Detected(FORM_ERROR if remaining else OVERLOAD)

    def _intermission(self) -> Generator[int | None, int, bool]:
        """Pass the intermission, and what a passive transmitter waits longer; return whether a frame has begun."""
        self.field, self._plan, self._position = "intermission", None, 0
        self.suspended = self._transmitter and self.confinement.passive
        for remaining in reversed(range(INTERMISSION_BITS)):
            if (yield RECESSIVE) == DOMINANT:
                if remaining:
                    raise Detected(OVERLOAD)
                return self._join()
        for _ in range(SUSPEND_BITS if self.suspended else 0):
            self.field = "suspend transmission"
            if (yield RECESSIVE) == DOMINANT:
                return self._join()
        self.suspended = False
        return False

    def _join(self) -> bool:
        """Take a dominant bit for the SOF of somebody else's frame."""
        self.joining = not self.suspended
        self._transmitter, self._position = False, 1
        return True

    def _say(self, what: str, number: int, data: bytes) -> None:
        self.happened.append((what, number, data, self.field))
