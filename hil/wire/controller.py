"""A CAN controller as the bus sees it between frames: its transmit queue, its error state, what it counts."""

from collections import Counter, deque

from hil.wire.confinement import Confinement

QUEUE_DEPTH = 10
"""Frames that a controller holds for sending; SocketCAN's default txqueuelen."""
RECEIVE_DEPTH = 64
"""Frames that wait for a node to take them, as in the receive FIFO of an SJA1000."""

QUEUE_FULL = "transmit queue full"
ONE_SHOT = "one-shot: disturbed"
ARBITRATION = "arbitration lost"
FLUSHED = "flushed"
LEFT = "sender left"
LISTEN_ONLY = "sent while listening only"
OVERRUN = "receive overrun"

Entry = tuple[int, int, int, int, int, bytes]
"""A frame that waits for the bus: (arbitration key, node order, queued at ns, sequence, identifier, data)."""


class Controller:
    """depth: of the transmit queue; fifo: it sends first-in-first-out, else by priority.

    one_shot: a disturbed frame is not sent again. discards: one that loses arbitration is not, either (FMI-LS-BUS:
    DISCARD_AND_NOTIFY, else BUFFER_AND_RETRANSMIT). listen_only: it drives no bit. lost: frames, by cause.
    unheard: nobody acknowledged its last frame. given_up: a frame on the wire that is not sent again.
    overrun, babbles, queue_delay_ns: faults of the script.
    """

    __slots__ = (
        "babbles",
        "confinement",
        "depth",
        "discards",
        "errors",
        "fifo",
        "given_up",
        "leaving",
        "listen_only",
        "lost",
        "off_since_ns",
        "one_shot",
        "overrun",
        "queue_delay_ns",
        "queued",
        "receive_depth",
        "received",
        "repeated",
        "sent",
        "suspended_until_ns",
        "told",
        "unheard",
        "waiting",
    )

    def __init__(self) -> None:
        self.depth = QUEUE_DEPTH
        self.fifo = False
        self.one_shot = False
        self.discards = False
        self.listen_only = False
        self.leaving = False
        self.receive_depth = RECEIVE_DEPTH
        self.queue_delay_ns = 0
        self.overrun = False
        self.babbles: tuple[int, bytes] | None = None
        self.confinement = Confinement()
        self.suspended_until_ns = -(1 << 63)
        self.off_since_ns = 0
        self.told = (1, False)
        self.unheard = False
        self.given_up: Entry | None = None
        self.queued = 0
        self.waiting: deque[Entry] = deque()
        self.sent = self.received = self.repeated = 0
        self.lost: Counter[str] = Counter()
        self.errors: Counter[str] = Counter()

    @property
    def acknowledges(self) -> bool:
        """Whether it would acknowledge somebody's frame."""
        return not self.listen_only and not self.leaving and not self.confinement.off

    @property
    def sends(self) -> bool:
        """Whether it may send what waits."""
        return not self.listen_only and not self.confinement.off

    @property
    def standing(self) -> tuple[int, bool]:
        """Error state, and whether a counter is at the warning limit; `told` is what everybody knows of it."""
        return self.confinement.state, self.confinement.warning

    @property
    def plain(self) -> bool:
        """Whether nothing about it needs care: no error counted, nothing configured beyond the usual."""
        return self.confinement.clean and not self.discards

    def counts(self) -> dict[str, object]:
        """Return what it counted, for summaries."""
        confinement = self.confinement
        return {
            "sent": self.sent,
            "received": self.received,
            "repeated": self.repeated,
            "lost": dict(self.lost),
            "errors": dict(self.errors),
            "tec": confinement.tec,
            "rec": confinement.rec,
            "state": ("error-active", "error-passive", "bus-off")[confinement.state - 1],
        }
