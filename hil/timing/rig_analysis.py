"""The analysis of a scenario's cycle beside what was measured of it, message by message, ready for JSON."""

from collections.abc import Mapping
from typing import Any

from dbc.compiler import describe_arm
from hil.constants import BY_TURNS, cycle_frames
from hil.i8086.straight_line import beyond_clocks
from hil.scenario import Scenario
from hil.scenario_joint import I8086
from hil.timing.analysis import seconds
from hil.timing.cycle import Bound
from hil.timing.response_time import Errors
from hil.timing.rig_cycle import STATUS, Spans, by_joints, cycle_of, lowest_bitrate, worst_spans
from hil.wire.bits import INTERMISSION_BITS, worst_case_bits
from hil.wire.controller import QUEUE_DEPTH
from hil.wire.rates import NS_PER_S, Rates
from hil.witness import sender_of

Seen = Mapping[str, Mapping[str, Any]]
"""Of messages by name: their response as a distribution [s]; spans_ns: shortest and longest frame, where known."""


class Analysis:
    """Bounds of one scenario. late: the frame that may not end with its cycle; worst, flexible: of all, as CAN FD."""

    def __init__(self, scenario: Scenario, data_bit_ns: int, errors: Errors | None = None) -> None:
        """data_bit_ns: of CAN FD, to be put beside."""
        self.scenario = scenario
        self.cycle = cycle_of(scenario)
        self.rates, self.fd_rates = Rates(scenario.bit_ns), Rates(scenario.bit_ns, data_bit_ns)
        self.errors = errors
        self._pace = scenario.clock.pace if scenario.clock.kind == "wall" else 1.0
        self.late, self.worst = self.cycle.judged(self.rates, errors=errors)
        _, self.flexible = self.cycle.judged(self.fd_rates, errors=errors)

    def to_json(self, seen: Seen, by_answer: bool = False) -> dict[str, Any]:
        """Return all bounds beside what was seen; by_answer: responses are counted from the frame that is answered."""
        data_bit_ns = self.fd_rates.data_bit_ns or self.rates.bit_ns
        return {
            "scenario": self.scenario.name,
            "clock": self.scenario.clock.kind,
            "pace": self.scenario.clock.pace,
            "bitrate": self.rates.bitrate,
            "data_bitrate": NS_PER_S / data_bit_ns,
            "period_s": self.scenario.clock.period_s,
            "utilisation": self._utilisation(),
            "meets_deadlines": self.worst is not None,
            "late": self.late,
            "refused": None,
            "with_faults": bool(self.scenario.wire.faults),
            "lowest_bitrate": lowest_bitrate(self.cycle, errors=self.errors),
            "by_joints": by_joints(self.cycle, data_bit_ns),
            "queues": self._queues(),
            "beyond_declared_s": self._beyond_declared_s(),
            "messages": self._rows(seen, by_answer),
            "chains": [],
        }

    def _utilisation(self) -> float:
        """Return the share of time that the longest frames of a cycle take."""
        spans = worst_spans(self.cycle.joints, self.rates).values()
        rest_ns = INTERMISSION_BITS * self.rates.bit_ns
        return sum(longest_ns + rest_ns for _, longest_ns in spans) / self.cycle.period_ns

    def _queues(self) -> list[dict[str, Any]]:
        """Return the most frames of each node that can wait at once: those of one cycle, since all end with it."""
        found = []
        for node in self.scenario.node_names:
            names = [name for name in cycle_frames(self.cycle.joints) if name == STATUS or sender_of(name) == node]
            held = None if self.worst is None else len(names) <= QUEUE_DEPTH
            found.append({"node": node, "frames_at_most": len(names), "depth": QUEUE_DEPTH, "holds": held})
        return found

    def _beyond_declared_s(self) -> dict[str, float]:
        """Return by how much a step of each joint of machine code may outlast its declared time, where it saturates."""
        scenario, joints = self.scenario, range(1, self.cycle.joints + 1)
        return {
            f"joint{n}": beyond_clocks(scenario, n) / scenario.of_joint(n, "clock_hz")
            for n in joints
            if scenario.cpu(n) == I8086
        }

    def _actual_spans(self, seen: Seen) -> Spans:
        """Return the shortest and longest frame of each slot that a run has shown."""
        spans = dict(worst_spans(self.cycle.joints, self.rates))
        for slot in spans:
            names = [name for name in seen if (name.startswith(BY_TURNS) if slot == STATUS else name == slot)]
            shown = [seen[name]["spans_ns"] for name in names if "spans_ns" in seen[name]]
            if shown:
                spans[slot] = min(shortest for shortest, _ in shown), max(longest for _, longest in shown)
        return spans

    def _rows(self, seen: Seen, by_answer: bool) -> list[dict[str, Any]]:
        """Return a row for each message of the run, by identifier; those of set-up and Stop have none."""
        _, actual = self.cycle.judged(self.rates, self._actual_spans(seen), self.errors) if seen else (None, None)
        lengths = cycle_frames(self.cycle.joints)
        rows = []
        for message in describe_arm(self.cycle.joints):
            slot = STATUS if message.name.startswith(BY_TURNS) else message.name
            if slot in lengths:
                bounds = [None if each is None else each[slot] for each in (self.worst, actual, self.flexible)]
                row = self._fixed(message.name, lengths[slot], slot, bounds[0])
                row |= self._responses(bounds, seen.get(message.name, {}), by_answer)
                rows.append({"name": message.name, "identifier": message.identifier} | row)
        return rows

    def _fixed(self, name: str, length: int, slot: str, bound: Bound | None) -> dict[str, Any]:
        """Return what does not hang on a run. deadline_s: what is left of the cycle when it is queued at the latest.

        Where one frame may be late nothing is known of the others: None. By the clock deadlines are dilated.
        """
        turns = 2 * (self.cycle.joints + 2) if name.startswith(BY_TURNS) else 1
        deadline_ns = None if bound is None else bound.deadline_ns(self.cycle.period_ns)
        meets = False if slot == self.late else None
        if bound is not None and deadline_ns is not None:
            meets = bound.response_ns <= deadline_ns
        return {
            "period_s": turns * self.scenario.clock.period_s,
            "queued_s": None if bound is None else [seconds(bound.earliest_ns), seconds(bound.latest_ns)],
            "deadline_s": None if deadline_ns is None else deadline_ns / 1e9 / self._pace,
            "meets_deadline": meets,
            "bits_worst": worst_case_bits(length) + INTERMISSION_BITS,
        }

    def _responses(self, bounds: list[Bound | None], seen: Mapping[str, Any], by_answer: bool) -> dict[str, Any]:
        """Return bounds with the longest frames, with those of the run, as CAN FD; what was measured beside."""
        waits = [None if bound is None else bound.response_ns for bound in bounds]
        if by_answer:
            waits = [None if bound is None else bound.response_ns + _computes_ns(bound) for bound in bounds]
        bound_s, actual_s, flexible_s = (seconds(each) for each in waits)
        response = seen.get("response")
        largest_s = None if response is None else response["max_s"]
        spans_ns = seen.get("spans_ns")
        return {
            "bits_max": None if spans_ns is None else spans_ns[1] // self.rates.bit_ns + INTERMISSION_BITS,
            "response_bound_s": bound_s,
            "response_bound_actual_s": None if spans_ns is None else actual_s,
            "response_bound_fd_s": flexible_s,
            "response_max_s": largest_s,
            "max_to_bound": _ratio(largest_s, bound_s),
            "max_to_bound_actual": None if spans_ns is None else _ratio(largest_s, actual_s),
            "response": response,
        }


def _computes_ns(bound: Bound) -> int:
    """Return how long its sender computes, where a frame answers another."""
    return 0 if bound.slot.after is None else bound.slot.delay_ns


def _ratio(measured_s: float | None, bound_s: float | None) -> float | None:
    return None if measured_s is None or bound_s is None else measured_s / bound_s
