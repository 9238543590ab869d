"""One node on a bus by the machine's clock: the loop around its drive, which no trouble with the bus can stop.

A frame that the bus does not take within half a period is lost, and counted: it would only keep the node from its own
deadlines. So is time in which nothing can be heard, an interface that is down for one: the node's own rules for silence
engage the brakes.
"""

import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from hil.can_port import CanPort
from hil.errors import NodeError
from hil.sync_drive import Frame
from hil.wall_drive import WallDrive

QUIET_S = 0.25
"""Wall time without a frame, before the run, after which a node says again what it said."""
PAUSE_S = 1e-3
"""Between two tries to hear a bus that refuses."""


class WallLoop:
    """A drive at its port. unsent: frames that the bus did not take; trouble: what it said, and how often."""

    def __init__(self, drive: WallDrive, port: CanPort, hardware_stamps: bool = False) -> None:
        self.drive = drive
        self.port = port
        self.unsent = 0
        self.trouble: Counter[str] = Counter()
        port.stamp(by_controller=hardware_stamps)

    def run(self, check: Callable[[], None]) -> None:
        """Play until the node's part is over; check: is called all the time, and may raise."""
        drive = self.drive
        self._send(drive.start())
        while not drive.finished:
            now_ns = time.monotonic_ns()
            wake_ns = drive.wake_ns
            due = wake_ns is not None and wake_ns <= now_ns
            if due and drive.owns_period:
                self._send(drive.tick(now_ns))
            wait_s = QUIET_S if wake_ns is None else min(QUIET_S, (wake_ns - now_ns) * 1e-9)
            heard = self._receive(0.0 if due else wait_s)
            check()
            if due and not drive.owns_period and heard is None:
                self._send(drive.tick(now_ns))
            if heard is not None and drive.is_of_another_run(heard[0]):
                continue
            if heard is not None:
                self._send(drive.hear_at(*heard, self.port.came_ns, time.monotonic_ns()))
            elif wait_s == QUIET_S:
                self._send(drive.idle())

    def report(self) -> dict[str, Any]:
        """Return what was counted of the bus and of its stamps."""
        stamps, by_controller = self.port.stamps, self.port.by_controller
        assert stamps is not None
        return {
            "unsent": self.unsent,
            "bus_trouble": dict(self.trouble),
            "clock_steps": stamps.steps,
            "foreign_stamps": stamps.foreign,
            **({} if by_controller is None else {"bare_stamps": by_controller.bare}),
            **self.drive.counters(),
        }

    def _receive(self, timeout_s: float) -> Frame | None:
        try:
            return self.port.receive(timeout_s)
        except NodeError as error:
            self._note(error)
            time.sleep(min(PAUSE_S, timeout_s))
            return None

    def _send(self, frames: list[Frame]) -> None:
        drive = self.drive
        if drive.in_run:
            self.port.give_up_s = 0.5e-9 * drive.period_ns * drive.stretch
        for frame in frames:
            try:
                self.port.send(*frame)
            except NodeError as error:
                self.unsent += 1
                self._note(error)

    def _note(self, error: NodeError) -> None:
        """Count what the bus refuses in the run; before it nothing is lost by giving up."""
        if not self.drive.in_run:
            raise error
        self.trouble[str(error)] += 1
