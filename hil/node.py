"""The seam between the bench and a participant: an object that is called and answers.

A node never waits, sleeps, sends or reads a clock; whoever drives it hands in the time and carries out the reaction.
Plain tuples, so that a node needs no import from here (the joint CPU also runs under MicroPython).
"""

from collections.abc import Collection
from typing import Any, Protocol

Send = tuple[int, int, bytes]
"""(delay in ns after the call, identifier, data): one frame to be queued."""

Reaction = tuple[int, int | None, list[Send]]
"""(computing time in ns, next timer in ns since cycle 0, frames to queue).

While it computes, the node handles nothing. The timer replaces the one before it; None cancels it.
"""

SILENT: Reaction = (0, None, [])


class Client(Protocol):
    """What a bus must know of whoever takes part."""

    @property
    def name(self) -> str:
        """How the bus knows it."""

    @property
    def wakes_on(self) -> Collection[int]:
        """Identifiers whose arrival wakes it (of a node: calls `on_frame`)."""

    @property
    def stores(self) -> Collection[int]:
        """Identifiers that are kept for its next wake-up (of a node: handed to `store`, silently)."""


class Node(Client, Protocol):
    """One participant. All times are integer nanoseconds since cycle 0.

    A timer must lie ahead when it is asked for; one that was asked for before may be kept.
    """

    @property
    def finished(self) -> bool:
        """Whether its part in the run is over."""

    def on_start(self, now_ns: int) -> Reaction:
        """Answer the start of time."""

    def on_frame(self, identifier: int, data: bytes, now_ns: int) -> Reaction:
        """Answer a frame of `wakes_on` that ended at or before now_ns."""

    def on_timer(self, now_ns: int) -> Reaction:
        """Answer the timer asked for."""

    def store(self, identifier: int, data: bytes, at_ns: int) -> None:
        """Keep a frame of `stores` that ended at at_ns."""

    def report(self) -> dict[str, Any]:
        """Return counters and recorded signals, after the run."""
