"""A scenario's timing on a bus without time of its own, by the machine's clock: what the frames' stamps say.

When a frame was queued nobody but its sender knows: a response is counted from the frame that is answered, computing
included, and so is its bound. It holds for boards that compute as declared, at real time; a host may well be beyond it.
"""

from typing import Any

from hil.rig import Outcome
from hil.timing.response_time import Errors
from hil.timing.rig_analysis import Analysis


def wall_study(outcome: Outcome, data_bit_ns: int, errors: Errors | None = None) -> dict[str, Any]:
    """Return bounds beside what a run by the clock `wall` has measured, in seconds of the wall's time."""
    analysis, clock = Analysis(outcome.scenario, data_bit_ns, errors), outcome.clock
    seen = {name: {"response": found} for name, found in clock["answers"].items()}
    chains = [_chain(n, analysis, clock) for n in range(1, outcome.scenario.joints + 1)]
    return analysis.to_json(seen, by_answer=True) | {"chains": chains}


def _chain(n: int, analysis: Analysis, clock: dict[str, Any]) -> dict[str, Any]:
    """Return from Sync, which stands for the sample, to the current's frame."""
    measured = clock["since_sync"].get(f"Current_{n}")
    bound = None if analysis.worst is None else analysis.worst[f"Current_{n}"].end_ns / 1e9
    return {
        "name": f"joint{n}: sample to action",
        "joint": n,
        "deadline_s": clock["period_s"],
        "bound_s": bound,
        "measured": measured,
        "jitter_s": None if measured is None else measured["max_s"] - measured["min_s"],
        "misses": clock["current_misses"][f"joint{n}"],
        "parts": [],
    }
