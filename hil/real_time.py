"""What a process of ours asks of the machine for the wall clock, and what it does not get.

Soft real time, of the millisecond class: nothing here makes a promise, it only takes the usual causes of delay away.
"""

import ctypes
import gc
import os
from collections.abc import Callable

PRIORITY = 50
"""Of SCHED_FIFO: as the threads of interrupts have, below the kernel's own watchdogs."""
MCL_CURRENT, MCL_FUTURE = 1, 2
PR_SET_TIMERSLACK = 29
"""Ref: sys/mman.h, linux/prctl.h."""
CURE = "see `hil doctor`"


def prepare(turn: int) -> list[str]:
    """Ask for all that helps; return a line for each thing that was not permitted. turn: counts our processes."""
    asked: dict[str, Callable[[], None]] = {
        f"SCHED_FIFO at priority {PRIORITY}": _fifo,
        "memory locked (mlockall)": _lock_memory,
        "a CPU of its own (affinity)": lambda: _pin(turn),
        "timers without slack": _no_slack,
    }
    refused = []
    for what, ask in asked.items():
        try:
            ask()
        except (OSError, AttributeError) as error:  # AttributeError: this system has no such call
            refused.append(f"not permitted: {what}: {getattr(error, 'strerror', None) or error}: {CURE}")
    _freeze()
    return refused


def _fifo() -> None:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))


def _lock_memory() -> None:
    _call("mlockall", MCL_CURRENT | MCL_FUTURE)


def _no_slack() -> None:
    """Wake up when a timer is due, not up to 50 us later."""
    _call("prctl", PR_SET_TIMERSLACK, 1, 0, 0, 0)


def _call(name: str, *words: int) -> None:
    library = ctypes.CDLL(None, use_errno=True)
    if getattr(library, name)(*(ctypes.c_ulong(word) for word in words)):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _pin(turn: int) -> None:
    """Stay on one CPU, the next one for each of our processes, while there is more than one."""
    cpus = sorted(os.sched_getaffinity(0))
    if len(cpus) == 1:
        raise OSError(0, "there is only one")
    os.sched_setaffinity(0, {cpus[turn % len(cpus)]})


def _freeze() -> None:
    """Take what is there out of the garbage collector's sight: the run makes no cycles, so it has nothing to do."""
    gc.collect()
    gc.freeze()
