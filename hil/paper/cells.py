"""Numbers as the cells of the report's tables."""

from pathlib import Path

import numpy as np

URAD = 1e-6


def made(folder: Path) -> Path:
    """Make a folder."""
    folder.mkdir()
    return folder


def listed(values: object, form: str) -> str:
    """Return numbers with commas between them."""
    return ", ".join(format(value, form) for value in np.asarray(values, dtype=float))


def urad(values: object) -> str:
    """Return rad as numbers of microradians, or m as micrometres."""
    return listed(np.asarray(values, dtype=float) / URAD, ".1f")


def mrad(values: object) -> str:
    """Return rad as numbers of milliradians."""
    return listed(np.asarray(values, dtype=float) * 1000, ".2f")


def times(values: object) -> str:
    """Return ratios."""
    return listed(values, ".0f")


def small(values: list[float], unit: str) -> str:
    """Return rad or m with the unit that is a millionth of it."""
    return f"{urad(values)} {'urad' if unit == 'rad' else 'um'}"
