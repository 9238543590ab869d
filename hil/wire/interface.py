"""The wire as a python-can interface: `can.Bus(interface="hil", channel="arm")`.

An observer (the default) sees every frame and is never waited for. With `timed=True` the bus waits for this client:
time passes for it only inside `recv`, whose timeout is virtual; `send` takes no time. Timestamps are virtual seconds
since cycle 0.
"""

import errno
import os
import select
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from itertools import count
from typing import Any

import can
from can.broadcastmanager import CyclicSendTaskABC
from can.typechecking import AutoDetectedConfig, CanFilters

from hil.errors import ChannelError, NoBusError
from hil.node import Send
from hil.wire import channel as channels
from hil.wire import client, protocol
from hil.wire.confinement import BUS_OFF, ERROR_PASSIVE
from hil.wire.cyclic import BusTask
from hil.wire.messages import to_frame, to_message
from hil.wire.port import Arrival
from hil.wire.rates import bit_time_ns, of_timing
from hil.wire.status_page import Status

_numbers = count(1)

POLL_S = 0.001
"""Wall time between two looks for room in a full transmit queue."""


class HilBus(can.BusABC):
    """One client of a channel.

    channel: name of the bus. timed: whether time waits for this client. name: how the bus knows it. wait_s: wall time
    to wait for a bus that is not there yet. bitrate, data_bitrate, timing: what the bus must run at (None: whatever).
    queue_depth, fifo (as SocketCAN; else by priority), one_shot, discard_on_loss: of the controller's transmit queue.
    listen_only: it drives no bit. error_frames: "all" (of every node; an observer's default), "own" (a timed client's),
    "none".
    Unknown arguments are accepted. Raises can.CanInitializationError.
    """

    def __init__(
        self,
        channel: str = "arm",
        timed: bool = False,
        name: str | None = None,
        wait_s: float = 0.0,
        can_filters: CanFilters | None = None,
        fd: bool = False,
        receive_own_messages: bool = False,
        listen_only: bool = False,
        error_frames: str | None = None,
        bitrate: int | None = None,
        data_bitrate: int | None = None,
        timing: can.BitTiming | can.BitTimingFd | None = None,
        queue_depth: int = 10,
        fifo: bool = True,
        one_shot: bool = False,
        discard_on_loss: bool = False,
        **kwargs: object,
    ) -> None:
        self._is_shutdown = True  # until it has joined: shutdown() has nothing to do
        self.channel_info = f"hil channel {channel}"
        self._channel = str(channel)
        self.timed = _truth(timed)
        self._fd = _truth(fd) or isinstance(timing, can.BitTimingFd)
        self._name = name or f"client-{os.getpid()}-{next(_numbers)}"
        self._depth = int(queue_depth)
        options = {
            "filters": _plain(can_filters),
            "fd": self._fd,
            "own": _truth(receive_own_messages),
            "listen_only": _truth(listen_only),
            "errors": error_frames or ("own" if self.timed else "all"),
            "depth": self._depth,
            "fifo": _truth(fifo),
            "one_shot": _truth(one_shot),
            "discards": _truth(discard_on_loss),
        }
        options |= _bit_times(bitrate, data_bitrate if self._fd else None, timing)
        self._listen_only = bool(options["listen_only"])
        self._told_filters = options["filters"]
        self._connection, welcome = self._join(float(wait_s), options)
        self._page = welcome["page"]
        self._received: deque[Arrival] = deque()
        self._sends: list[Send] = []
        self._sent = self._changes = 0
        self._flush = self._sent_at_flush = 0
        self._now_ns = 0
        self._begun = False
        self._lock = threading.Lock()
        self._is_shutdown = False
        self._can_protocol = can.CanProtocol.CAN_FD if self._fd else can.CanProtocol.CAN_20
        super().__init__(channel=channel, can_filters=can_filters, **kwargs)

    def _join(self, wait_s: float, options: dict[str, Any]) -> tuple[protocol.Connection, dict[str, Any]]:
        deadline = time.monotonic() + wait_s
        while True:
            try:
                return client.join(self._channel, self._name, self.timed, page=True, **options)
            except ChannelError as error:
                if not isinstance(error, NoBusError) or time.monotonic() >= deadline:
                    raise can.CanInitializationError(str(error)) from None
            time.sleep(0.05)

    # -- sending --

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue a frame: a timed client's at the instant of its last `recv`, an observer's when the bus reads it.

        timeout: wall seconds for which an observer waits for room in the transmit queue. Raises can.CanOperationError,
        with errno.ENOBUFS where the queue is full.
        """
        identifier, data = to_frame(msg, self._fd)
        if self._listen_only:
            raise can.CanOperationError(f"{self.channel_info}: listening only: set state = can.BusState.ACTIVE to send")
        deadline = time.monotonic() + (timeout or 0.0)
        while not self._has_room():
            if self.timed or time.monotonic() >= deadline:
                raise can.CanOperationError(
                    f"{self.channel_info}: the transmit queue of {self._depth} frames is full", errno.ENOBUFS
                )
            time.sleep(POLL_S)
        with self._lock:
            self._sent += 1
            if self.timed:
                self._sends.append((0, identifier, data))
            else:
                self._say(protocol.SEND, protocol.encode_frames([(0, identifier, data)]))

    def _has_room(self) -> bool:
        status = self._status()
        if status.changes < self._flush:  # the bus has not read it yet
            return self._sent - self._sent_at_flush < self._depth
        return status.queued + self._sent - status.heard < self._depth

    def _status(self) -> Status:
        self._check_open()
        status: Status = self._page.read()
        return status

    def _check_open(self) -> None:
        if self._is_shutdown:
            raise can.CanOperationError(f"{self.channel_info}: it was shut down")

    def _say(self, kind: int, body: bytes) -> None:
        try:
            self._connection.send(kind, body)
        except protocol.Closed:
            raise can.CanOperationError(f"{self.channel_info}: the bus has ended") from None

    def _configure(self, change: dict[str, Any]) -> None:
        """Change the controller, from the instant at which the bus reads it."""
        with self._lock:
            self._changes += 1
            self._say(protocol.CONFIGURE, protocol.encode_json(change))

    def _send_periodic_internal(
        self,
        msgs: Sequence[can.Message] | can.Message,
        period: float,
        duration: float | None = None,
        autostart: bool = True,
        modifier_callback: Callable[[can.Message], None] | None = None,
    ) -> CyclicSendTaskABC:
        """Have the bus send in virtual time; with a modifier_callback a thread of this process sends in wall time."""
        if modifier_callback is not None:
            if self.timed:
                raise can.CanOperationError(
                    f"{self.channel_info}: modifier_callback needs wall time, a timed client has none: "
                    "use modify_data, or send after each recv"
                )
            return super()._send_periodic_internal(msgs, period, duration, autostart, modifier_callback)
        task = BusTask(self._configure, msgs, period, duration, self._fd)
        if autostart:
            task.start()
        return task

    def flush_tx_buffer(self) -> None:
        """Drop what the controller has not begun to send."""
        self._sent -= len(self._sends)
        self._sends.clear()
        self._configure({"flush": True})
        self._flush, self._sent_at_flush = self._changes, self._sent

    # -- receiving --

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return the next frame that the filters let pass; None when the timeout is over, virtual if timed."""
        if not self.timed:
            return super().recv(timeout)
        self._begin()
        deadline_ns = None if timeout is None else self._now_ns + round(timeout * 1e9)
        while not self._received:
            if deadline_ns is not None and deadline_ns <= self._now_ns:
                return None
            self._pass_time(deadline_ns)
        return to_message(*self._received.popleft(), self._channel)

    def _begin(self) -> None:
        """Time begins with the first call that waits."""
        if not self._begun:
            self._now_ns = self._await(protocol.START)

    def _pass_time(self, until_ns: int | None) -> None:
        """Yield until a frame comes, or until this virtual instant."""
        with self._lock:
            self._say(protocol.YIELD, protocol.encode_yield((0, until_ns, self._sends)))
            self._sends = []
        self._now_ns = self._await(protocol.GRANT)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._received:
            self._listen(timeout)
        if not self._received:
            return None, True
        return to_message(*self._received.popleft(), self._channel), True

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
        self._check_open()
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
        if kind in (protocol.END, protocol.REFUSED):
            return can.CanOperationError(f"{self.channel_info}: the bus has ended: {body.decode(errors='replace')}")
        return can.CanOperationError(f"{self.channel_info}: unexpected message {kind} of the bus")

    def _apply_filters(self, filters: CanFilters | None) -> None:
        """Have the bus filter, so that what is not wanted does not even wake this client."""
        if _plain(filters) == self._told_filters:
            return
        self._told_filters = _plain(filters)
        self._configure({"set_filters": True, "filters": _plain(filters)})

    # -- the controller --

    @property
    def state(self) -> can.BusState:
        """ACTIVE; PASSIVE while error-passive or listening only; ERROR while bus-off."""
        state = self._status().state
        if state == BUS_OFF:
            return can.BusState.ERROR
        return can.BusState.PASSIVE if state == ERROR_PASSIVE or self._listen_only else can.BusState.ACTIVE

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        if new_state is can.BusState.ERROR:
            raise ValueError("state = ERROR: a bus is not put into it, it gets there by errors")
        self._listen_only = new_state is can.BusState.PASSIVE
        self._configure({"listen_only": self._listen_only})

    def fileno(self) -> int:
        """Return the socket's descriptor; -1 for a timed client, whose time passes in `recv` alone."""
        return -1 if self.timed else self._connection.fileno()

    def shutdown(self) -> None:
        """Leave the bus; twice is once."""
        if self._is_shutdown:
            return
        try:
            super().shutdown()
            body = protocol.encode_yield((0, None, self._sends)) if self.timed else b""
            self._connection.send(protocol.LEAVE, body)
        except (protocol.Closed, can.CanOperationError):
            pass
        self._is_shutdown = True
        self._connection.close()
        self._page.close()

    @staticmethod
    def _detect_available_configs() -> list[AutoDetectedConfig]:
        return [{"interface": "hil", "channel": name} for name in channels.names()]


def _truth(value: object) -> bool:
    """Return what a configuration file or a command line means by a value."""
    return str(value).lower() in ("true", "1", "yes", "on")


def _plain(filters: CanFilters | None) -> list[dict[str, Any]] | None:
    return [dict(each) for each in filters] if filters else None


def _bit_times(
    bitrate: int | None, data_bitrate: int | None, timing: can.BitTiming | can.BitTimingFd | None
) -> dict[str, int | None]:
    """Return the bit times that are asked for; can.CanInitializationError where they are no whole ns."""
    try:
        if timing is not None:
            rates = of_timing(timing)
            return {"bit_ns": rates.bit_ns, "data_bit_ns": rates.data_bit_ns}
        wanted = {"bit_ns": bitrate, "data_bit_ns": data_bitrate}
        return {name: None if rate is None else bit_time_ns(int(rate)) for name, rate in wanted.items()}
    except ValueError as error:
        raise can.CanInitializationError(f"hil: {error}") from None
