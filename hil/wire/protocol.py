"""What a bus and its clients say to each other: messages with a length prefix on a stream socket.

A message is its length (u32, of what follows), its kind (u8) and its body; numbers are little-endian. A timed client
makes one round trip a wake-up: the bus *grants* it an instant with the frames due, it *yields* with the frames to queue
and the timer it wants. Nothing is pickled; whatever does not decode raises ProtocolError.

| kind | from | body |
| --- | --- | --- |
| HELLO | client | JSON: what hello.py describes |
| WELCOME | bus | JSON: bit_ns (0: a frame takes no time), data_bit_ns, fidelity; and the file of a status page |
| REFUSED | bus | the reason, text |
| START | bus | now |
| GRANT | bus | now, whether a frame wakes, stored frames, the waking frame last |
| YIELD, LEAVE | client | computing time, timer, frames to queue; LEAVE says that it is the last |
| FRAMES | bus, to observers | frames that ended |
| SEND | observer | frames to queue now |
| CONFIGURE | client | JSON: what changes of its controller: filters, listen_only, flush, periodic, stop |
| CONTROL | controlling client | JSON: a command to the clock |
| STATUS | bus, to controlling clients | JSON: the answer |
| END | bus | the reason, text |
"""

import json
import select
import socket
import struct
from collections.abc import Callable
from typing import Any

from hil.node import Reaction
from hil.wire.identifier import ERROR, FD, FD_LENGTHS, LONGEST_CLASSIC, OWN, STANDARD_MASK, is_identifier
from hil.wire.port import Arrival

HELLO, WELCOME, REFUSED, START, GRANT, YIELD, LEAVE, FRAMES, SEND, END, CONFIGURE, CONTROL, STATUS = range(1, 14)

LONGEST_MESSAGE = 1 << 24
LONGEST_FROM_CLIENT = 1 << 20
"""A client that says more at once is shown out: enough for the longest list that hello.py allows, and what one client
can make the bus keep. What a bus has stored for one may be longer."""
FAR_NS = 1 << 62
"""Later than anything happens."""
NO_TIMER = -(1 << 63)
RECEIVE_BYTES = 1 << 14

_PREFIX = struct.Struct("<IB")
PREFIX_BYTES = _PREFIX.size
_TIME = struct.Struct("<q")
_GRANT = struct.Struct("<qBI")
_YIELD = struct.Struct("<qqI")
_COUNT = struct.Struct("<I")
_FRAME = struct.Struct("<qQB")
FRAME_HEADER = _FRAME.size


class ProtocolError(Exception):
    """Bytes that are no message of this protocol."""


class Closed(Exception):
    """The other end is gone."""


