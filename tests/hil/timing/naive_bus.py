"""A bus in its barest form: of all that wait, the highest priority goes, and is not interrupted."""

from heapq import heappop, heappush

Queued = tuple[int, int, int]
"""(when its period begins, when it is queued, which message)"""


def longest_responses(releases: list[Queued], times: list[int]) -> list[int]:
    """Return the longest time from a period's beginning to a frame's end, of each message, in priority order."""
    longest = [0] * len(times)
    coming = sorted(releases, key=lambda each: each[1])
    waiting: list[tuple[int, int]] = []
    now = at = 0
    while at < len(coming) or waiting:
        if not waiting:
            now = max(now, coming[at][1])
        while at < len(coming) and coming[at][1] <= now:
            begins, _, message = coming[at]
            heappush(waiting, (message, begins))
            at += 1
        message, begins = heappop(waiting)
        now += times[message]
        longest[message] = max(longest[message], now - begins)
    return longest
