"""Frames with the stamps of the kernel and of the controller, by our own SO_TIMESTAMPING: python-can asks for the one.

Ref: linux Documentation/networking/timestamping.rst; linux/net_tstamp.h; struct can_frame of linux/can.h.
"""

import select
import socket
import struct

from hil.stamps import ControllerStamps, SystemStamps

SO_TIMESTAMPNS, SO_TIMESTAMPING = 35, 37
"""Of asm-generic/socket.h; the control message of the latter has its number, too. Python has no names for them."""
RX_HARDWARE, RX_SOFTWARE, SOFTWARE, RAW_HARDWARE = 1 << 2, 1 << 3, 1 << 4, 1 << 6
STAMPS = struct.Struct("@6q")
"""Three timespecs: by the kernel, unused, by the controller; zero where there is none."""
FRAME = struct.Struct("=IB3x8s")
FRAME_BYTES = 72

Stamped = tuple[int, bytes, int]
"""(identifier with the flags of linux/can.h, data, when it came in ns of CLOCK_MONOTONIC)"""


class StampedSocket:
    """Reads a CAN socket that somebody else owns. bare: frames that the controller had not stamped."""

    def __init__(self, stream: socket.socket) -> None:
        self.bare = 0
        self.system = SystemStamps()
        self._controller = ControllerStamps()
        self._stream = stream
        stream.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 0)
        stream.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPING, RX_HARDWARE | RX_SOFTWARE | SOFTWARE | RAW_HARDWARE)

    def receive(self, timeout_s: float) -> Stamped | None:
        """Return the next frame of up to 8 bytes, or None after a while; OSError as the socket gives it."""
        if not select.select([self._stream], [], [], timeout_s)[0]:
            return None
        frame, ancillary, _, _ = self._stream.recvmsg(FRAME_BYTES, socket.CMSG_SPACE(STAMPS.size))
        identifier, length, data = FRAME.unpack_from(frame)
        return identifier, data[:length], self.came_ns([data for _, kind, data in ancillary if kind == SO_TIMESTAMPING])

    def came_ns(self, controls: list[bytes]) -> int:
        """Return when a frame came, from the control messages with its stamps."""
        kernel_ns = controller_ns = 0
        if controls:
            seconds, ns, _, _, own_seconds, own_ns = STAMPS.unpack_from(controls[0])
            kernel_ns, controller_ns = seconds * 10**9 + ns, own_seconds * 10**9 + own_ns
        heard_ns = self.system.heard(kernel_ns)
        if controller_ns == 0:
            self.bare += 1
            return heard_ns
        return self._controller.heard(controller_ns, heard_ns)
