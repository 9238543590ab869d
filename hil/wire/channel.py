"""Channels by name: where a bus listens, who may, and how to reach it.

A channel is a Unix stream socket in the user's run-time directory, for the user alone. Beside it lies a lock that the
bus holds as long as it lives: so a socket that a dead bus left behind is told from one in use, without asking anybody.
"""

import fcntl
import os
import re
import socket
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import IO

from hil.errors import ChannelError, NoBusError

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,40}")
BACKLOG = 64


def folder() -> Path:
    """Return the directory of the channels, made if need be, for this user alone."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    path = Path(runtime) / "hil" if runtime else Path(tempfile.gettempdir()) / f"hil-{os.getuid()}"
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        owner = path.stat().st_uid
        if owner == os.getuid():
            path.chmod(0o700)
    except OSError as error:
        raise ChannelError(f"channel directory {path}: {error.strerror}; set XDG_RUNTIME_DIR to one of yours") from None
    if owner != os.getuid():
        raise ChannelError(f"channel directory {path} belongs to user {owner}: set XDG_RUNTIME_DIR to one of yours")
    return path


def socket_path(channel: str) -> Path:
    """Return where a channel's socket is; raise ChannelError for a name that cannot be one."""
    if not NAME.fullmatch(channel):
        raise ChannelError(
            f"channel {channel!r}: a name has 1 to 41 letters, digits, '_', '.' or '-', the first a letter or digit"
        )
    return folder() / f"{channel}.sock"


def names() -> list[str]:
    """Return the channels on which a bus runs now: those that take a connection."""
    return sorted(path.stem for path in folder().glob("*.sock") if _listens(path))


def _listens(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            return False
    return True


def sweep() -> None:
    """Remove what buses left behind that died without a word: sockets whose lock nobody holds."""
    for path in folder().glob("*.lock"):
        with suppress(OSError), path.open("a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.with_suffix(".sock").unlink(missing_ok=True)
            path.unlink()


class Listener:
    """The listening end of a channel, held until `close`. Raises ChannelError if another bus holds it."""

    def __init__(self, channel: str) -> None:
        self.channel = channel
        self.path = socket_path(channel)
        sweep()
        self._lock = _take_lock(self.path.with_suffix(".lock"), channel)
        self.path.unlink(missing_ok=True)
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self.socket.bind(str(self.path))
            self.path.chmod(0o600)
        except OSError as error:
            self.close()
            raise ChannelError(
                f"channel {channel!r}: cannot listen at {self.path}: {error.strerror or error}"
            ) from None
        self.socket.listen(BACKLOG)
        self.socket.setblocking(False)

    def close(self) -> None:
        """Give the channel back; twice is once."""
        if self._lock.closed:
            return
        self.socket.close()
        self.path.unlink(missing_ok=True)
        self.path.with_suffix(".lock").unlink(missing_ok=True)
        self._lock.close()


def _take_lock(path: Path, channel: str) -> IO[str]:
    """Hold the lock file at this path; one that its holder removed meanwhile is not it."""
    while True:
        try:
            lock = path.open("a")
        except OSError as error:
            raise ChannelError(f"channel {channel!r}: cannot open {path}: {error.strerror}; remove it") from None
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if path.exists() and os.path.samestat(os.fstat(lock.fileno()), path.stat()):
                return lock
        except BlockingIOError:
            raise ChannelError(
                f"channel {channel!r} is in use by another bus: take another name, or end that bus"
            ) from None
        except FileNotFoundError:
            pass
        lock.close()


def connect(channel: str) -> socket.socket:
    """Return a connected socket; raise ChannelError if no bus is there."""
    path = socket_path(channel)
    client = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        client.connect(str(path))
    except (FileNotFoundError, ConnectionRefusedError):
        client.close()
        running = ", ".join(names()) or "none"
        raise NoBusError(
            f"channel {channel!r}: no bus is running there; start one with `hil bus {channel}` (running: {running})"
        ) from None
    except OSError as error:
        client.close()
        raise ChannelError(f"channel {channel!r}: cannot reach {path}: {error.strerror or error}") from None
    return client
