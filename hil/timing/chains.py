"""Chains: from the sample to the current's action, and round by the DSP; part by part, with what was missed and why.

A chain is a row of parts, each with its length in every cycle; nan where it did not come to an end. A current acts when
its frame has ended and the drive's dead time is over.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.assemble import dead_time
from hil.constants import BUS, COMPUTING, DRIVE, HOST
from hil.exact_constants import reference_of
from hil.latency import distribution
from hil.scenario import Scenario
from hil.scenario_parts import to_ns
from hil.timing.analysis import seconds
from hil.timing.cycle import Bound
from hil.timing.measured import ENDS, QUEUED, STARTS, Array

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Part:
    """One step of a chain. lasts_ns: in every cycle; limit_ns: declared, of a node's computing."""

    name: str
    cause: str
    lasts_ns: Array
    limit_ns: float = np.inf


@dataclass(frozen=True)
class Chain:
    """Parts behind one another, from the sample at a cycle's start on. bound_ns: of the whole; None: there is none."""

    name: str
    joint: int
    parts: tuple[Part, ...]
    deadline_ns: int
    bound_ns: int | None

    @property
    def lasts_ns(self) -> Array:
        """How long it took in every cycle; nan where it never ended."""
        total: Array = np.sum([part.lasts_ns for part in self.parts], axis=0)
        return total

    def misses(self) -> dict[str, int]:
        """Return how often the deadline was missed, by cause.

        computing: where it took longer than declared, or gave no answer; drive: where it would have been met without
        the dead time; else the bus. The host's share is 0 in virtual time, where the machine cannot be late.
        """
        late = ~(self.lasts_ns <= self.deadline_ns)
        slow, dead_ns = np.zeros_like(late), np.zeros(len(late))
        for part in self.parts:
            if part.cause == COMPUTING:
                slow |= part.lasts_ns > part.limit_ns
            if part.cause == DRIVE:
                dead_ns += part.lasts_ns
        dead = late & ~slow & (self.lasts_ns - dead_ns <= self.deadline_ns)
        by_bus = late & ~slow & ~dead
        counts = {BUS: by_bus, COMPUTING: late & slow, DRIVE: dead, HOST: np.zeros_like(late)}
        return {cause: int(np.sum(missed)) for cause, missed in counts.items()}


@dataclass(frozen=True)
class Run:
    """What chains are made of, of so many cycles as there were.

    instants: of messages by cycle; silent: in which cycles each node gave no answer.
    """

    scenario: Scenario
    cycles: int
    instants: dict[str, Array]
    silent: dict[str, Bools]

    def of(self, name: str) -> Array:
        """Return the instants of a message, nan where there was none."""
        return self.instants.get(name, np.full((self.cycles, 3), np.nan))

    def computes(self, node: str, asked: Array, answer: Array, declared_ns: float) -> Part:
        """Return how long a node computed; for ever where it gave no answer to what it heard."""
        lasts_ns = answer[:, QUEUED] - asked[:, ENDS]
        silent = np.isnan(lasts_ns) & ~np.isnan(asked[:, ENDS]) & self.silent[node]
        return Part(f"{node} computes", COMPUTING, np.where(silent, np.inf, lasts_ns), declared_ns)


def chains(run: Run, bounds: dict[str, Bound] | None) -> list[Chain]:
    """Return of every joint: sample to action; then sample, DSP, AccelRef, current of the cycle that follows.

    A joint by its own timer may take a sample a period later, and nothing bounds when.
    """
    joints = range(1, run.scenario.joints + 1)
    period_ns = run.scenario.period_ns
    late = {n: 0 if run.scenario.crystal_ppb(n) is None else period_ns for n in joints}
    acts_ns = {
        n: None if bounds is None or late[n] else bounds[f"Current_{n}"].end_ns + _longest_dead_ns(run.scenario, n)
        for n in joints
    }
    direct = [Chain(f"joint{n}: sample to action", n, _direct(run, n), period_ns + late[n], acts_ns[n]) for n in joints]
    by_dsp = [
        Chain(
            f"joint{n}: sample, DSP, action",
            n,
            _by_dsp(run, n),
            2 * period_ns + late[n],
            None if act_ns is None else period_ns + act_ns,
        )
        for n, act_ns in acts_ns.items()
    ]
    return direct + by_dsp


