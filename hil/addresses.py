"""Processes at the same addresses: no address-space randomisation for those that take turns on one CPU.

A CPU remembers by address where branches go. With the interpreter at another address in every process, each of them
runs into what the others left behind, and all their Python takes half as long again. Where the system has no such
switch, or a container forbids it, everything runs as before, only slower.

Ref: personality(2).
"""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

ADDR_NO_RANDOMIZE = 0x0040000
ASK = 0xFFFFFFFF


@contextmanager
def fixed_addresses() -> Iterator[None]:
    """Give the programs that are started meanwhile the addresses that others of their kind have."""
    before = _personality(ASK)
    if before < 0:
        yield
        return
    _personality(before | ADDR_NO_RANDOMIZE)
    try:
        yield
    finally:
        _personality(before)


def restart_at_fixed_addresses() -> None:
    """Start this program again where its nodes will be, unless it is there already or that cannot be had."""
    before = _personality(ASK)
    if before < 0 or before & ADDR_NO_RANDOMIZE:
        return
    _personality(before | ADDR_NO_RANDOMIZE)
    if _personality(ASK) & ADDR_NO_RANDOMIZE:
        os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])


def _personality(persona: int) -> int:
    """Set what the programs that this thread starts inherit; return what it was, -1 where there is no such thing."""
    if sys.platform != "linux":
        return -1
    return int(ctypes.CDLL(None).personality(ctypes.c_ulong(persona)))
