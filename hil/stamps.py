"""When a frame came, on CLOCK_MONOTONIC: from its stamp, which is of another clock.

The kernel stamps a frame by the system's clock, which is set now and then; a controller by its own, which runs a little
faster or slower. Each is carried over by an offset that is sampled again and again. An interface whose stamps are of no
known clock (the wire `hil` has virtual time) gives the time of hearing instead. All times are whole ns.

Ref: linux Documentation/networking/timestamping.rst.
"""

import time
from collections import deque
from collections.abc import Callable

Clock = Callable[[], int]

SAMPLE_NS = 1_000_000_000
"""How often the offset of the system's clock is sampled."""
TRIES = 5
STEP_NS = 1_000_000
"""A larger change in one second is no slewing (at most 500 ppm), but a step: somebody has set the clock."""
OTHER_CLOCK_NS = 10_000_000_000
"""A stamp further off than this, when its frame is taken, is not of the system's clock."""
PAIRS = 64
"""Of stamps by both clocks; at 1000 frames a second and 100 ppm the clocks drift apart by 6 us meanwhile."""


class SystemStamps:
    """Stamps of the system's clock. steps: times that it was set; foreign: stamps that were of no clock we know."""

    def __init__(self, monotonic: Clock = time.monotonic_ns, system: Clock = time.time_ns) -> None:
        self.steps = self.foreign = 0
        self._monotonic, self._system = monotonic, system
        self._offset_ns = self._sampled()
        self._sampled_ns = monotonic()

    def heard(self, stamp_ns: int) -> int:
        """Return when a frame came; now, if its stamp lies ahead or is of another clock."""
        now_ns = self._monotonic()
        if now_ns - self._sampled_ns >= SAMPLE_NS:
            self._sample(now_ns)
        came_ns = stamp_ns + self._offset_ns
        if abs(now_ns - came_ns) > STEP_NS:  # it waited for us, or the clock was set since the last sample
            self._sample(now_ns)
            came_ns = stamp_ns + self._offset_ns
        if abs(now_ns - came_ns) > OTHER_CLOCK_NS:
            self.foreign += 1
            return now_ns
        return min(came_ns, now_ns)

    def _sample(self, now_ns: int) -> None:
        offset_ns = self._sampled()
        self.steps += abs(offset_ns - self._offset_ns) > STEP_NS
        self._offset_ns, self._sampled_ns = offset_ns, now_ns

    def _sampled(self) -> int:
        """Return monotonic less system time, from the quickest of some readings: it was not interrupted."""
        readings = []
        for _ in range(TRIES):
            before_ns, system_ns, after_ns = self._monotonic(), self._system(), self._monotonic()
            readings.append((after_ns - before_ns, (before_ns + after_ns) // 2 - system_ns))
        return min(readings)[1]


class ControllerStamps:
    """Stamps of a controller's own clock, beside the kernel's of the same frames.

    The kernel's stamp is late by an interrupt, never early: the least difference of the last ones is the offset.
    """

    def __init__(self) -> None:
        self._offsets_ns: deque[int] = deque(maxlen=PAIRS)

    def heard(self, stamp_ns: int, kernel_ns: int) -> int:
        """Return when a frame came. kernel_ns: by the kernel's stamp, on CLOCK_MONOTONIC."""
        self._offsets_ns.append(kernel_ns - stamp_ns)
        return stamp_ns + min(self._offsets_ns)
