"""MicroPython in a process of its own, with a board's folder: calls through a socket that is its stdin and stdout.

Whatever it does, the rig hears of it: a process that dies, hangs, or says what is no answer is a NodeError that names
the joint. It ends when the socket closes, so with whoever started it.
"""

import json
import os
import shutil
import signal
import socket
import struct
import subprocess
import tempfile
import weakref
from contextlib import suppress
from pathlib import Path

from examples.joint_micropython.board import lay_out
from examples.joint_micropython.on_board.by_calls import CALL, HEAD, NO_TIMER, REACTION, REPORT, SEND
from hil.errors import NodeError

PATIENCE_S = 10.0
"""Wall time for an answer; less than the bus has (hil/processes.py), which would know no reason."""
END_S = 2.0
"""Wall time for the process to end when its stdin has."""
NAMED_IN = "HIL_MICROPYTHON"
SAID = "stderr"


def program():
    """Return MicroPython's path; raise NodeError where it is not there."""
    name = os.environ.get(NAMED_IN) or "micropython"
    found = shutil.which(name)
    if found is None:
        raise NodeError(
            f"{name} is not there: install MicroPython's unix port (Debian 13 and later: apt-get install micropython), "
            f"or say where it is: {NAMED_IN}=/path/to/micropython"
        )
    return str(Path(found).absolute())


class Process:
    """One joint under MicroPython; twin: the same in Python, for its settings. `finished`: its part is over."""

    def __init__(self, path, twin):
        self.name = twin.name
        self.finished = False
        self.folder = tempfile.TemporaryDirectory(prefix="hil-board-")
        board = Path(self.folder.name)
        lay_out(board, twin)
        self.socket, theirs = socket.socketpair()
        self.socket.settimeout(PATIENCE_S)
        with theirs, (board / SAID).open("wb") as said:
            self.child = _start(self.name, path, board, theirs, said)
        self.end = weakref.finalize(self, _end, self.child, self.socket, self.folder)
        self.told = b""

    def tell(self, kind, now_ns, identifier=0, data=b""):
        """Make a call that has no answer; it goes with the next one that has."""
        self.told += struct.pack(CALL, kind, len(data), identifier, now_ns, data)

    def ask(self, kind, now_ns, identifier=0, data=b""):
        """Make a call; return the joint's reaction."""
        self.tell(kind, now_ns, identifier, data)
        busy_ns, timer_ns, body = self._answer(REACTION)
        sends = [(delay_ns, number, frame[:size]) for delay_ns, number, size, frame in struct.iter_unpack(SEND, body)]
        return busy_ns, None if timer_ns == NO_TIMER else timer_ns, sends

    def report(self):
        """Return the joint's report."""
        self.tell(REPORT, 0)
        _, _, body = self._answer(REPORT)
        return json.loads(body)

    def _answer(self, kind):
        """Send what was told; return computing time, timer and the bytes behind the head."""
        calls, self.told = self.told, b""
        try:
            self.socket.sendall(calls)
            head = self._read(struct.calcsize(HEAD), bytes([kind]))
            _, finished, size, busy_ns, timer_ns = struct.unpack(HEAD, head)
            body = self._read(size)
        except TimeoutError:
            raise NodeError(f"{self.name}: MicroPython has not answered for {PATIENCE_S:g} s") from None
        except OSError:
            raise self._died() from None
        self.finished = bool(finished)
        return busy_ns, timer_ns, body

    def _read(self, size, kind=b""):
        """Return so many bytes, of which the first is `kind`."""
        data = b""
        while len(data) < size:
            more = self.socket.recv(size - len(data))
            if not more:
                raise self._died()
            data += more
            if not data.startswith(kind):
                raise NodeError(
                    f"{self.name}: MicroPython said {data!r} where an answer was due: print to stderr there"
                )
        return data

    def _died(self):
        """Return the reason: how it ended, and the last line of its stderr."""
        with suppress(subprocess.TimeoutExpired):
            self.child.wait(END_S)
        code = self.child.poll()
        how = "it closed its stdout" if code is None else f"exit code {code}"
        lines = Path(self.folder.name, SAID).read_text(errors="replace").split("\n")
        last = next((line for line in reversed(lines) if line.strip()), "it said nothing")
        return NodeError(f"{self.name}: MicroPython has ended ({how}): {last}")


def _start(name, path, board, theirs, said):
    """Start the program; in a session of its own it gets no Ctrl-C, since its end is the rig's to say."""
    command = [path, "main.py", "rig"]
    try:
        return subprocess.Popen(command, cwd=board, stdin=theirs, stdout=theirs, stderr=said, start_new_session=True)
    except OSError as error:
        raise NodeError(f"{name}: {path} cannot be started: {error.strerror}") from None


def _end(child, end, folder):
    """Close the process's stdin and wait for its end."""
    end.close()
    try:
        child.wait(END_S)
    except subprocess.TimeoutExpired:
        os.killpg(child.pid, signal.SIGKILL)  # the session that it leads: whatever HIL_MICROPYTHON has started
        child.wait()
    folder.cleanup()
