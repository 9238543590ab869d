"""Dead time of the amplifiers: from the instant when a current arrives to that from which it is applied.

Its jitter comes on top, uniform from 0 to its width. That of a cycle hangs on the seed, the joint and the cycle only:
a current that is lost, or heard twice, changes no other's. Units: integer ns; one entry a joint.
"""

from collections.abc import Sequence
from random import Random

NEVER_NS = -(1 << 62)


class DeadTime:
    """A dead time and the width of its jitter for every joint."""

    def __init__(self, dead_ns: Sequence[int], jitter_ns: Sequence[int], seed: int = 0) -> None:
        self._dead_ns = tuple(dead_ns)
        self._jitter_ns = tuple(jitter_ns)
        # a generator a joint: how many joints there are, or in which order they answer, is nothing to it
        self._random = [Random(f"{seed} {index}") for index in range(len(self._dead_ns))]
        self._drawn: list[list[float]] = [[] for _ in self._dead_ns]
        self._applied_ns = [NEVER_NS] * len(self._dead_ns)

    def applied_ns(self, index: int, cycle: int, arrives_ns: int) -> int:
        """Return from when on a cycle's current of joint index (from 0) is applied, never before the last one's."""
        share = self._share(index, max(cycle, 0)) if self._jitter_ns[index] else 0.0
        applied_ns = arrives_ns + self._dead_ns[index] + round(share * self._jitter_ns[index])
        self._applied_ns[index] = max(applied_ns, self._applied_ns[index])
        return self._applied_ns[index]

    def _share(self, index: int, cycle: int) -> float:
        drawn, random = self._drawn[index], self._random[index]
        while len(drawn) <= cycle:
            drawn.append(random.random())
        return drawn[cycle]
