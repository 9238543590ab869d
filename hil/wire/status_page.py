"""What a client must know of its controller at once: a page of memory that the bus writes and the client reads.

So `send` knows whether the transmit queue has room without asking, and `state` is there without waiting.
"""

import mmap
import os
import struct
import tempfile
from typing import NamedTuple

_LAYOUT = struct.Struct("<QQQBHH")


class Status(NamedTuple):
    """heard, changes: frames and changes that the client sent and the bus has read. queued: in the transmit queue.

    state: as in FMI-LS-BUS.
    """

    heard: int
    changes: int
    queued: int
    state: int
    tec: int
    rec: int


class StatusPage:
    """The page, mapped from a file without a name whose descriptor goes to the client."""

    def __init__(self, descriptor: int) -> None:
        self._memory = mmap.mmap(descriptor, mmap.PAGESIZE)

    def write(self, status: Status) -> None:
        """Publish."""
        _LAYOUT.pack_into(self._memory, 0, *status)

    def read(self) -> Status:
        """Return what was published last."""
        return Status(*_LAYOUT.unpack_from(self._memory, 0))

    def close(self) -> None:
        """Give the memory back."""
        self._memory.close()


def make_file() -> int:
    """Return the descriptor of a new page, for the caller to close."""
    if hasattr(os, "memfd_create"):
        descriptor = os.memfd_create("hil-status")
    else:
        with tempfile.TemporaryFile() as file:
            descriptor = os.dup(file.fileno())
    os.ftruncate(descriptor, mmap.PAGESIZE)
    return descriptor
