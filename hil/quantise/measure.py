"""What a signal makes of its format: range, bits used, head-room, overflows, and its error beside float64.

SQNR = 10 log10 (sum s^2 / sum (s - q)^2), s in float64 and q as it was; its mean is not taken off. None where there is
no error, or no signal.
"""

from dataclasses import dataclass
from math import log10
from typing import Any

import numpy as np

from hil.quantise.float_twin import Values
from hil.quantise.signals import SATURATED, UNDERFLOWED, WRAPPED, Raw, Signal, Trace


@dataclass(frozen=True)
class Reference:
    """The same signal in float64: with exact constants, and with those of the joint's table."""

    exact: Values
    same_constants: Values


def measure(signal: Signal, joint: int, trace: Trace, at_s: Values, reference: Reference) -> dict[str, Any]:
    """Return the row of a signal as JSON-ready values. at_s: time of each sample."""
    used = bits_used(trace.raw, signal.signed)
    values = np.ldexp(trace.raw.astype(np.float64), -signal.fraction)
    of_value_s = np.repeat(at_s, len(trace.raw) // len(at_s))
    saturated, wrapped, underflowed = (trace.became == what for what in (SATURATED, WRAPPED, UNDERFLOWED))
    return {
        "name": signal.name,
        "joint": joint,
        "q_format": signal.q_format,
        "unit": signal.unit,
        "constant": signal.constant,
        "min": float(np.min(values)),
        "max": float(np.max(values)),
        "bits_used": used,
        "headroom_bits": signal.bits - used,
        "saturations": int(np.sum(saturated)),
        "first_saturation_s": _first_s(saturated, of_value_s),
        "wraps": int(np.sum(wrapped)),
        "first_wrap_s": _first_s(wrapped, of_value_s),
        "underflows": int(np.sum(underflowed)),
        "first_underflow_s": _first_s(underflowed, of_value_s),
        "sqnr_db": sqnr_db(reference.exact, values),
        "sqnr_same_constants_db": sqnr_db(reference.same_constants, values),
        "largest_error": float(np.max(np.abs(values - reference.exact))),
        "histogram": histogram(trace.raw, signal.bits),
    }


def bits_used(raw: Raw, signed: bool) -> int:
    """Return the shortest word that holds every value: in two's complement, or without a sign."""
    magnitudes = np.where(raw < 0, ~raw, raw)
    return int(np.max(magnitudes)).bit_length() + signed


def histogram(raw: Raw, bits: int) -> list[int]:
    """Return how many values have a magnitude of k bits, 2^(k - 1) <= |raw| < 2^k, k from 0 (zeros) to bits."""
    _, lengths = np.frexp(np.abs(raw).astype(np.float64))
    counted: list[int] = np.bincount(lengths, minlength=bits + 1).tolist()
    return counted


def sqnr_db(reference: Values, values: Values) -> float | None:
    """Return the ratio of a signal to its error in dB; None if one of them is nothing."""
    power, error = float(np.sum(reference**2)), float(np.sum((reference - values) ** 2))
    return 10.0 * log10(power / error) if power > 0.0 and error > 0.0 else None


def _first_s(happened: Any, at_s: Values) -> float | None:
    return float(at_s[np.argmax(happened)]) if np.any(happened) else None
