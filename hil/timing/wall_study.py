"""A scenario's timing on a bus without time of its own, by the machine's clock: what the frames' stamps say.

When a frame was queued nobody but its sender knows: a response is counted from the frame that is answered, computing
included, and so is its bound. It holds for boards that compute as declared, at real time; a host may well be beyond it.
"""

from typing import Any

from hil.rig import Outcome
from hil.timing.response_time import Errors
from hil.timing.rig_analysis import Analysis
from hil.timing.study import cycles_of


def wall_study(outcome: Outcome, data_bit_ns: int, errors: Errors | None = None) -> dict[str, Any]:
    """Return bounds beside what a run by the clock `wall` has measured, in seconds of the wall's time."""
    analysis, clock = Analysis(outcome.scenario, data_bit_ns, errors), outcome.clock
    seen = {name: {"response": found} for name, found in clock["answers"].items()}
    joints = range(1, outcome.scenario.joints + 1)
    chains = [_chain(n, analysis, clock) for n in joints] + [_by_dsp(n, analysis, clock) for n in joints]
    return analysis.to_json(seen, by_answer=True) | {"cycles": cycles_of(outcome), "chains": chains}


def _chain(n: int, analysis: Analysis, clock: dict[str, Any]) -> dict[str, Any]:
    """Return from Sync, which stands for the sample, to the current's frame."""
    measured = clock["since_sync"].get(f"Current_{n}")
    return _row(f"joint{n}: sample to action", n, analysis, clock, measured, 1)


def _by_dsp(n: int, analysis: Analysis, clock: dict[str, Any]) -> dict[str, Any]:
    """Return from Sync by the DSP's AccelRef to the current's frame of the next cycle."""
    return _row(f"joint{n}: sample, DSP, action", n, analysis, clock, clock["by_dsp"].get(f"Current_{n}"), 2)


def _row(
    name: str, n: int, analysis: Analysis, clock: dict[str, Any], measured: dict[str, Any] | None, periods: int
) -> dict[str, Any]:
    """Return one chain; a miss of its last cycle is a miss of both."""
    worst = analysis.worst
    periods_ns = (periods - 1) * analysis.cycle.period_ns
    return {
        "name": name,
        "joint": n,
        "deadline_s": periods * clock["period_s"],
        "bound_s": None if worst is None else (periods_ns + worst[f"Current_{n}"].end_ns) / 1e9,
        "measured": measured,
        "jitter_s": None if measured is None else measured["max_s"] - measured["min_s"],
        "misses": clock["current_misses"][f"joint{n}"],
        "parts": [],
    }
