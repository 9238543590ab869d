"""What a run by the machine's clock says of that clock: overruns, latencies, and what was not permitted."""

from typing import Any

from hil.latency import distribution
from hil.rig import Outcome

SUMMED = ("foreign_stamps", "bare_stamps", "old_stamps", "unsent")
"""Counters of every node's loop."""


def real_time(outcome: Outcome) -> dict[str, Any]:
    """Return the figures, in seconds of wall time; nothing for a run without.

    sync_late: each Sync's start behind its deadline, by the DSP; sync_interval, since_sync: by the stamps at the rig.
    """
    if not outcome.clock:
        return {}
    reports = outcome.reports
    dsp = reports.get("dsp", {})
    refused = {name: report["refused"] for name, report in reports.items() if report.get("refused")}
    trouble = {name: report["bus_trouble"] for name, report in reports.items() if report.get("bus_trouble")}
    return {
        "real_time": {
            **outcome.clock,
            "overruns": dsp.get("overruns"),
            "sync_late": distribution([late_ns * 1e-9 for late_ns in dsp.get("late_ns", [])]),
            "clock_steps": max((report.get("clock_steps", 0) for report in reports.values()), default=0),
            **{name: sum(report.get(name, 0) for report in reports.values()) for name in SUMMED},
            "refused": refused,
            "bus_trouble": trouble,
        }
    }
