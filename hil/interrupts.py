"""Ctrl-C and its kin only where a program waits: an exception in the middle of handing frames over would lose some.

Ref: pthread_sigmask(3). A signal that is held back is delivered as soon as it is let through.
"""

import signal
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager

SIGNALS = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}


def held_back() -> AbstractContextManager[None]:
    """Hold them back meanwhile, in this thread."""
    return _masked(signal.SIG_BLOCK)


def let_through() -> AbstractContextManager[None]:
    """Let them through meanwhile: what was held back is raised here."""
    return _masked(signal.SIG_UNBLOCK)


@contextmanager
def _masked(how: int) -> Iterator[None]:
    before = signal.pthread_sigmask(how, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
