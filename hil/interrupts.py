"""Ctrl-C and its kin only where a program waits: an exception in the middle of handing frames over would lose some.

Ref: pthread_sigmask(3). A signal that is held back is delivered as soon as it is let through.
"""

import signal
from collections.abc import Iterator
from contextlib import contextmanager

SIGNALS = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}


@contextmanager
def held_back() -> Iterator[None]:
    """Hold them back meanwhile, in this thread."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def let_through() -> Iterator[None]:
    """Let them through meanwhile: what was held back is raised here."""
    before = signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