def _longest_dead_ns(scenario: Scenario, n: int) -> int:
    drive = scenario.drive
    return sum(to_ns(values[n - 1]) for values in (drive.dead_time_s, drive.dead_time_jitter_s) if values)


def _direct(run: Run, n: int) -> tuple[Part, ...]:
    encoder, current = run.of(f"Encoder_{n}"), run.of(f"Current_{n}")
    computes = run.computes(f"joint{n}", encoder, current, run.scenario.compute_ns(n))
    if run.scenario.crystal_ppb(n) is not None:
        never = np.isnan(computes.lasts_ns) & ~np.isnan(encoder[:, ENDS])
        lasts_ns = np.where(never, np.inf, computes.lasts_ns)
        computes = Part(f"joint{n}: timer, computes", COMPUTING, lasts_ns, limit_ns=0)
    return (
        *_frame(f"Encoder_{n}", encoder, encoder[:, QUEUED] - _samples_ns(run)),
        computes,
        *_frame(f"Current_{n}", current),
        *_dead_time(run, n, current),
    )


def _dead_time(run: Run, n: int, current: Array) -> tuple[Part, ...]:
    """Return the part between a current's arrival and its application, where the drives have one: as the plant's."""
    dead = dead_time(run.scenario)
    if dead is None:
        return ()
    arrives_ns = current[:, ENDS]
    lasts_ns = np.full(len(arrives_ns), np.nan)
    for cycle in np.flatnonzero(np.isfinite(arrives_ns)):
        lasts_ns[cycle] = dead.applied_ns(n - 1, int(cycle), int(arrives_ns[cycle])) - arrives_ns[cycle]
    return (Part(f"drive {n}: dead time", DRIVE, lasts_ns),)


def _by_dsp(run: Run, n: int) -> tuple[Part, ...]:
    """Return the parts of the way by the DSP; its second half is that of the next cycle."""
    last, name = f"Encoder_{run.scenario.joints}", reference_of(n)[0]
    encoder, reference = run.of(last), run.of(name)
    begins = (
        *_frame(last, encoder, encoder[:, QUEUED] - _samples_ns(run)),
        run.computes("dsp", encoder, reference, to_ns(run.scenario.dsp.compute_s)),
        *_frame(name, reference),
    )
    _, _, *answers = _direct(run, n)
    held_ns = run.of(f"Encoder_{n}")[1:, ENDS] - reference[:-1, ENDS]
    held = Part(f"held until Encoder_{n}", BUS, held_ns)
    return (
        *(replace(part, lasts_ns=part.lasts_ns[:-1]) for part in begins),
        held,
        *(replace(part, lasts_ns=part.lasts_ns[1:]) for part in answers),
    )


def _samples_ns(run: Run) -> Array:
    return np.arange(run.cycles, dtype=np.float64) * run.scenario.period_ns


def _frame(name: str, instants: Array, before_ns: Array | float = 0.0) -> tuple[Part, Part]:
    """Return how long a frame waits, with what lies before it is queued, and how long it is on the bus."""
    waits = Part(f"{name} waits", BUS, before_ns + instants[:, STARTS] - instants[:, QUEUED])
    return waits, Part(f"{name} on the bus", BUS, instants[:, ENDS] - instants[:, STARTS])


def to_json(chain: Chain) -> dict[str, Any]:
    """Return what was measured of a chain, beside its bound, in seconds."""
    lasts_ns = _finite(chain.lasts_ns)
    return {
        "name": chain.name,
        "joint": chain.joint,
        "deadline_s": seconds(chain.deadline_ns),
        "bound_s": seconds(chain.bound_ns),
        "measured": distribution(lasts_ns / 1e9),
        "jitter_s": seconds(float(np.ptp(lasts_ns))) if len(lasts_ns) else None,
        "misses": chain.misses(),
        "parts": [_part(part) for part in chain.parts],
    }


def _part(part: Part) -> dict[str, Any]:
    lasts_ns = _finite(part.lasts_ns)
    span = (seconds(float(np.mean(lasts_ns))), seconds(float(np.max(lasts_ns)))) if len(lasts_ns) else (None, None)
    return {"name": part.name, "cause": part.cause, "mean_s": span[0], "max_s": span[1]}


def _finite(lasts_ns: Array) -> Array:
    return lasts_ns[np.isfinite(lasts_ns)]
