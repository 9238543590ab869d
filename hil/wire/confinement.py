"""Error confinement of one CAN controller: its two counters, by the rules of ISO 11898-1.

Ref: ISO 11898-1:2015, 12.1.4 (fault confinement); Bosch, CAN Specification 2.0 (1991), part B, chapter 8, whose rule
numbers stand at the methods. The states are numbered as in FMI-LS-BUS 1.0 (CAN, Status operation).
"""

ERROR_ACTIVE, ERROR_PASSIVE, BUS_OFF = 1, 2, 3

WARNING_LIMIT = 96
PASSIVE_LIMIT = 128
OFF_LIMIT = 256
RECOVERED_REC = 119
"""What a successful reception leaves of a receive error counter above 127: a value from 119 to 127 (rule 8)."""
RECOVERY_SEQUENCES = 128
RECOVERY_BITS = 11
"""A controller that is bus-off comes back after 128 sequences of 11 recessive bits (rule 12)."""


class Confinement:
    """Transmit and receive error counter. `sequences`: of 11 recessive bits, seen since bus-off."""

    __slots__ = ("off", "rec", "sequences", "tec")

    def __init__(self) -> None:
        self.tec = 0
        self.rec = 0
        self.off = False
        self.sequences = 0

    @property
    def passive(self) -> bool:
        """Whether its error flags are recessive (rules 9, 11)."""
        return self.tec >= PASSIVE_LIMIT or self.rec >= PASSIVE_LIMIT

    @property
    def state(self) -> int:
        """Error-active, error-passive or bus-off."""
        return BUS_OFF if self.off else ERROR_PASSIVE if self.passive else ERROR_ACTIVE

    @property
    def warning(self) -> bool:
        """Whether the bus is heavily disturbed (a counter of 96 or more)."""
        return self.tec >= WARNING_LIMIT or self.rec >= WARNING_LIMIT

    @property
    def clean(self) -> bool:
        """Whether nothing is counted."""
        return not (self.tec or self.rec or self.off)

    def receiver_error(self) -> None:
        """Rule 1: a receiver detected an error."""
        self.rec += 1

    def transmitter_error(self) -> None:
        """Rule 3: a transmitter sent an error flag."""
        self._transmit(8)

    def first_after_flag(self) -> None:
        """Rule 2: a receiver sees a dominant bit as the first one behind its error flag."""
        self.rec += 8

    def flag_disturbed(self, transmitter: bool) -> None:
        """Rules 4 and 5: a bit error inside an active error flag or an overload flag."""
        self.long_dominant(transmitter)

    def long_dominant(self, transmitter: bool) -> None:
        """Rule 6: eight dominant bits behind a flag, and each further eight."""
        if transmitter:
            self._transmit(8)
        else:
            self.rec += 8

    def transmitted(self) -> None:
        """Rule 7: a frame was acknowledged and ended without an error."""
        if self.tec:
            self.tec -= 1

    def received(self) -> None:
        """Rule 8: a frame was received without an error up to the ACK slot, and acknowledged."""
        if self.rec:
            self.rec = RECOVERED_REC if self.rec >= PASSIVE_LIMIT else self.rec - 1

    def heard(self, recessive_sequences: int) -> bool:
        """Rule 12: count sequences of 11 recessive bits; return whether that ends bus-off."""
        self.sequences += recessive_sequences
        if not self.off or self.sequences < RECOVERY_SEQUENCES:
            return False
        self.reset()
        return True

    def reset(self) -> None:
        """Begin as after power-on."""
        self.tec = self.rec = self.sequences = 0
        self.off = False

    def _transmit(self, errors: int) -> None:
        """Count a transmitter's errors; above 255 it is bus-off (rule 10)."""
        self.tec += errors
        if self.tec >= OFF_LIMIT:
            self.off = True
            self.sequences = 0
