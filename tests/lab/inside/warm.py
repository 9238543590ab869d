"""Processes of Python that are there at once: forked from this one, which has everything imported already.

Five interpreters that start and import take a minute in the lab, and show nothing that one such start does not show:
test_witnesses.py runs `hil run` as a user does; the processes of all other runs are made here, as much apart as others,
with sockets of their own. Outside the lab nothing is forked.
"""

import multiprocessing
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from hil import can_node, cli
from hil.addresses import fixed_addresses
from hil.processes import Processes
from tests.lab.inside import kernel

FORK = multiprocessing.get_context("fork")
LIMIT_S = 120.0


class Warm:
    """A process that runs main with these words: subprocess.Popen as far as `Processes` and the tests use it."""

    def __init__(self, main: Callable[[], Any], words: Sequence[str], stdout: Path, stderr: Path) -> None:
        self.stdout, self.stderr = stdout, stderr
        self.process = FORK.Process(target=_be, args=(main, [sys.argv[0], *words], stdout, stderr))
        self.process.start()
        assert self.process.pid is not None
        self.pid = self.process.pid
        self.send_signal = self.process._popen._send_signal  # type: ignore[attr-defined]
        self.terminate, self.kill, self.poll = self.process.terminate, self.process.kill, lambda: self.returncode

    @property
    def returncode(self) -> int | None:
        """Its exit code, negative for a signal, None while it runs."""
        return self.process.exitcode

    def wait(self, timeout: float | None = None) -> int | None:
        """Wait for its end."""
        self.process.join(timeout)
        if self.returncode is None:
            raise subprocess.TimeoutExpired(str(self.process), timeout or 0.0)
        return self.returncode

    def communicate(self, timeout: float = LIMIT_S) -> tuple[str, str]:
        """Wait for its end; return what it said."""
        self.wait(timeout)
        return self.stdout.read_text(), self.stderr.read_text()


def _be(main: Callable[[], Any], words: list[str], stdout: Path, stderr: Path) -> None:
    """Be that process: a session of its own, nothing to read, output to files."""
    os.setsid()
    for path, descriptor in ((Path(os.devnull), 0), (stdout, 1), (stderr, 2)):
        os.dup2(os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o600), descriptor)
    sys.stdout, sys.stderr = os.fdopen(1, "w", closefd=False), os.fdopen(2, "w", closefd=False)
    sys.argv = words
    sys.exit(main())


def start_node(self: Processes, name: str) -> Warm:
    """Stand for Processes._start."""
    module, *words = self.command(name)
    assert module == can_node.__name__
    said = self.folder / f"{name}.err"
    return Warm(can_node.main, words, said, said)


def hil(folder: Path, *words: str) -> Any:
    """Run the command `hil` with these words; forked in the lab, where its output goes to files of this folder."""
    if not kernel.INSIDE:
        command = [sys.executable, "-m", "hil", *words]
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    return Warm(_command, words, folder / "out", folder / "err")


def _command() -> None:
    Processes._start = start_node  # type: ignore[assignment, method-assign]
    with fixed_addresses():  # what `hil run` would start itself anew for
        cli.main()
