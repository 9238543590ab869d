"""A node's place on any python-can interface: frames out without losing one, frames in, and who they are for.

SocketCAN refuses a frame when the device's queue is full (ENOBUFS), and select does not tell when it no longer is. So
sending waits and tries again, for a bounded time, and counts. Ref: linux Documentation/networking/can.rst; netdevice
txqueuelen (10 frames by default). A small send buffer makes the socket itself wait first, as far as it is its frames
that fill the queue.
"""

import errno
import socket
import time
from collections.abc import Collection
from contextlib import suppress
from typing import Any

import can

from hil.errors import ChannelError, NodeError
from hil.stamped_socket import StampedSocket
from hil.stamps import SystemStamps

FIRST_PAUSE_S = 100e-6
LONGEST_PAUSE_S = 10e-3
GIVE_UP_S = 5.0
"""Wall time after which a frame that nobody takes ends the run: nobody acknowledges, or the bus is off."""
STANDARD_MASK = 0x7FF
ROOM_BYTES = 16 << 20
"""What a socket may keep. A frame takes some 800 bytes, so the usual 208 KiB are 30 ms of a full bus."""
QUEUED_BYTES = 4096
"""What a socket may have under way: some five frames, fewer than the ten that a device's queue takes."""
SO_RCVBUFFORCE = 33
"""Of asm-generic/socket.h; Python has no name for it."""


class CanPort:
    """One socket on an interface. retries: times that the queue was full; strangers: frames that are none of ours.

    came_ns: when the frame came that was received last, on CLOCK_MONOTONIC, for who asked for `stamp`.
    """

    def __init__(self, interface: str, channel: str, listens: Collection[int] | None, **options: Any) -> None:
        self.retries = 0
        self.strangers = 0
        self.came_ns = 0
        self.give_up_s = GIVE_UP_S
        self.stamps: SystemStamps | None = None
        self.by_controller: StampedSocket | None = None
        self._where = f"{interface} {channel}"
        filters = None
        if listens is not None:
            filters = [{"can_id": each, "can_mask": STANDARD_MASK, "extended": False} for each in sorted(listens)]
        try:
            self.bus = can.Bus(interface=interface, channel=channel, can_filters=filters, **options)
        except Exception as error:  # every interface has its own way of saying so
            raise ChannelError(_refusal(interface, channel, error)) from None
        self._make_room()

    def _socket(self) -> socket.socket | None:
        """Return the socket, if this is SocketCAN."""
        stream = getattr(self.bus, "socket", None)
        known = isinstance(stream, socket.socket) and hasattr(socket, "AF_CAN") and stream.family == socket.AF_CAN
        return stream if known else None

    def stamp(self, by_controller: bool = False) -> None:
        """Have `came_ns` from now on: by the system's clock, or by the controller's where it has one."""
        stream = self._socket()
        if by_controller and stream is None:
            raise ChannelError(f"{self._where}: stamps by the controller are read from SocketCAN only: leave them out")
        if by_controller and stream is not None:
            self.by_controller = StampedSocket(stream)
        self.stamps = self.by_controller.system if self.by_controller else SystemStamps()

    def _make_room(self) -> None:
        """Let the kernel keep what comes while this process waits for a CPU (all of it if root asks)."""
        stream = self._socket()
        if stream is None:
            return
        with suppress(OSError):
            stream.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, QUEUED_BYTES)
        for option in (SO_RCVBUFFORCE, socket.SO_RCVBUF):
            with suppress(OSError):
                stream.setsockopt(socket.SOL_SOCKET, option, ROOM_BYTES)
                return

    def send(self, identifier: int, data: bytes) -> None:
        """Send a frame; raise NodeError where the bus takes none for give_up_s."""
        message = can.Message(arbitration_id=identifier, is_extended_id=False, data=data)
        pause_s, deadline = FIRST_PAUSE_S, 0.0
        while True:
            try:
                self.bus.send(message)
                return
            except can.CanError as error:
                self._check(error, identifier)
            self.retries += 1
            now_s = time.monotonic()
            deadline = deadline or now_s + self.give_up_s
            if now_s > deadline:
                raise NodeError(
                    f"{self._where}: its transmit queue has been full for {self.give_up_s:g} s: nobody acknowledges, "
                    "or the bus is off; look at `ip -details -statistics link show`"
                ) from None
            time.sleep(pause_s)
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)

    def _check(self, error: can.CanError, identifier: int) -> None:
        """Raise NodeError for what waiting does not mend."""
        code = getattr(error, "error_code", None)
        full = "No buffer space" in str(error) or "Transmit buffer full" in str(error)
        if code not in (errno.ENOBUFS, errno.EAGAIN) and not full:
            raise NodeError(f"{self._where}: cannot send {identifier:#x}: {error}: is the interface up?") from None

    def receive(self, timeout_s: float) -> tuple[int, bytes] | None:
        """Return the next data frame with 11 bits, or None; others are counted. NodeError if the interface is gone."""
        if self.by_controller is not None:
            return self._receive_stamped(self.by_controller, timeout_s)
        try:
            message = self.bus.recv(timeout_s)
        except (can.CanError, OSError) as error:
            raise NodeError(f"{self._where}: cannot receive: {error}: is the interface up?") from None
        if message is None:
            return None
        if self.stamps is not None:
            self.came_ns = self.stamps.heard(round(message.timestamp * 1e9))
        if message.is_extended_id or message.is_remote_frame or message.is_error_frame or message.is_fd:
            self.strangers += 1
            return None
        return message.arbitration_id, bytes(message.data)

    def _receive_stamped(self, stream: StampedSocket, timeout_s: float) -> tuple[int, bytes] | None:
        try:
            stamped = stream.receive(timeout_s)
        except OSError as error:
            raise NodeError(f"{self._where}: cannot receive: {error.strerror}: is the interface up?") from None
        if stamped is None:
            return None
        identifier, data, self.came_ns = stamped
        if identifier > STANDARD_MASK:  # extended, remote and error frames have flags up there
            self.strangers += 1
            return None
        return identifier, data

    def close(self) -> None:
        """Leave the bus."""
        self.bus.shutdown()


def _refusal(interface: str, channel: str, error: Exception) -> str:
    """Return why an interface could not be opened, and what to do."""
    number = getattr(error, "errno", None) or getattr(error, "error_code", None)
    cures = {
        errno.ENODEV: f"there is no such interface: see `ip link`; for a virtual one `ip link add {channel} type vcan`",
        errno.ENETDOWN: f"it is down: `ip link set {channel} up`",
        errno.EPERM: "not permitted: run as a user who may open CAN sockets",
        errno.EAFNOSUPPORT: "this kernel has no SocketCAN: load can_raw, or take another interface",
    }
    cure = cures.get(number or 0, "check --interface, --channel and --bus-kwargs")
    return f"interface {interface!r}, channel {channel!r}: {error}: {cure}"
