"""How a joint's CPU writes numbers down: word length, bits behind the point, roundings, overflow."""

from typing import Annotated, Literal

from pydantic import Field

from hil.scenario_parts import Part

Rounding = Literal["floor", "nearest", "convergent", "toward-zero"]
Fraction = Annotated[int, Field(ge=-16, le=32)]


class Word(Part):
    """The word of every joint CPU, by default the 8086's.

    Its constants come over the bus and have at most 16 bits. A fraction below 0 is a count of more than one unit.
    """

    bits: Annotated[int, Field(ge=8, le=32)] = 16
    d_fraction: Annotated[int, Field(ge=0, le=54)] | None = None
    """Bits of d behind a current count; default: as many as the word has, at most 62 - bits."""
    kb_fraction: Fraction | Literal["fit"] | None = None
    """Bits of KB behind a current count per count and sample; fit: as many as all joints' KB leave; default: 0, and
    16 - bits in longer words."""
    current_fraction: Fraction | None = None
    """Bits behind the ampere; default: bits - 5, for a full scale of 16 A."""
    acceleration_fraction: Fraction | None = None
    """Bits behind 1 rad/s^2; default: bits - 9, for a full scale of 256 rad/s^2."""
    round_d: Rounding = "floor"
    """What d takes of KB dw and KA (i - d), where it has less bits behind the point than they."""
    round_estimate: Rounding = "floor"
    """d as a word."""
    round_reference: Rounding = "nearest"
    """KJ a_ref in current counts."""
    overflow: Literal["saturate", "wrap"] = "saturate"
