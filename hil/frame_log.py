"""Every frame of a run, as it ended on the bus; compared by hash, exported as candump's log."""

import hashlib
import struct
from pathlib import Path

import can

from hil.wire.identifier import split_identifier
from hil.wire.messages import to_message

_RECORD = struct.Struct("<qIBB")
EXTENDED_FLAG, REMOTE_FLAG = 1, 2

LoggedFrame = tuple[int, int, bytes, str]
"""(end of frame in ns since cycle 0, identifier as in linux/can.h, data, sender)"""


class FrameLog:
    """The frames from cycle 0 on, in the order of the bus."""

    def __init__(self) -> None:
        self.frames: list[LoggedFrame] = []

    def watch(self, end_ns: int, identifier: int, data: bytes, sender: str) -> None:
        """Take a frame; what ended before cycle 0 belongs to the set-up."""
        if end_ns >= 0:
            self.frames.append((end_ns, identifier, data, sender))

    def sha256(self) -> str:
        """Return the hash over the canonical records: (end in ns, identifier, flags, DLC, data), little-endian."""
        digest = hashlib.sha256()
        for end_ns, identifier, data, _ in self.frames:
            number, extended, remote = split_identifier(identifier)
            flags = EXTENDED_FLAG * extended + REMOTE_FLAG * remote
            digest.update(_RECORD.pack(end_ns, number, flags, len(data)) + (b"" if remote else data))
        return digest.hexdigest()

    def write_candump(self, path: Path, channel: str) -> None:
        """Write candump's log format, microseconds, for can.player, canplayer and cantools decode."""
        with can.CanutilsLogWriter(str(path), channel=channel) as writer:
            for end_ns, identifier, data, _ in self.frames:
                writer.on_message_received(to_message(end_ns, identifier, data, channel))
