"""Whom the bus waits for, said at 1, 2, 4, 8 ... seconds of wall time, and for how long it goes on waiting."""

from collections.abc import Callable
from math import inf

from hil.errors import NodeError
from hil.wire.participants import OnWait

FIRST_NOTICE_S = 1.0

Notice = Callable[[str], None]


def watchdog(notice: Notice, patience_s: float = inf) -> OnWait:
    """Return what a bus calls while it waits; it raises NodeError, naming the node, after patience_s."""
    said: dict[str, float] = {}

    def on_wait(name: str, waited_s: float) -> None:
        if waited_s > patience_s:
            raise NodeError(
                f"{name} has not answered for {waited_s:.0f} s (limit {patience_s:.0f} s): it hangs or is stopped; "
                "see what it does, or raise the limit with --patience"
            )
        if waited_s < FIRST_NOTICE_S:
            said[name] = 0.0
        elif waited_s >= max(FIRST_NOTICE_S, 2 * said.get(name, 0.0)):
            said[name] = waited_s
            notice(f"waiting for {name} for {waited_s:.0f} s")

    return on_wait
