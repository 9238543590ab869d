"""How long things took: quantiles and a histogram, in seconds."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

QUANTILES = {"p50_s": 0.5, "p99_s": 0.99, "p99.9_s": 0.999}
BINS_A_DECADE = 10
SMALLEST_S = 1e-6


def distribution(
    values_s: Sequence[float] | npt.NDArray[np.float64], bin_s: float | None = None
) -> dict[str, Any] | None:
    """Return count, least, p50, p99, p99.9, largest, and a histogram; None without values.

    Its bins are logarithmic, or bin_s wide, around its multiples. edges_s has one entry more than counts; what is below
    the first edge counts in the first bin. A quantile is a value that was measured: the least that this share of all
    does not exceed.
    """
    if not len(values_s):
        return None
    values = np.asarray(values_s, dtype=float)
    found = {name: float(np.quantile(values, share, method="inverted_cdf")) for name, share in QUANTILES.items()}
    counts, edges = _histogram(np.maximum(values, SMALLEST_S)) if bin_s is None else _even_histogram(values, bin_s)
    span = {"count": len(values), "min_s": float(values.min())} | found | {"max_s": float(values.max())}
    return span | {"edges_s": edges, "counts": counts}


def _histogram(values: Any) -> tuple[list[int], list[float]]:
    """Return (counts, edges): from SMALLEST_S on, as many bins as it takes."""
    decades = np.log10(values.max() / SMALLEST_S)
    bins = max(1, int(np.floor(decades * BINS_A_DECADE)) + 1)
    edges = SMALLEST_S * 10.0 ** (np.arange(bins + 1) / BINS_A_DECADE)
    counts, _ = np.histogram(values, edges)
    return counts.tolist(), edges.tolist()


def _even_histogram(values: Any, bin_s: float) -> tuple[list[int], list[float]]:
    """Return (counts, edges): bins of one width, from the least to the largest."""
    first, last = (round(float(value) / bin_s) for value in (values.min(), values.max()))
    edges = (np.arange(first, last + 2) - 0.5) * bin_s
    counts, _ = np.histogram(values, edges)
    return counts.tolist(), edges.tolist()
