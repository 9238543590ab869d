"""An observer as the bus keeps it: it sees every frame, and nobody waits for it."""

from collections import deque
from collections.abc import Container
from contextlib import suppress

from hil.node import SILENT, Reaction
from hil.wire import protocol
from hil.wire.acceptance import NOTHING, Acceptance
from hil.wire.hello import Hello
from hil.wire.identifier import refusal
from hil.wire.participants import Client, acceptance
from hil.wire.port import IGNORES, WATCHES, Arrival, Port
from hil.wire.protocol import LONGEST_FROM_CLIENT, Closed, Connection, ProtocolError

OBSERVER_BYTES = 64 << 20
"""What is kept for an observer that reads too slowly; more is lost, and counted."""
FRAMES_A_CHUNK = 4096
EARLY_MESSAGES = 256
"""What an observer may ask for before time begins."""


class _Window(Port):
    """The port of an observer: it takes frames without ever being waited for."""

    participant: "Observer"

    def accepts(self, identifier: int) -> int:
        """Return what it does with frames of this identifier."""
        return WATCHES if identifier in self.participant.acceptance else IGNORES

    def watch(self, arrival: Arrival) -> None:
        """Keep a frame for the next flush."""
        self.participant.frames.append(arrival)

    def hear(self, arrival: Arrival) -> None:
        """Keep an error frame for the next flush."""
        self.participant.frames.append(arrival)


class Observer(Client):
    """A client that is never waited for: frames are kept for it, up to a bound, and sent as its socket takes them.

    early: what it asked for before time began. spoke: it has done something at an instant that the machine chose.
    """

    def __init__(self, hello: Hello, connection: Connection) -> None:
        super().__init__(hello, connection)
        self.acceptance: Container[int] = acceptance(hello.filters, hello.fd)
        self.frames: list[Arrival] = []
        self.early: list[tuple[int, bytes]] = []
        self.lost = 0
        self.spoke = False
        self._chunks: deque[tuple[bytes, int]] = deque()
        self._bytes = 0

    def _make_port(self) -> Port:
        return _Window(self)

    def set_filters(self, acceptance: Acceptance) -> None:
        """See these frames from now on."""
        self.acceptance = acceptance

    def start(self, _now_ns: int) -> Reaction:
        """Do nothing: nobody waits for it."""
        return SILENT

    def wake(self, _now_ns: int, _stored: list[Arrival], _cause: Arrival | None) -> Reaction:
        """Do nothing: nobody waits for it."""
        return SILENT

    def retire(self) -> None:
        """Take no more part than to see its frames out."""
        super().retire()
        self.acceptance = NOTHING

    # -- what it says --

    def obey(self, kind: int, body: bytes, started: bool) -> None:
        """Carry out what it asks for, or keep it until time begins; Closed if it leaves, ProtocolError for nonsense."""
        if kind == protocol.LEAVE:
            raise Closed
        if kind not in (protocol.SEND, protocol.CONFIGURE):
            raise ProtocolError(f"message {kind} from an observer")
        if not started:
            self.early.append((kind, body))
            if len(self.early) > EARLY_MESSAGES or sum(len(each) for _, each in self.early) > LONGEST_FROM_CLIENT:
                raise ProtocolError(f"more than {EARLY_MESSAGES} messages, or too long ones, before time begins")
        elif kind == protocol.SEND:
            self._queue(protocol.decode_frames(body))
        else:
            change = self.configure(body)
            self.spoke |= change.listen_only is not None
            if change.periodic is not None:
                self._take_part()

    def _take_part(self) -> None:
        """Be a node like others, having listened only because there was nothing to say."""
        self.spoke = True
        if self.port.controller.listen_only and not self.listen_only:
            self.port.medium.listen_only(self.port, False)

    def _queue(self, frames: list[Arrival]) -> None:
        """Queue its frames now, so that the status page knows them at once."""
        self._take_part()
        for _, identifier, data in frames:
            reason = refusal(identifier, len(data), self.port.medium.rates.fd)
            if reason:
                raise ProtocolError(reason)
            self.port.queue((identifier, data))
        self.heard += len(frames)

    # -- what it sees --

    def renew(self) -> None:
        """Begin anew in another session, with the same filters; periodic tasks end with the session.

        What it has not got yet it gets then: half of it may be on its way.
        """
        self.port = self._new_port()
        self.tasks.clear()
        self.lost = 0

    @property
    def unsent(self) -> int:
        """Frames that it has not got yet."""
        return len(self.frames) + sum(count for _, count in self._chunks)

    def flush(self) -> None:
        """Hand over what the socket takes without waiting; raise Closed if nobody is there."""
        if self.frames:
            self._pack()
        with suppress(BlockingIOError):
            while self._chunks:
                chunk, count = self._chunks[0]
                sent = self._send(chunk)
                self._bytes -= sent
                if sent == len(chunk):
                    self._chunks.popleft()
                else:
                    self._chunks[0] = chunk[sent:], count

    def _pack(self) -> None:
        """Make chunks of the frames: each frame a message, so that the socket is readable while there are more."""
        for first in range(0, len(self.frames), FRAMES_A_CHUNK):
            frames = self.frames[first : first + FRAMES_A_CHUNK]
            if self._bytes > OBSERVER_BYTES:
                self.lost += len(frames)
                continue
            chunk = b"".join([protocol.message(protocol.FRAMES, protocol.encode_frames([frame])) for frame in frames])
            self._chunks.append((chunk, len(frames)))
            self._bytes += len(chunk)
        self.frames.clear()

    def _send(self, chunk: bytes) -> int:
        try:
            return self.connection.stream.send(chunk)
        except BlockingIOError:
            raise
        except OSError as error:
            raise Closed from error