class Connection:
    """One stream of messages, none longer than `longest` bytes."""

    def __init__(self, stream: socket.socket, longest: int = LONGEST_MESSAGE) -> None:
        self.stream = stream
        self.longest = longest
        self._buffer = b""

    def fileno(self) -> int:
        """Return the socket's descriptor."""
        return self.stream.fileno()

    def send(self, kind: int, body: bytes) -> None:
        """Send one message; raise Closed if nobody is there."""
        try:
            self.stream.sendall(message(kind, body))
        except OSError as error:
            raise Closed from error

    def exchange(self, message: bytes, on_wait: Callable[[], None]) -> bytes:
        """Send one whole message and return all that has come, which may be several messages or a part of one.

        Returns nothing where the socket's own time limit runs out; on_wait is called where it does before all is sent.
        Of one that is gone, returns its last words; Closed behind those.
        """
        stream, rest = self.stream, message
        while rest:
            try:
                rest = rest[stream.send(rest) :]
            except BlockingIOError:
                on_wait()
            except OSError:
                break
        if self._buffer:
            data, self._buffer = self._buffer, b""
            return data
        try:
            data = stream.recv(RECEIVE_BYTES)
        except BlockingIOError:
            return b""
        except ConnectionResetError as error:
            raise Closed from error
        if not data:
            raise Closed
        return data

    def give_back(self, data: bytes) -> None:
        """Take back what `exchange` returned, to be received message by message."""
        self._buffer = data + self._buffer

    def receive(self) -> tuple[int, bytes]:
        """Return the next message, waiting for it; BlockingIOError where the socket's own time limit runs out."""
        while (message := self.receive_once()) is None:
            pass
        return message

    def receive_once(self) -> tuple[int, bytes] | None:
        """Return the next message, as `receive`, or None if it is not whole after one look at the socket."""
        if not self._buffer:
            self.fill()
            data = self._buffer
            if len(data) > _PREFIX.size:  # almost always one whole message: no search, no rest
                length, kind = _PREFIX.unpack_from(data)
                if length + _PREFIX.size - 1 == len(data) and length <= self.longest:
                    self._buffer = b""
                    return kind, data[_PREFIX.size :]
        elif (message := self.next_message()) is not None:
            return message
        else:
            self.fill()
        return self.next_message()

    def receive_one(self) -> tuple[int, bytes]:
        """Return the next message and read no byte of the one behind it, so that the socket tells if there is one."""
        length, kind = _PREFIX.unpack(self._exactly(_PREFIX.size))
        self._check_length(length)
        return kind, self._exactly(length - 1)

    def receive_with_file(self) -> tuple[int, bytes, int | None]:
        """Return the next message, as `receive_one`, and the descriptor of a file that came with it."""
        try:
            prefix, descriptors, _, _ = socket.recv_fds(self.stream, _PREFIX.size, 1)
        except ConnectionResetError as error:
            raise Closed from error
        if not prefix:
            raise Closed
        length, kind = _PREFIX.unpack(prefix + self._exactly(_PREFIX.size - len(prefix)))
        self._check_length(length)
        return kind, self._exactly(length - 1), descriptors[0] if descriptors else None

    def send_with_file(self, kind: int, body: bytes, descriptor: int) -> None:
        """Send one message and the descriptor of a file; raise Closed if nobody is there."""
        data = message(kind, body)
        try:
            sent = socket.send_fds(self.stream, [data], [descriptor])
            self.stream.sendall(data[sent:])
        except OSError as error:
            raise Closed from error

    def _check_length(self, length: int) -> None:
        if not 1 <= length <= self.longest:
            raise ProtocolError(f"message of {length} bytes: 1 to {self.longest} are allowed")

    def _exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:  # a signal may cut even MSG_WAITALL short
            try:
                part = self.stream.recv(count - len(data), socket.MSG_WAITALL)
            except ConnectionResetError as error:
                raise Closed from error
            if not part:
                raise Closed
            data += part
        return data

    def fill(self) -> None:
        """Read what there is; raise Closed at the end of the stream."""
        try:
            data = self.stream.recv(RECEIVE_BYTES)
        except ConnectionResetError as error:
            raise Closed from error
        if not data:
            raise Closed
        self._buffer = self._buffer + data if self._buffer else data

    def next_message(self) -> tuple[int, bytes] | None:
        """Return a message that is whole in the buffer."""
        buffer = self._buffer
        if len(buffer) < _PREFIX.size:
            return None
        length, kind = _PREFIX.unpack_from(buffer)
        if not 1 <= length <= self.longest:
            self._check_length(length)
        end = _PREFIX.size - 1 + length
        if len(buffer) < end:
            return None
        self._buffer = buffer[end:]
        return kind, buffer[_PREFIX.size : end]

    def is_closed(self) -> bool:
        """Return whether the other end is gone, nothing that it said being left; reads nothing."""
        if self._buffer:
            return False
        try:
            return not self.stream.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT)
        except BlockingIOError:
            return False
        except OSError:
            return True

    def is_hung_up(self) -> bool:
        """Return whether the other end is gone, whatever it said before."""
        look = select.poll()
        look.register(self.stream, 0)
        return any(event & select.POLLHUP for _, event in look.poll(0))

    def close(self) -> None:
        """Close the stream."""
        self.stream.close()


def message(kind: int, body: bytes) -> bytes:
    """Return one message as bytes."""
    return _PREFIX.pack(len(body) + 1, kind) + body


def encode_json(values: dict[str, Any]) -> bytes:
    """Return the body of a message in JSON."""
    return json.dumps(values).encode()


def decode_json(body: bytes) -> dict[str, Any]:
    """Return the values of a message in JSON."""
    try:
        values = json.loads(body)
    except (ValueError, RecursionError):
        raise ProtocolError("the body is no JSON") from None
    if not isinstance(values, dict):
        raise ProtocolError("the body is no JSON object")
    return values


