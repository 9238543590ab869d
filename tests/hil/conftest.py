"""What tests of the wire share: a bound on every test, and channels of their own."""

import shutil
import signal
import tempfile
from pathlib import Path

import pytest

BOUND_S = 30


@pytest.fixture
def bounded():
    """End a test that hangs: the alarm raises out of any blocking call what no code catches."""

    def overdue(_signal, _frame):
        pytest.fail(f"still waiting after {BOUND_S} s")

    before = signal.signal(signal.SIGALRM, overdue)
    signal.alarm(BOUND_S)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture
def runtime(monkeypatch):
    """A run-time directory of this test alone; short, since a Unix socket's path has 107 bytes at most."""
    path = Path(tempfile.mkdtemp(prefix="hil-", dir="/tmp"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(path))
    yield path
    shutil.rmtree(path)
