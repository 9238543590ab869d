"""What a client must know of its controller at once: a page of memory that the bus writes and the client reads.

So `send` knows whether the transmit queue has room without asking, and `state` is there without waiting.
"""

import fcntl
import mmap
import os
import struct
import tempfile
from typing import NamedTuple

TRIES = 100_000
"""Some tenths of a second: a writer that is stopped in the middle must not hold a reader for ever."""
_TURN = struct.Struct("<Q")
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
    """The page, mapped from a file without a name whose descriptor goes to the client.

    A reader on another CPU must not see half of an update, for instance frames counted as heard and as queued, too: the
    number in front is odd while the page is written, and another one afterwards (a sequence lock).
    """

    def __init__(self, descriptor: int) -> None:
        self._memory = mmap.mmap(descriptor, mmap.PAGESIZE)
        self._turn = 0
        self._published: Status | None = None

    def write(self, status: Status) -> None:
        """Publish."""
        if status == self._published:
            return
        self._published = status
        memory, turn = self._memory, self._turn
        _TURN.pack_into(memory, 0, turn + 1)
        _LAYOUT.pack_into(memory, _TURN.size, *status)
        _TURN.pack_into(memory, 0, turn + 2)
        self._turn = turn + 2

    def read(self) -> Status:
        """Return what was published last; of a writer that died in the middle, what there is."""
        memory = self._memory
        for _ in range(TRIES):
            (before,) = _TURN.unpack_from(memory, 0)
            status = Status(*_LAYOUT.unpack_from(memory, _TURN.size))
            (after,) = _TURN.unpack_from(memory, 0)
            if before == after and not before & 1:
                break
        return status

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