def encode_time(now_ns: int) -> bytes:
    """Return the body of START."""
    return _TIME.pack(now_ns)


def decode_time(body: bytes) -> int:
    """Return the instant of START."""
    if len(body) != _TIME.size:
        raise ProtocolError("START without an instant")
    instant: int = _TIME.unpack(body)[0]
    return instant


def encode_grant(now_ns: int, stored: list[Arrival], cause: Arrival | None) -> bytes:
    """Return the body of GRANT."""
    if cause is None and not stored:
        return _GRANT.pack(now_ns, False, 0)
    frames = stored if cause is None else [*stored, cause]
    return _GRANT.pack(now_ns, cause is not None, len(frames)) + _encode_frames(frames)


def decode_grant(body: bytes) -> tuple[int, list[Arrival], Arrival | None]:
    """Return (now in ns, stored frames, waking frame or None for the timer)."""
    try:
        now_ns, by_frame, count = _GRANT.unpack_from(body)
    except struct.error:
        raise ProtocolError("GRANT cut short") from None
    frames = _decode_frames(body, _GRANT.size, count)
    if by_frame and not frames:
        raise ProtocolError("GRANT by a frame that it does not bring")
    return now_ns, frames, frames.pop() if by_frame else None


def encode_yield(reaction: Reaction) -> bytes:
    """Return the body of YIELD and LEAVE."""
    busy_ns, timer_ns, sends = reaction
    timer = NO_TIMER if timer_ns is None else timer_ns
    return _YIELD.pack(busy_ns, timer, len(sends)) + _encode_frames(sends)


def decode_yield(body: bytes) -> Reaction:
    """Return the reaction."""
    try:
        busy_ns, timer, count = _YIELD.unpack_from(body)
    except struct.error:
        raise ProtocolError("YIELD cut short") from None
    if timer > FAR_NS or not 0 <= busy_ns <= FAR_NS:
        raise ProtocolError(f"YIELD with {busy_ns} ns of computing and timer {timer} ns: beyond {FAR_NS} ns")
    return busy_ns, None if timer == NO_TIMER else timer, _decode_frames(body, _YIELD.size, count)


def encode_frames(frames: list[Arrival]) -> bytes:
    """Return the body of FRAMES and SEND."""
    return _COUNT.pack(len(frames)) + _encode_frames(frames)


def decode_frames(body: bytes) -> list[Arrival]:
    """Return the frames of FRAMES and SEND."""
    try:
        (count,) = _COUNT.unpack_from(body)
    except struct.error:
        raise ProtocolError("frames cut short") from None
    return _decode_frames(body, _COUNT.size, count)


def _encode_frames(frames: list[Arrival]) -> bytes:
    pack = _FRAME.pack
    if len(frames) == 1:
        time_ns, identifier, data = frames[0]
        return pack(time_ns, identifier, len(data)) + data
    return b"".join([pack(time_ns, identifier, len(data)) + data for time_ns, identifier, data in frames])


def _decode_frames(body: bytes, start: int, count: int) -> list[Arrival]:
    unpack = _FRAME.unpack_from
    frames = []
    try:
        for _ in range(count):
            time_ns, identifier, length = unpack(body, start)
            if length > LONGEST_CLASSIC or identifier > STANDARD_MASK:
                _check_unusual(identifier, length)
            end = start + FRAME_HEADER + length
            if time_ns > FAR_NS:
                raise ProtocolError(f"frame at {time_ns} ns: beyond {FAR_NS} ns")
            frames.append((time_ns, identifier, body[start + FRAME_HEADER : end]))
            start = end
    except struct.error:
        raise ProtocolError("frames cut short") from None
    if start != len(body):
        raise ProtocolError(f"{len(body) - start} bytes too many behind {count} frames")
    return frames


def _check_unusual(identifier: int, length: int) -> None:
    """Refuse what is no frame; what the bus hands out may be an error frame, or one's own."""
    lengths = FD_LENGTHS if identifier & FD else range(LONGEST_CLASSIC + 1)
    if length not in lengths or not (identifier & ERROR or is_identifier(identifier & ~OWN)):
        raise ProtocolError(f"frame of identifier {identifier:#x} with {length} bytes is none")
