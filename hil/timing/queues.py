"""How many frames may wait in a node's transmit queue at once."""

from collections.abc import Sequence
from typing import Any

from hil.timing.response_time import Response


def queues(found: Sequence[Response], depth: int | None) -> list[dict[str, Any]]:
    """Return for every sender the most frames that its queue holds, the one on the wire included, beside its places.

    A frame is there from its queuing to its end, so those that are there at some instant were released no longer ago
    than their bound: of each message ceil(bound / period). A message of several senders counts with each of them.
    None: no bound, or nobody known to send it.
    """
    nodes = sorted({node for each in found for node in each.message.senders})
    waiting = {node: [each for each in found if node in each.message.senders] for node in nodes}
    rows = [_row(node, _most(each), depth) for node, each in waiting.items()]
    if all(each.message.senders for each in found):
        return rows
    return [*rows, _row(None, None, depth)]


def _most(waiting: Sequence[Response]) -> int | None:
    frames = 0
    for each in waiting:
        if each.bound_ns is None:
            return None
        frames += -(-each.bound_ns // each.message.period_ns)
    return frames


def _row(node: str | None, most: int | None, depth: int | None) -> dict[str, Any]:
    holds = None if depth is None or node is None else most is not None and most <= depth
    return {"node": node, "frames_at_most": most, "depth": depth, "holds": holds}
