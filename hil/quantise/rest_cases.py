"""A scenario at rest in other formats: fewer bits of d, and each resolution by itself in front of a finer encoder.

With the encoder that the scenario has, its count hides what is finer; with one so fine that it counts for nothing, each
of the others is seen alone. No command changes: only `joint.word`, and the encoder.
"""

from collections.abc import Iterator
from concurrent.futures import Executor
from math import ceil, floor, log2, pi
from typing import Any, NamedTuple

from dbc.codec import Codec
from dbc.compiler import load_arm
from hil.constants import exact_constants
from hil.errors import ScenarioError
from hil.quantise.dead_band import dead_band
from hil.quantise.rest import Rest, rest, to_json
from hil.rig import Progress, no_progress
from hil.scenario import Scenario
from hil.word_format import WordFormat

AS_IT_IS = "as it is"
MOST_D_FRACTION = 16
COARSER = (2, 4, 6)
"""Bits less behind the point of the current's and of the reference's count."""
FINER = 32
"""Counts of the finer encoder in the widest band of the other resolutions, at least."""
MOST_COUNTS, MOST_FRACTION = 1 << 31, 32


class Case(NamedTuple):
    """A scenario to be brought to rest. swept: what differs from the given one; fine: with the finer encoder."""

    swept: str
    fine: bool
    scenario: Scenario


class Found(NamedTuple):
    """What a case's joints did; refused: why they could not, "" if they did."""

    case: Case
    joints: list[Rest]
    refused: str = ""


def study(scenario: Scenario, executor: Executor, progress: Progress = no_progress) -> list[Found]:
    """Bring every case to rest, each as a task of its own, the scenario as it is first; progress: told the share done.

    Raises ScenarioError where the scenario as it is never comes to rest.
    """
    every = list(cases(scenario, load_arm()))
    found = []
    for done, one in enumerate(executor.map(_rested, every), start=1):
        progress(done / len(every))
        found.append(one)
        if found[0].refused:
            raise ScenarioError(found[0].refused)
    return found


def _rested(case: Case) -> Found:
    try:
        return Found(case, rest(case.scenario))
    except ScenarioError as error:
        return Found(case, [], str(error))


def cases(scenario: Scenario, codec: Codec) -> Iterator[Case]:
    """Yield the scenario, then with 0 to 16 bits of d, then the same and coarser counts with a finer encoder."""
    yield Case(AS_IT_IS, False, scenario)
    form = WordFormat.of(scenario, codec)
    d_fractions = range(min(form.d_fraction, MOST_D_FRACTION) + 1)
    for fraction in d_fractions:
        yield Case("d_fraction", False, _with_word(scenario, d_fraction=fraction))
    fine = finer_encoder(scenario, codec)
    for fraction in d_fractions:
        yield Case("d_fraction", True, _with_word(fine, d_fraction=fraction))
    for coarser in COARSER:
        yield Case("current_fraction", True, finer_encoder(_coarser(scenario, "current_fraction", form.current - coarser), codec))
