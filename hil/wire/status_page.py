"""What a client must know of its controller at once: a page of memory that the bus writes and the client reads.

So `send` knows whether the transmit queue has room without asking, and `state` is there without waiting.
"""

import fcntl
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
    """Return the descriptor of a new page, for the caller to close; a client cannot cut it off under the bus."""
    if not hasattr(os, "memfd_create"):
        with tempfile.TemporaryFile() as file:
            os.ftruncate(file.fileno(), mmap.PAGESIZE)
            return os.dup(file.fileno())
    descriptor = os.memfd_create("hil-status", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    os.ftruncate(descriptor, mmap.PAGESIZE)
    fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
    return descriptor
