"""The wire as a python-can interface: `can.Bus(interface="hil", channel="arm")`.

An observer (the default) sees every frame and is never waited for. With `timed=True` the bus waits for this client:
time passes for it only inside `recv`, whose timeout is virtual; `send` takes no time. Timestamps are virtual seconds
since cycle 0.

Not implemented: CAN FD, own messages received, filters at the server, periodic sending in virtual time.
"""

import os
import select
import time
from collections import deque

import can
from can.typechecking import AutoDetectedConfig

from hil.errors import ChannelError
from hil.frame_log import to_message
from hil.node import Send
from hil.wire import channel as channels
from hil.wire import client, protocol
from hil.wire.identifier import EXTENDED, REMOTE
from hil.wire.kernel import Arrival


class HilBus(can.BusABC):
    """One client of a channel.

    channel: name of the bus; timed: whether time waits for this client; name: how the bus knows it; wait_s: wall time
    to wait for a bus that is not there yet. Raises can.CanInitializationError.
    """

    def __init__(
        self,
        channel: str = "arm",
        timed: bool = False,
        name: str | None = None,
        wait_s: float = 0.0,
        can_filters: can.typechecking.CanFilters | None = None,
        fd: bool = False,
        receive_own_messages: bool = False,
        **kwargs: object,
    ) -> None:
        if fd or receive_own_messages:
            self._is_shutdown = True
            option = "fd" if fd else "receive_own_messages"
            raise can.CanInitializationError(f"hil: {option}=True is not supported: leave it out")
        self.channel_info = f"hil channel {channel}"
        self._channel = channel
        self.timed = str(timed).lower() in ("true", "1", "yes")
        self._name = name or f"client-{os.getpid()}-{id(self):x}"
        self._connection = self._join(float(wait_s))
        self._received: deque[Arrival] = deque()
        self._sends: list[Send] = []
        self._now_ns = 0
        self._begun = False
        self._closed = False
        super().__init__(channel=channel, can_filters=can_filters, **kwargs)

    def _join(self, wait_s: float) -> protocol.Connection:
        deadline = time.monotonic() + wait_s
        while True:
            try:
                return client.join(self._channel, self._name, self.timed)[0]
            except ChannelError as error:
                if time.monotonic() >= deadline:
                    self._is_shutdown = True
                    raise can.CanInitializationError(str(error)) from None
            time.sleep(0.05)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:  # noqa: ARG002 (never blocks)
        """Queue a frame: a timed client's at the instant of its last `recv`, an observer's when the bus reads it."""
        if msg.is_fd or msg.is_error_frame:
            kind = "CAN FD frame" if msg.is_fd else "error frame"
            raise can.CanOperationError(f"{kind} on a classic bus: send a data or remote frame of 0 to 8 bytes")
        identifier = msg.arbitration_id | EXTENDED * msg.is_extended_id | REMOTE * msg.is_remote_frame
        data = bytes(msg.dlc) if msg.is_remote_frame else bytes(msg.data)
        if self.timed:
            self._sends.append((0, identifier, data))
            return
        self._say(protocol.SEND, protocol.encode_frames([(0, identifier, data)]))

    def _say(self, kind: int, body: bytes) -> None:
        try:
            self._connection.send(kind, body)
        except protocol.Closed:
            raise can.CanOperationError(f"{self.channel_info}: the bus has ended") from None

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame that the filters let pass; None when the timeout is over, virtual if timed."""
        if not self.timed:
            return super().recv(timeout)
        self._begin()
        deadline_ns = None if timeout is None else self._now_ns + round(timeout * 1e9)
        while True:
            while self._received:
                message = to_message(*self._received.popleft(), self._channel)
                if self._matches_filters(message):
                    return message
            if deadline_ns is not None and deadline_ns <= self._now_ns:
                return None
            self._pass_time(deadline_ns)

    def _begin(self) -> None:
        """Time begins with the first call that waits."""
        if not self._begun:
            self._now_ns = self._await(protocol.START)

    def _pass_time(self, until_ns: int | None) -> None:
        """Yield until a frame comes, or until this virtual instant."""
        self._say(protocol.YIELD, protocol.encode_yield((0, until_ns, self._sends)))
        self._sends = []
        self._now_ns = self._await(protocol.GRANT)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._received:
            self._listen(timeout)
        if not self._received:
            return None, False
        return to_message(*self._received.popleft(), self._channel), False

    def _await(self, wanted: int) -> int:
        try:
            kind, body = self._connection.receive()
        except (protocol.Closed, protocol.ProtocolError) as error:
            kind, body = protocol.END, str(error).encode() or b"it is gone"
        if kind != wanted:
            raise self._ended(kind, body)
        self._begun = True
        if kind == protocol.START:
            return protocol.decode_time(body)
        now_ns, stored, cause = protocol.decode_grant(body)
        self._received.extend(stored if cause is None else [*stored, cause])
        return now_ns

    def _listen(self, timeout: float | None) -> None:
        """Wait in wall time for a frame."""
        if not select.select([self._connection], [], [], timeout)[0]:
            return
        try:
            kind, body = self._connection.receive_one()
            if kind == protocol.FRAMES:
                self._received.extend(protocol.decode_frames(body))
                return
        except (protocol.Closed, protocol.ProtocolError) as error:
            kind, body = protocol.END, str(error).encode() or b"it is gone"
        raise self._ended(kind, body)

    def _ended(self, kind: int, body: bytes) -> can.CanOperationError:
        if kind == protocol.END:
            return can.CanOperationError(f"{self.channel_info}: the bus has ended: {body.decode(errors='replace')}")
        return can.CanOperationError(f"{self.channel_info}: unexpected message {kind} of the bus")

    def fileno(self) -> int:
        """Return the socket's descriptor."""
        return self._connection.fileno()

    def shutdown(self) -> None:
        """Leave the bus; twice is once."""
        super().shutdown()
        if self._closed:
            return
        self._closed = True
        try:
            if self.timed:
                self._connection.send(protocol.LEAVE, protocol.encode_yield((0, None, self._sends)))
            else:
                self._connection.send(protocol.LEAVE, b"")
        except protocol.Closed:
            pass
        self._connection.close()

    @staticmethod
    def _detect_available_configs() -> list[AutoDetectedConfig]:
        return [{"interface": "hil", "channel": name} for name in channels.names()]
