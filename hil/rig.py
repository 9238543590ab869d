"""Running a scenario: its nodes in this process, or each in a process of its own; either way the same frames."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from dbc.codec import Codec
from dbc.compiler import load_arm
from hil.assemble import build_nodes
from hil.drive import Direct
from hil.errors import HilError, failed
from hil.frame_log import FrameLog
from hil.node import Node
from hil.scenario import Scenario
from hil.wire.faults import FaultScript
from hil.wire.kernel import Kernel

Progress = Callable[[float], None]
"""Called now and then with the share of the run that is done, 0 to 1."""

SLICES = 50


def no_progress(_share: float) -> None:
    """Show nothing."""


@dataclass
class Outcome:
    """What a run left: the frames, every node's report, and how long it took.

    reports: by node name. wire: what each node's controller counted. wall_s: of cycles 0 to the end. setup_wall_s: from
    the first call to cycle 0. clock: what was measured of the machine's time, by the clock `wall`.
    """

    scenario: Scenario
    mode: str
    log: FrameLog
    reports: dict[str, dict[str, Any]]
    bits_on_wire: int
    wall_s: float
    setup_wall_s: float
    wire: dict[str, dict[str, Any]]
    lost_frames: int = 0
    deterministic: bool = True
    clock: dict[str, Any] = field(default_factory=dict)


class Recorder:
    """Watches the bus: keeps the frames and stops the kernel at Stop."""

    def __init__(self, kernel: Kernel, codec: Codec) -> None:
        self.kernel = kernel
        self.log = FrameLog()
        self._stop = codec["Stop"]
        kernel.watchers.append(self._watch)

    def _watch(self, end_ns: int, identifier: int, data: bytes, sender: str) -> None:
        self.log.watch(end_ns, identifier, data, sender)
        if identifier == self._stop.identifier and self._stop.unpack(data) is not None:
            self.kernel.stopped = True


def make_kernel(scenario: Scenario) -> Kernel:
    """Return the bus of a scenario, its time at the beginning of the set-up."""
    start_ns = -scenario.clock.setup_cycles * scenario.period_ns
    kernel = Kernel(scenario.bit_ns, scenario.bus.fidelity == "functional", start_ns)
    FaultScript(scenario.wire.faults, scenario.wire.seed).install(kernel)
    return kernel


def wire_counts(kernel: Kernel, names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return what the controllers of these nodes have counted."""
    return {port.name: port.controller.counts() for port in kernel.ports if port.name in names}


Seat = Callable[[Kernel, Node], None]
"""Lets a node take part in a bus."""


def directly(kernel: Kernel, node: Node) -> None:
    """Let a node take part, called in this process."""
    kernel.join(Direct(node))


def run_inline(
    scenario: Scenario, progress: Progress = no_progress, compiled: bool = True, seat: Seat = directly
) -> Outcome:
    """Run all nodes and the wire in this process; compiled: see `build_plant`. seat: to see more of each node."""
    began = time.perf_counter()
    kernel = make_kernel(scenario)
    recorder = Recorder(kernel, load_arm())
    nodes = build_nodes(scenario, compiled)
    for node in nodes:
        seat(kernel, node)
    try:
        kernel.start()
        wall_s, setup_wall_s, bits = carry_through(scenario, kernel, kernel.run, progress, began)
    except HilError:
        raise
    except Exception as error:
        raise failed(kernel.waking, error) from error
    reports = {node.name: node.report() for node in nodes}
    wire = wire_counts(kernel, scenario.node_names)
    return Outcome(scenario, "inline", recorder.log, reports, bits, wall_s, setup_wall_s, wire)


def carry_through(
    scenario: Scenario, kernel: Kernel, run: Callable[[int], None], progress: Progress, began: float
) -> tuple[float, float, int]:
    """Run the set-up, then the cycles until Stop; return (wall s of the run, wall s before it, bits on the wire)."""
    run(-1)
    bits_before = kernel.bits_on_wire
    started = time.perf_counter()
    for part in range(1, SLICES + 1):
        run(scenario.duration_ns * part // SLICES)
        progress(part / SLICES)
    while not kernel.stopped and kernel.next_ns is not None:
        run(kernel.now_ns + scenario.period_ns)
    return time.perf_counter() - started, started - began, kernel.bits_on_wire - bits_before
