"""python-can's periodic tasks, carried out by the bus in virtual time."""

from collections.abc import Callable, Sequence
from itertools import count
from typing import Any

import can
from can.broadcastmanager import (
    LimitedDurationCyclicSendTaskABC,
    ModifiableCyclicTaskABC,
    RestartableCyclicTaskABC,
)

from hil.wire.messages import to_frame

Configure = Callable[[dict[str, Any]], None]
"""Called with a change of the controller (hello.py, Change)."""

_numbers = count(1)


class BusTask(LimitedDurationCyclicSendTaskABC, ModifiableCyclicTaskABC, RestartableCyclicTaskABC):
    """A task that the bus carries out: the first frame when it hears of it, then one every period."""

    def __init__(
        self,
        configure: Configure,
        messages: Sequence[can.Message] | can.Message,
        period: float,
        duration: float | None,
        fd: bool,
    ) -> None:
        super().__init__(messages, period, duration)
        self._configure = configure
        self._fd = fd
        self._task = next(_numbers)

    def start(self) -> None:
        """Send from now on."""
        duration_ns = None if self.duration is None else round(self.duration * 1e9)
        task = {"task": self._task, "period_ns": self.period_ns, "duration_ns": duration_ns, "frames": self._frames()}
        self._configure({"periodic": task})

    def stop(self) -> None:
        """Send no more."""
        self._configure({"stop": self._task})

    def modify_data(self, messages: Sequence[can.Message] | can.Message) -> None:
        """Send these contents from the next period on; identifier and number of messages stay."""
        super().modify_data(messages)
        self._configure({"modify": {"task": self._task, "frames": self._frames()}})

    def _frames(self) -> list[dict[str, Any]]:
        frames = [to_frame(message, self._fd) for message in self.messages]
        return [{"identifier": identifier, "data": data.hex()} for identifier, data in frames]
