"""Q formats that fit a scenario better, and the proof: the scenario run again in them.

Each fraction is the largest with which the constants still fit and every signal keeps HEADROOM_BITS above what was
measured. It is never finer than the bus's counts: nothing finer comes in, or goes out. d keeps the fraction it has.
"""

from collections.abc import Sequence
from typing import Any

from dbc.codec import Codec
from hil.constants import constants_fit
from hil.scenario import Scenario
from hil.word_format import WordFormat, with_word

HEADROOM_BITS = 1
CURRENTS = ("estimate", "i", "i-d", "d")
ACCELERATIONS = ("a_ref",)


def propose(scenario: Scenario, codec: Codec, rows: Sequence[dict[str, Any]]) -> Scenario:
    """Return the scenario in the formats that its measured signals ask for. rows: of `hil.quantise.measure`."""
    if not scenario.joint.observer:
        return scenario  # KB is nothing, and d with it
    form = WordFormat.of(scenario, codec)
    current = min(form.bus_current, form.current + _spare(rows, CURRENTS))
    acceleration = min(form.bus_acceleration, form.acceleration + _spare(rows, ACCELERATIONS))
    for fraction in range(current, -form.bits, -1):
        chosen = with_word(
            scenario,
            current_fraction=fraction,
            acceleration_fraction=acceleration,
            kb_fraction="fit",
            d_fraction=form.d_fraction,
        )
        if constants_fit(chosen, codec):
            return chosen
    return scenario


def changes(scenario: Scenario, chosen: Scenario, codec: Codec) -> dict[str, int]:
    """Return the settings that the chosen formats differ by."""
    before, after = (WordFormat.of(each, codec) for each in (scenario, chosen))
    names = {"current": "current_fraction", "acceleration": "acceleration_fraction", "kb_fraction": "kb_fraction"}
    return {
        f"joint.word.{key}": getattr(after, name)
        for name, key in names.items()
        if getattr(after, name) != getattr(before, name)
    }


def _spare(rows: Sequence[dict[str, Any]], names: Sequence[str]) -> int:
    """Return how many bits all these signals could do without at the upper end."""
    return min(int(row["headroom_bits"]) for row in rows if row["name"] in names) - HEADROOM_BITS
