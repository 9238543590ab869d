"""What each node costs the host: the wall time of every wake-up of an inline run."""

import time

from hil.assemble import build_nodes
from hil.drive import Direct
from hil.node import Node, Reaction
from hil.rig import make_kernel
from hil.scenario import Scenario
from hil.wire.kernel import Arrival


class Timed(Direct):
    """A node that keeps the wall time of each of its wake-ups."""

    def __init__(self, node: Node) -> None:
        super().__init__(node)
        self.wakes_s: list[float] = []

    def wake(self, now_ns: int, stored: list[Arrival], cause: Arrival | None) -> Reaction:
        """Hand over, and look at the clock before and after."""
        began = time.perf_counter()
        reaction = super().wake(now_ns, stored, cause)
        self.wakes_s.append(time.perf_counter() - began)
        return reaction


def time_nodes(scenario: Scenario) -> tuple[dict[str, list[float]], float]:
    """Run a scenario inline; return (wall s of each wake-up, by node; wall s of the run), its set-up included.

    Stored frames are handed over within the wake-up behind them. The plant is compiled where Numba is there.
    """
    kernel = make_kernel(scenario)
    timed = [Timed(node) for node in build_nodes(scenario, compiled=True)]
    for participant in timed:
        kernel.join(participant)
    kernel.start()
    began = time.perf_counter()
    kernel.run(scenario.duration_ns - 1)
    return {each.name: each.wakes_s for each in timed}, time.perf_counter() - began
