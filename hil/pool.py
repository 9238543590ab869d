"""Processes for independent runs: dropped on an error, and none outlives the one that started them."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import Connection


@contextmanager
def pool(jobs: int | None) -> Iterator[Executor]:
    """Give processes, one a CPU if jobs is None; on the way out of an error they are dropped with what they compute."""
    theirs, ours = multiprocessing.Pipe(duplex=False)
    # spawned: a fork would take over the threads of a progress bar in the middle of what they do
    executor = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _begin, (theirs,))
    try:
        yield executor
    except BaseException:
        ours.close()
        raise
    finally:
        executor.shutdown(cancel_futures=True)
        ours.close()
        theirs.close()


def _begin(lifeline: Connection) -> None:
    """Leave signals to the parent, and end with it: it never writes, so a readable lifeline is its end."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    lifeline.poll(None)
    os._exit(1)
