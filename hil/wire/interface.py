"""The wire as a python-can interface: `can.Bus(interface="hil", channel="arm")`.

An observer (the default) sees every frame and is never waited for. With `timed=True` the bus waits for this client:
time passes for it only inside `recv`, whose timeout is virtual; `send` takes no time. Timestamps are virtual seconds
since cycle 0.

Not implemented: CAN FD, filters at the server, periodic sending in virtual time.
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
from hil.wire.kernel import EXTENDED, REMOTE, Arrival


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
        **kwargs: object,
    ) -> None:
        self.channel_info = f"hil channel {channel}"
        self._channel = channel
        self.timed = str(timed).lower() in ("true", "1", "yes")
        self._name = name or f"client-{os.getpid()}-{id(self):x}"
        self._connection = self._join(float(wait_s))
        self._received: deque[Arrival] = deque()
        self._sends: list[Send] = []
        self._now_ns: int | None = None
        self._may_yield = False
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

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._received:
            if self.timed:
                self._pass_time(timeout)
            else:
                self._listen(timeout)
        if not self._received:
            return None, False
        return to_message(*self._received.popleft(), self._channel), False

    def _pass_time(self, timeout: float | None) -> None:
        """Yield until a frame or the virtual timeout; time begins with the first call."""
        if self._now_ns is None:
            self._now_ns = self._await(protocol.START)
        if timeout is not None and timeout <= 0.0 and not self._sends:
            return
        timer_ns = None if timeout is None else self._now_ns + max(1, round(timeout * 1e9))
        self._say(protocol.YIELD, protocol.encode_yield((0, timer_ns, self._sends)))
        self._sends = []
        self._await(protocol.GRANT)

    def _await(self, wanted: int) -> int:
        try:
            kind, body = self._connection.receive()
        except protocol.Closed:
            kind, body = protocol.END, b"it is gone"
        if kind == protocol.END:
            raise can.CanOperationError(f"{self.channel_info}: the bus has ended: {body.decode(errors='replace')}")
        if kind != wanted:
            raise can.CanOperationError(f"{self.channel_info}: unexpected message {kind} of the bus")
        self._may_yield = True
        if kind == protocol.START:
            return protocol.decode_time(body)
        self._now_ns, stored, cause = protocol.decode_grant(body)
        self._received.extend(stored)
        if cause is not None:
            self._received.append(cause)
        return self._now_ns

    def _listen(self, timeout: float | None) -> None:
        """Wait in wall time for frames."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while not self._received:
            message = self._connection.next_message()
            if message is None:
                left = None if deadline is None else max(0.0, deadline - time.monotonic())
                if not select.select([self._connection], [], [], left)[0]:
                    return
                self._fill()
                continue
            kind, body = message
            if kind == protocol.END:
                raise can.CanOperationError(f"{self.channel_info}: the bus has ended: {body.decode(errors='replace')}")
            self._received.extend(protocol.decode_frames(body))

    def _fill(self) -> None:
        try:
            self._connection.fill()
        except protocol.Closed:
            raise can.CanOperationError(f"{self.channel_info}: the bus has ended: it is gone") from None

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
            if self.timed and self._may_yield:
                self._connection.send(protocol.LEAVE, protocol.encode_yield((0, None, self._sends)))
            elif not self.timed:
                self._connection.send(protocol.LEAVE, b"")
        except protocol.Closed:
            pass
        self._connection.close()

    @staticmethod
    def _detect_available_configs() -> list[AutoDetectedConfig]:
        return [{"interface": "hil", "channel": name} for name in channels.names()]
