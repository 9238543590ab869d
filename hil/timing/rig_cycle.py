"""The frames of a scenario's cycle as slots, and what follows: bounds, lowest bit rates, how many joints."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

from dbc.compiler import JOINTS, describe_arm
from firmware_py.dsp.cpu import ACCEL_REFS
from hil.constants import TAIL_BITS, cycle_frames
from hil.scenario import Scenario
from hil.scenario_parts import to_ns
from hil.timing import search
from hil.timing.cycle import Bound, Late, Slot, Timing, bounds
from hil.timing.response_time import Errors
from hil.wire.bits import INTERMISSION_BITS, shortest_bits, worst_case_bits
from hil.wire.fd_bits import fd_shortest_bits, fd_worst_case_bits
from hil.wire.rates import Rates

STATUS = "State"
"""The slot at a cycle's end, which all State and Heartbeat frames share by turns."""
Spans = Mapping[str, tuple[int, int]]
"""Shortest and longest time of each slot's frame in ns, without intermission."""


@dataclass(frozen=True)
class Cycle:
    """What sends when, at any bit rate. compute_ns: of each joint, at the most; dsp_ns: of the DSP; free: joints by own
    timers; sooner_ns: by which a joint may have computed before.

    The Current of such a joint may push a State beyond the cycle: both are then taken to come at any time.
    """

    period_ns: int
    compute_ns: tuple[int, ...]
    dsp_ns: int
    free: frozenset[int] = frozenset()
    sooner_ns: tuple[int, ...] = ()

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.compute_ns)

    def bounds(self, rates: Rates, spans: Spans | None = None, errors: Errors | None = None) -> dict[str, Bound]:
        """Return the bound of every slot; raise Late. spans: of the frames, by default the longest that there are."""
        timing = Timing(self.period_ns, rates.bit_ns, INTERMISSION_BITS * rates.bit_ns, errors)
        return bounds(self._slots(spans or worst_spans(self.joints, rates), TAIL_BITS * rates.bit_ns), timing)

    def judged(
        self, rates: Rates, spans: Spans | None = None, errors: Errors | None = None
    ) -> tuple[str | None, dict[str, Bound] | None]:
        """Return (None, bounds), or the frame that may not end with its cycle and no bounds."""
        try:
            return None, self.bounds(rates, spans, errors)
        except Late as late:
            return str(late), None

    def fits(self, rates: Rates, errors: Errors | None = None) -> bool:
        """Return whether all frames of a cycle end with it."""
        return self.judged(rates, errors=errors)[0] is None

    def _slots(self, spans: Spans, tail_ns: int) -> list[Slot]:
        identifiers = _identifiers()
        found = []
        for name, (shortest_ns, longest_ns) in spans.items():
            identifier = identifiers[f"{STATUS}_0" if name == STATUS else name]
            delay_ns, after = self._released(name, tail_ns)
            if self._is_free(name):
                found.append(Slot(name, identifier, shortest_ns, longest_ns, free=True))
            else:
                sooner_ns = self._sooner_ns(name)
                found.append(Slot(name, identifier, shortest_ns, longest_ns, delay_ns, after, sooner_ns=sooner_ns))
        return found

    def _sooner_ns(self, name: str) -> int:
        kind, _, number = name.partition("_")
        return self.sooner_ns[int(number) - 1] if kind == "Current" and self.sooner_ns else 0

    def _released(self, name: str, tail_ns: int) -> tuple[int, str | None]:
        """Return (delay, behind which frame) of a slot's release."""
        kind, _, number = name.partition("_")
        if kind == "Current":
            return self.compute_ns[int(number) - 1], f"Encoder_{number}"
        if name in ACCEL_REFS:
            return self.dsp_ns, f"Encoder_{self.joints}"
        return (self.period_ns - tail_ns if name == STATUS else 0), None

    def _is_free(self, name: str) -> bool:
        return bool(self.free) if name == STATUS else name in {f"Current_{n}" for n in self.free}


@lru_cache(maxsize=1)
def _identifiers() -> dict[str, int]:
    return {each.name: each.identifier for each in describe_arm(JOINTS)}


def cycle_of(scenario: Scenario) -> Cycle:
    """Return the cycle of a scenario."""
    joints = range(1, scenario.joints + 1)
    compute_ns = tuple(scenario.compute_ns(n) for n in joints)
    free = frozenset(n for n in joints if scenario.crystal_ppb(n) is not None)
    sooner_ns = tuple(most_ns - scenario.least_compute_ns(n) for n, most_ns in enumerate(compute_ns, 1))
    return Cycle(scenario.period_ns, compute_ns, to_ns(scenario.dsp.compute_s), free, sooner_ns)


def worst_spans(joints: int, rates: Rates) -> dict[str, tuple[int, int]]:
    """Return the shortest and longest time of each slot's frame, whatever it carries; CAN FD where the rates are."""
    return {name: _span_ns(length, rates) for name, length in cycle_frames(joints).items()}


def _span_ns(length: int, rates: Rates) -> tuple[int, int]:
    if rates.data_bit_ns is None:
        return shortest_bits(length) * rates.bit_ns, worst_case_bits(length) * rates.bit_ns
    spans = fd_shortest_bits(length), fd_worst_case_bits(length)
    shortest_ns, longest_ns = (nominal * rates.bit_ns + fast * rates.data_bit_ns for nominal, fast in spans)
    return shortest_ns, longest_ns


def lowest_bitrate(cycle: Cycle, data_bit_ns: int | None = None, errors: Errors | None = None) -> int | None:
    """Return the lowest bit rate at which a cycle fits, bits being whole ns; None if 1 Mbit/s is too slow.

    data_bit_ns: of the data phase of CAN FD, which stays as it is; a bit is at least as long.
    """
    return search.lowest_bitrate(
        lambda bit_ns: cycle.fits(Rates(bit_ns, data_bit_ns), errors), max(search.SHORTEST_BIT_NS, data_bit_ns or 0)
    )


def by_joints(cycle: Cycle, data_bit_ns: int) -> list[dict[str, Any]]:
    """Return the lowest bit rate for 1 to 6 joints, classic and CAN FD, each with the slowest of its CPUs."""
    slowest_ns = max(cycle.compute_ns)
    found = []
    for joints in range(1, JOINTS + 1):
        other = replace(cycle, compute_ns=(slowest_ns,) * joints, free=frozenset(), sooner_ns=())
        rates = {"lowest_bitrate": lowest_bitrate(other), "lowest_bitrate_fd": lowest_bitrate(other, data_bit_ns)}
        found.append({"joints": joints, **rates})
    return found
