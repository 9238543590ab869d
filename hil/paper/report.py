"""The report on the paper as values: sections with claims, tables and figures, for the terminal, JSON and a page."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

Folder = Path | None
"""Where a part of the report draws its figures; None: nowhere."""


@dataclass(frozen=True)
class Claim:
    """What the paper says, where, what we measure, and whether it holds (None: the paper gives nothing to hold to)."""

    says: str
    where: str
    measured: str
    holds: bool | None

    @property
    def verdict(self) -> str:
        """Whether it holds, in a word."""
        return {True: "yes", False: "no", None: "-"}[self.holds]


@dataclass(frozen=True)
class Table:
    """Cells as text, the header first."""

    title: str
    header: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


@dataclass(frozen=True)
class Section:
    """One part of the report. values: the numbers behind it, JSON-ready. figures: file names without suffix."""

    name: str
    title: str
    text: str
    claims: list[Claim] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    figures: list[tuple[str, str]] = field(default_factory=list)
    """(file name without suffix, caption)"""
    values: Any = None


CHOICES = Table(
    "Where we had to choose",
    ("the paper", "we take"),
    [
        ("control period: illegible", "1 ms; a parameter (clock.period_s)"),
        ("masses and lengths of the arm (fig. 13): not given", "0.30, 0.25, 0.15 m; 3.0, 1.5, 0.5 kg; geared drives"),
        ("speed w: from a speed sensor", "difference of two encoder positions; the counts of table 1 stay the same"),
        ("fig. 8 is drawn for g = 1000 rad/s, table 2 says 700", "700 on the rig; 1000 by formula only, see fig. 8"),
        ("fig. 15: the commanded motion is not described", "every joint by half a radian in 1 s, a quintic"),
        ("fig. 16: size of the velocity command illegible", "a circle of 5 cm radius in 1 s: a peak of 59 cm/s"),
        ("the rival of table 1 is called inverse kinematics in the text", "inverse dynamics, as the table itself says"),
    ],
)


def to_json(sections: list[Section]) -> dict[str, Any]:
    """Return the whole report as JSON-ready values."""
    claims = [asdict(claim) | {"section": section.name} for section in sections for claim in section.claims]
    return {
        "claims": claims,
        "choices": [dict(zip(CHOICES.header, row, strict=True)) for row in CHOICES.rows],
        **{section.name: section.values for section in sections},
    }
