"""Word lengths from 8 to 32 bits: where the knee is, and what fails first below it.

A word is good enough if no joint's deviation, the largest or that at the end, exceeds that of the longest word by more
than TOLERANCE of it and one encoder count (less is the limit cycle's: another one in every run); and if nothing
overflows. The knee is the shortest word of which, as of all longer ones, that is so.

A word's length sets several things at once. Below the knee each is made as coarse as the shorter word has it, alone, in
a word of 16 bits with room for all else: the first that is no longer good enough alone is what fails first. Runs are
under the rule `functional`.
"""

from math import inf
from typing import Any

import numpy as np

from dbc.codec import Codec
from dbc.compiler import load_arm
from hil.engine.fast import quickest
from hil.errors import HilError
from hil.exact_constants import rad_per_count
from hil.rig import Progress, no_progress
from hil.scenario import Scenario
from hil.sweep.row import figures
from hil.word_format import BUS_BITS, WordFormat, with_word

SHORTEST, LONGEST = 8, 32
TOLERANCE = 0.10
DEVIATIONS = ("max_deviation_rad", "final_deviation_rad")
COUNTER = "position counter"
Row = dict[str, Any]


def word_lengths(scenario: Scenario, progress: Progress = no_progress) -> dict[str, Any]:
    """Return a row of every word length, the knee, and what each format costs alone, from the knee down."""
    codec, lengths = load_arm(), range(SHORTEST, LONGEST + 1)
    rows = []
    for done, bits in enumerate(lengths, start=1):
        rows.append({"bits": bits, **_run(with_word(scenario, bits=bits))})
        progress(done / (len(lengths) + 1))
    judged = _Judge(scenario, rows[-1])
    rows = [row | {"excess": judged.excess(row)} for row in rows]
    good = [row["excess"] <= 1.0 for row in rows]
    knee = next((bits for place, bits in enumerate(lengths) if all(good[place:])), None)
    alone = [] if knee is None else _alone(scenario, min(knee, BUS_BITS), codec, judged)
    progress(1.0)
    first = _first(alone)
    rows, alone = ([row | {"excess": _finite(row["excess"])} for row in each] for each in (rows, alone))
    return {"lengths": rows, "knee_bits": knee, "alone": alone, "fails_first": first}


class _Judge:
    """Says how far a run is beyond what is good enough."""

    def __init__(self, scenario: Scenario, best: Row) -> None:
        self._best, self._count_rad = best, rad_per_count(scenario)

    def excess(self, row: Row) -> float:
        """Return the worst joint's excess over the best as a share of what is allowed; inf for no run, or overflows."""
        if row["reason"] or row["overflows"] or self._best["reason"]:
            return inf
        pairs = [pair for name in DEVIATIONS for pair in zip(row[name], self._best[name], strict=True)]
        return max(float((x - best) / (TOLERANCE * best + self._count_rad)) for x, best in pairs)


def _run(scenario: Scenario) -> Row:
    """Return the figures of a run, and why it has none."""
    try:
        found, _ = quickest(scenario)
    except HilError as error:
        return _no_run(str(error))
    if not len(found.q):
        return _no_run(found.stopped)
    worth, joints = figures(scenario, found), range(1, scenario.joints + 1)
    overflows = sum(count for name, count in worth.items() if name.startswith("saturations_"))
    fastest = np.max(np.abs(np.diff(found.q, axis=0)), initial=0.0) / rad_per_count(scenario)
    return {
        "reason": found.stopped,
        "overflows": overflows,
        "counter_bits": int(fastest + 1).bit_length() + 1,
        **{name: [worth[f"{name}_{n}"] for n in joints] for name in DEVIATIONS},
    }


def _no_run(reason: str) -> Row:
    return {"reason": reason, "overflows": 0, "counter_bits": None} | dict.fromkeys(DEVIATIONS)


def _alone(scenario: Scenario, knee: int, codec: Codec, judged: _Judge) -> list[Row]:
    """Return the excess of each format alone, as words from the knee downward have it, until one fails."""
    usual = _run(with_word(scenario, bits=BUS_BITS))
    rows: list[Row] = []
    for bits in range(knee - 1, SHORTEST - 1, -1):
        short = WordFormat.of(with_word(scenario, bits=bits), codec)
        formats = {
            "current count": {"current_fraction": short.current, "kb_fraction": short.bus_current - short.current},
            "acceleration count": {"acceleration_fraction": short.acceleration},
            "last bit of d": {"d_fraction": short.d_fraction + short.current_shift},
            "last bit of KB": {"kb_fraction": short.kb_places},
        }
        for name, word in formats.items():
            row = _run(with_word(scenario, bits=BUS_BITS, **word))
            rows.append({"what": name, "bits": bits, "formats": word, "excess": judged.excess(row)})
        lacking = bits < (usual["counter_bits"] or 0)
        rows.append({"what": COUNTER, "bits": bits, "formats": {}, "excess": inf if lacking else 0.0})
        if _first(rows):
            break
    return rows


def _finite(value: float) -> float | None:
    return None if value == inf else value


def _first(rows: list[Row]) -> Row | None:
    """Return the format that is furthest beyond what is good enough; None if none is, alone."""
    worst = max(rows, key=lambda row: float(row["excess"]), default=None)
    return worst | {"excess": _finite(worst["excess"])} if worst is not None and worst["excess"] > 1.0 else None
