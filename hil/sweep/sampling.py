"""The points of a sweep: grids, lists, Latin hypercubes, Monte Carlo.

Random points are numbers u from 0 to 1, put through the quantile function of what is varied: one for each sample and
path, drawn by a generator of the path's own, so that another path changes nothing in its column.

Ref: M. D. McKay, R. J. Beckman, W. J. Conover, A Comparison of Three Methods for Selecting Values of Input Variables
in the Analysis of Output from a Computer Code, Technometrics 21 (1979).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice, product
from math import exp, log, prod
from statistics import NormalDist
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.errors import ScenarioError
from hil.sweep.paths import check_known, is_whole
from hil.sweep.sweep_file import MOST_POINTS, Normal, Range, Sweep, SweepFile

Array = npt.NDArray[np.float64]
LEAST = 2.0**-54
"""In place of a 0 drawn, whose normal quantile is infinite."""


@dataclass(frozen=True)
class Point:
    """One run: the sweep's name, its number in it from 0, and the value of every varied path."""

    sweep: str
    index: int
    values: dict[str, Any]


def points(file: SweepFile) -> list[Point]:
    """Return the points of all sweeps, in order; raise ScenarioError for unknown paths, unequal lists, too many."""
    found: list[Point] = []
    for sweep in file.sweep:
        for path in (*sweep.fixed, *sweep.vary):
            check_known(path, f"sweep {sweep.name}")
        rows = islice(_rows(sweep, file.seed), MOST_POINTS + 1 - len(found))
        found += [Point(sweep.name, index, dict(zip(sweep.vary, row, strict=True))) for index, row in enumerate(rows)]
        if len(found) > MOST_POINTS:
            raise ScenarioError(f"sweep {sweep.name}: beyond {MOST_POINTS} points: take fewer, or two files")
    return found


def _rows(sweep: Sweep, seed: int) -> Iterator[tuple[Any, ...]]:
    if sweep.is_random:
        return zip(*(_drawn(sweep, seed, path) for path in sweep.vary), strict=True)
    columns = [_listed(path, values) for path, values in sweep.vary.items()]
    if sweep.method == "grid":
        if prod(map(len, columns)) > MOST_POINTS:
            raise ScenarioError(
                f"sweep {sweep.name}: a grid of {' x '.join(str(len(c)) for c in columns)} points is "
                f"beyond {MOST_POINTS}: take fewer values, or random samples"
            )
        return product(*columns)
    lengths = {path: len(column) for path, column in zip(sweep.vary, columns, strict=True)}
    if len(set(lengths.values())) > 1:
        counted = ", ".join(f"{path}: {length}" for path, length in lengths.items())
        raise ScenarioError(f"sweep {sweep.name}: lists of different lengths ({counted}): give each as many values")
    return zip(*columns, strict=True)


def _listed(path: str, values: Any) -> list[Any]:
    """Return the values of a list, or of a range's steps."""
    if not isinstance(values, Range):
        return list(values)
    shares = [k / (values.steps - 1) for k in range(values.steps)] if values.steps else []
    return [_fit(path, quantile(values, share)) for share in shares]


def _drawn(sweep: Sweep, seed: int, path: str) -> list[Any]:
    # of the generator only its doubles, whose stream is the same in every version of numpy
    stream = np.random.Generator(np.random.PCG64([seed, *f"{sweep.name} {path}".encode()]))
    values, count = sweep.vary[path], sweep.samples or 0
    shares = latin(stream, count) if sweep.method == "latin-hypercube" else stream.random(count)
    return [_fit(path, quantile(values, float(share))) for share in shares]


def latin(stream: np.random.Generator, count: int) -> Array:
    """Return one number in each of `count` equal parts of [0, 1), in random order."""
    order = np.argsort(stream.random(count), kind="stable")
    shares = (order + stream.random(count)) / count
    return np.minimum(shares, np.nextafter((order + 1) / count, 0.0))  # a sum may round up to the next part's first


def quantile(values: Any, share: float) -> Any:
    """Return the value below which a share of a range, normal distribution or list lies."""
    if isinstance(values, Normal):
        mean, deviation = values.normal
        return NormalDist().inv_cdf(max(share, LEAST)) * deviation + mean
    if not isinstance(values, Range):
        return values[int(share * len(values))]
    if share in (0.0, 1.0):
        return values.to if share else values.start
    if values.log:
        return exp((1.0 - share) * log(values.start) + share * log(values.to))
    return (1.0 - share) * values.start + share * values.to


def _fit(path: str, value: Any) -> Any:
    """Return a value as the path takes it: whole numbers where it takes no others."""
    return round(value) if isinstance(value, float) and is_whole(path) else value
