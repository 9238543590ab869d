"""One CAN controller, bit by bit: what it drives, what it makes of what it sees, and how it answers an error.

The wire plays its controllers this way only while a fault touches it; undisturbed frames are computed whole. Each
controller reads the bus by itself, the sender too: who loses arbitration goes on as a receiver without a seam.

The life of a controller is a generator: it yields the level that it drives for one bit (None: its plan's, or recessive)
and is sent the level that it saw. An error is an exception that ends the frame where it is detected.

Ref: ISO 11898-1:2015, 10.4 to 10.11 (frames, errors), 12.1.4 (confinement); Bosch, CAN Specification 2.0, part B.
"""

from collections.abc import Generator

from hil.wire.confinement import RECOVERY_BITS, Confinement
from hil.wire.frame_plan import DOMINANT, RECESSIVE, FramePlan
from hil.wire.frame_reader import ACK_ERROR, BIT_ERROR, BUS_ERROR, FORM_ERROR, OVERLOAD, Bits, Detected, FrameReader

FLAG_BITS = 6
DELIMITER_BITS = 8
INTERMISSION_BITS = 3
SUSPEND_BITS = 8


class BitLevel(FrameReader):
    """A controller on the bus. idle: it may begin a frame. joining: it may join one that has just begun.

    integrating: it has not heard the bus before. resting: an intermission begins; sent: behind a frame of its own.
    """

    def __init__(
        self,
        confinement: Confinement,
        listen_only: bool = False,
        integrating: bool = False,
        resting: bool = False,
        sent: bool = False,
    ) -> None:
        super().__init__(confinement, listen_only)
        self.idle = False
        self.joining = False
        self._transmitter = sent
        self._life = self._live(integrating, resting)
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

    @property
    def occupied(self) -> bool:
        """Whether it occupies the bus: by a frame, an error frame, an intermission."""
        return self.busy and not self.listen_only and self.field not in ("integrating", "suspend transmission")

    def begin(self, plan: FramePlan) -> None:
        """Send a frame, from the bit that comes: idle, from its SOF; joining another's SOF, from its identifier."""
        self._plan, self._transmitter = plan, True

    def sample(self, seen: int) -> None:
        """See the level of the bus in the bit that ends."""
        self.joining = False
        self._level = self._life.send(seen)

    # -- its life --

    def _live(self, integrating: bool, resting: bool) -> Bits:
        begun = False
        if self.confinement.off:
            yield from self._bus_off()
        elif integrating:
            yield from self._integrate()
        elif resting:
            begun = yield from self._rest(None)
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

    # -- errors --

    def _flag(self, error: Detected) -> Bits:
        """Send an error flag, as the state before the error asks for, or an overload flag."""
        passive = self.confinement.passive and error.code != OVERLOAD
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
            if (yield DOMINANT) == RECESSIVE and not self.listen_only:
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
