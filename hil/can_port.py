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

from hil.bus_errors import BusErrors, see_doctor
from hil.errors import ChannelError, NodeError
from hil.stamped_socket import StampedSocket
from hil.stamps import SystemStamps
from hil.wire.identifier import ERROR, EXTENDED

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

    errors: what the controller told.
    came_ns: when the frame came that was received last, on CLOCK_MONOTONIC, for who asked for `stamp`.
    """

    def __init__(self, interface: str, channel: str, listens: Collection[int] | None, **options: Any) -> None:
        self.retries = 0
        self.strangers = 0
        self.errors = BusErrors(interface, channel)
        self._place = interface, str(channel)
        self.came_ns = 0
        self.give_up_s = GIVE_UP_S
        self.stamps: SystemStamps | None = None
        self.by_controller: StampedSocket | None = None
        self._where = f"{interface} {channel}"
        self._doctor = see_doctor(interface, channel)
        filters = None
        if listens is not None:
            filters = [{"can_id": each, "can_mask": STANDARD_MASK, "extended": False} for each in sorted(listens)]
        if interface == "hil":  # as everywhere: a controller tells of its own errors
            options = {"error_frames": "own"} | options
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
                self.errors.check(now_s)
                raise NodeError(
                    f"{self._where}: its transmit queue has been full for {self.give_up_s:g} s: nobody acknowledges, "
                    f"or the bus is off; {self._doctor}"
                ) from None
            time.sleep(pause_s)
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)

    def _check(self, error: can.CanError, identifier: int) -> None:
        """Raise NodeError for what waiting does not mend."""
        code = getattr(error, "error_code", None)
        full = "No buffer space" in str(error) or "Transmit buffer full" in str(error)
        if code not in (errno.ENOBUFS, errno.EAGAIN) and not full:
            raise self._trouble(f"cannot send {identifier:#x}", error) from None

    def receive(self, timeout_s: float) -> tuple[int, bytes] | None:
        """Return the next data frame with 11 bits, or None; others are counted.

        Raises NodeError if the interface is gone, or its controller tells that nothing works.
        """
        deadline = time.monotonic() + timeout_s
        while (frame := self._next(max(0.0, deadline - time.monotonic()))) is not None:
            identifier, data = frame
            if not identifier & ERROR:
                break
            self.errors.hear(identifier & ~ERROR, data, time.monotonic())
            if time.monotonic() > deadline:
                return None
        if frame is None:
            self.errors.check(time.monotonic())
            return None
        self.errors.works()
        if identifier > STANDARD_MASK:
            self.strangers += 1
            return None
        return identifier, data

    def _next(self, timeout_s: float) -> tuple[int, bytes] | None:
        """Return what came, None for nothing; its identifier has a flag above STANDARD_MASK if it is no data frame."""
        try:
            if self.by_controller is not None:
                return self._stamped(self.by_controller.receive(timeout_s))
            message = self.bus.recv(timeout_s)
        except (can.CanError, OSError) as error:
            raise self._trouble("cannot receive", error) from None
        if message is None:
            return None
        if self.stamps is not None:
            self.came_ns = self.stamps.heard(round(message.timestamp * 1e9))
        other = message.is_extended_id or message.is_remote_frame or message.is_fd
        flag = ERROR if message.is_error_frame else EXTENDED if other else 0
        return message.arbitration_id | flag, bytes(message.data)

    def _stamped(self, frame: tuple[int, bytes, int] | None) -> tuple[int, bytes] | None:
        if frame is None:
            return None
        identifier, data, self.came_ns = frame
        return identifier, data

    def _trouble(self, what: str, error: Exception) -> NodeError:
        cure = _cure(*self._place, error) or "is the interface up?"
        return NodeError(f"{self._where}: {what}: {error}: {cure}; {self._doctor}")

    def close(self) -> None:
        """Leave the bus."""
        self.bus.shutdown()


def _refusal(interface: str, channel: str, error: Exception) -> str:
    """Return why an interface could not be opened, and what to do."""
    cure = _cure(interface, channel, error) or "check --interface, --channel and --bus-kwargs"
    return f"interface {interface!r}, channel {channel!r}: {error}: {cure}"


def _cure(interface: str, channel: str, error: Exception) -> str:
    """Return what to do about an error of an interface, or nothing."""
    number = getattr(error, "errno", None) or getattr(error, "error_code", None)
    virtual = f"; `sudo ip link add dev {channel} type vcan` makes a virtual one" if channel.startswith("vcan") else ""
    up, down = f"`sudo ip link set {channel} up`", "it is down, or was taken down"
    forbidden = (
        "not permitted: a container or a security policy forbids it: run as a user, or where, it is allowed; "
        "a serial adapter belongs to a group: `ls -l` of its device says which"
    )
    cures = {
        errno.ENODEV: f"there is no such interface, or it was unplugged: `ip link` lists those there are{virtual}",
        errno.ENETDOWN: f"{down}: {up}",
        errno.ENXIO: f"{down}: {up}",
        errno.EPERM: forbidden,
        errno.EACCES: forbidden,
        errno.EAFNOSUPPORT: "this kernel has no SocketCAN: load can_raw, or take another interface",
    }
    if number in cures:
        return cures[number]
    if interface not in can.VALID_INTERFACES:
        return f"python-can has {', '.join(sorted(can.VALID_INTERFACES))}"
    if isinstance(error, can.CanInterfaceNotImplementedError | ImportError | NameError):  # each driver in its way
        return f"what drives it is not installed here: see {interface!r} in python-can's documentation"
    if isinstance(error, TypeError | ValueError):
        return f"check --bus-kwargs: they are keywords of python-can's interface {interface!r}"
    return ""
