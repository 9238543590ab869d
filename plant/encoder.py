"""A joint's incremental encoder: whole counts since the start pose, in a counter that wraps.

Units: rad, counts. Ref: ARCHITECTURE.md, "Frames" (16 bits wrap after 0.5 rad).
Not modelled: index pulse, eccentricity, edge jitter.
"""

from math import floor, tau


class Encoder:
    """Counter of counts_per_turn a joint turn, counter_bits wide, zero at zero_rad."""

    def __init__(self, zero_rad: float, counts_per_turn: int, counter_bits: int) -> None:
        self._zero_rad = zero_rad
        self._counts_per_rad = counts_per_turn / tau
        self._mask = (1 << counter_bits) - 1

    def counts(self, q_rad: float) -> int:
        """Return the counter at q_rad: floor, modulo 2^counter_bits."""
        return floor((q_rad - self._zero_rad) * self._counts_per_rad) & self._mask
