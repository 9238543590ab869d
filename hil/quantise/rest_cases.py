"""A scenario at rest in other formats: fewer bits of d, and each resolution by itself in front of a finer encoder.

With the encoder that the scenario has, its count hides what is finer; with one so fine that it counts for nothing, each
of the others is seen alone. No command changes: only `joint.word`, and the encoder.
"""

from collections.abc import Iterator, Sequence
from math import ceil, log2, pi
from typing import Any, NamedTuple

from dbc.codec import Codec
from dbc.compiler import load_arm
from hil.errors import ScenarioError
from hil.quantise.dead_band import dead_band
from hil.quantise.rest import Rest, rest, row_of
from hil.rig import Progress, no_progress
from hil.scenario import Scenario
from hil.word_format import WordFormat, with_word

AS_IT_IS = "as it is"
MOST_D_FRACTION = 16
COARSER = (2, 4, 6)
"""Bits less behind the point of the current's and of the reference's count."""
FINER = 32
"""Counts of the finer encoder in the widest band of the other resolutions, at least."""
MOST_COUNTS = 1 << 31


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


def study(scenario: Scenario, progress: Progress = no_progress) -> list[Found]:
    """Bring every case to rest, the scenario as it is first; progress: told the share done.

    Raises ScenarioError where the scenario as it is never comes to rest.
    """
    (_, _, as_it_is), *others = every = list(cases(scenario, load_arm()))
    found = [Found(every[0], rest(as_it_is))]
    for case in others:
        progress(len(found) / len(every))
        found.append(_rested(case))
    return found


def _rested(case: Case) -> Found:
    try:
        return Found(case, rest(case.scenario))
    except ScenarioError as error:
        return Found(case, [], str(error))


def cases(scenario: Scenario, codec: Codec) -> Iterator[Case]:
    """Yield the scenario; with 0 to 16 bits of d; that and coarser counts with a finer encoder, if there is one."""
    yield Case(AS_IT_IS, False, scenario)
    form = WordFormat.of(scenario, codec)
    fractions = range(min(form.d_fraction, MOST_D_FRACTION) + 1)
    for fraction in fractions:
        yield Case("d_fraction", False, with_word(scenario, d_fraction=fraction))
    counts = finer_counts(scenario, codec)
    if counts <= scenario.encoder.counts_per_turn:
        return
    for fraction in fractions:
        yield Case("d_fraction", True, with_encoder(with_word(scenario, d_fraction=fraction), counts))
    for swept, own in (("current_fraction", form.current), ("acceleration_fraction", form.acceleration)):
        for coarser in COARSER:
            yield Case(swept, True, with_encoder(with_word(scenario, **{swept: own - coarser}), counts))


def finer_counts(scenario: Scenario, codec: Codec) -> int:
    """Return counts of a turn, a power of 2, of which FINER fit the band that current and reference leave alone."""
    bands = [dead_band(scenario, joint, codec).alone for joint in range(1, scenario.joints + 1)]
    narrowest = min(max(each["current"], each["reference"]) for each in bands)
    return int(min(MOST_COUNTS, 2 ** ceil(log2(FINER * 2 * pi / narrowest))))


def with_encoder(scenario: Scenario, counts: int) -> Scenario:
    """Return a scenario with another encoder, and as many bits behind the point of KB as its word has room for."""
    encoder = scenario.encoder.model_copy(update={"counts_per_turn": counts})
    return with_word(scenario.model_copy(update={"encoder": encoder}), kb_fraction="fit")


def check(scenario: Scenario) -> None:
    """Raise ScenarioError for a scenario that has no dead band to predict."""
    codec = load_arm()
    for joint in range(1, scenario.joints + 1):
        dead_band(scenario, joint, codec)


# -- as JSON --


def to_json(found: Sequence[Found]) -> dict[str, Any]:
    """Return a row for every case and joint, ready for JSON, and the cases that cannot be."""
    codec = load_arm()
    rows = [
        {"swept": each.case.swept, "finer_encoder": each.case.fine, **row_of(joint, codec)}
        for each in found
        for joint in each.joints
    ]
    refused = [
        {
            "swept": each.case.swept,
            "value": getattr(each.case.scenario.joint.word, each.case.swept, None),
            "finer_encoder": each.case.fine,
            "cause": each.refused,
        }
        for each in found
        if each.refused
    ]
    return {"rest": rows, "rest_refused": refused, "rest_not_fast": found[0].joints[0].slow or None}
