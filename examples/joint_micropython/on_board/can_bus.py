"""The bus that by_frames.py plays on: SocketCAN, under MicroPython's unix port. For a board's controller write it anew.

`receive` waits for a frame and returns (identifier, data); `send` waits until one is queued.

Ref: Linux, Documentation/networking/can.rst.
"""

import errno
import socket
import struct
import time

import ffi

AF_CAN, CAN_RAW = 29, 1
SOL_CAN_RAW, CAN_RAW_FILTER = 101, 1
EXACTLY = 0x7FF | 1 << 31 | 1 << 30
"""CAN_SFF_MASK, CAN_EFF_FLAG, CAN_RTR_FLAG: data frames with 11 bits of identifier."""
FRAME = "<IB3x8s"
"""struct can_frame: identifier, length, data."""
RETRIES = 1000
"""Of 1 ms each, while the transmit queue is full."""


class Bus:
    """An interface, heard as far as these identifiers go."""

    def __init__(self, identifiers, interface="can0"):
        index = ffi.open(None).func("I", "if_nametoindex", "s")(interface)
        if index == 0:
            raise OSError(interface + " is not there: `ip -br link` lists the interfaces")
        self.socket = socket.socket(AF_CAN, socket.SOCK_RAW, CAN_RAW)
        filters = b"".join([struct.pack("<II", identifier, EXACTLY) for identifier in identifiers])
        self.socket.setsockopt(SOL_CAN_RAW, CAN_RAW_FILTER, filters)
        self.socket.bind(struct.pack("<HxxIQ", AF_CAN, index, 0))

    def receive(self):
        """Wait for a frame."""
        identifier, length, data = struct.unpack(FRAME, self.socket.recv(struct.calcsize(FRAME)))
        return identifier, data[:length]

    def send(self, identifier, data):
        """Queue a frame."""
        frame = struct.pack(FRAME, identifier, len(data), data)
        for _ in range(RETRIES):
            try:
                return self.socket.send(frame)
            except OSError as error:
                if error.errno not in (errno.ENOBUFS, errno.EAGAIN):
                    raise
            time.sleep_ms(1)
        raise OSError("the transmit queue stays full: does anybody acknowledge?")
