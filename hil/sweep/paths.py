"""Paths of a sweep: which there are, and how a point's values get into a scenario.

A path is that of `--set`; one that ends in " *" multiplies what the base scenario has there, every entry of a tuple.
"""

from collections.abc import Iterable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from functools import cache
from math import isfinite
from typing import Any

from hil import scenario_file
from hil.errors import ScenarioError
from hil.scenario import Scenario

FACTOR = " *"
OF_A_RANGE = {"from", "to", "steps", "log", "normal"}
"""No scenario has such keys: a table with one of them is what a path is varied over."""


def flat(values: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield path and value of everything in nested tables."""
    for key, value in values.items():
        if isinstance(value, dict) and not OF_A_RANGE & value.keys():
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


def check_known(path: str, asked: str) -> None:
    """Refuse a path that no scenario has; suggest the nearest."""
    key = _key(path)
    if not any(known == key or known.startswith(f"{key}.") for known, _ in scenario_file.known_keys(Scenario)):
        raise ScenarioError(f"{asked}: unknown path {path!r}{scenario_file.suggestion(key)}")


@cache
def is_whole(path: str) -> bool:
    """Whether a path takes whole numbers only."""
    forms = [form for known, form in scenario_file.known_keys(Scenario) if known == _key(path)]
    kinds = {kind for form in forms for kind in _leaves(form)}
    return int in kinds and float not in kinds and not path.endswith(FACTOR)


def _key(path: str) -> str:
    """Return a path without its factor and its numbers of entries."""
    return ".".join(part for part in path.removesuffix(FACTOR).split(".") if not part.isdecimal())


def _leaves(annotation: Any) -> Iterator[Any]:
    """Yield the types that a union, tuple or annotated type is made of."""
    parts = getattr(annotation, "__args__", None)
    if parts is None:
        yield annotation
    for part in parts or ():
        yield from _leaves(part)


@dataclass(frozen=True)
class Base:
    """What all points of a sweep have in common. values: as read; resolved: with all defaults, to multiply."""

    values: dict[str, Any]
    resolved: dict[str, Any]
    joints: int

    @classmethod
    def of(cls, values: dict[str, Any]) -> "Base":
        """Return the base of these values; raise ScenarioError where they are no scenario."""
        scenario = scenario_file.build(deepcopy(values))
        return cls(values, scenario.model_dump(mode="json"), scenario.joints)

    def check_factors(self, paths: Iterable[str]) -> None:
        """Refuse to multiply what is no number."""
        for path in paths:
            scaled(path.removesuffix(FACTOR), _at(self.resolved, path.removesuffix(FACTOR)), 1.0)

    def scenario(self, point: dict[str, Any]) -> Scenario:
        """Return the scenario with a point's values; raise ScenarioError where it refuses them."""
        values = deepcopy(self.values)
        for path, value in point.items():
            self._put(values, path, value)
        scenario = scenario_file.build(values)
        if scenario.joints != self.joints:
            raise ScenarioError(f"an arm of {scenario.joints} joints in a sweep of one of {self.joints}")
        if scenario.clock.kind != "virtual":
            raise ScenarioError(f"clock.kind = {scenario.clock.kind!r}: a sweep runs in virtual time")
        return scenario

    def _put(self, values: dict[str, Any], path: str, value: Any) -> None:
        if path.endswith(FACTOR):
            path = path.removesuffix(FACTOR)
            value = scaled(path, _at(self.resolved, path), value)
        whole, _, entry = path.rpartition(".")
        if entry.isdecimal():  # of a tuple that the file may have left at its default
            entries = _at(values, whole) or _at(self.resolved, whole)
            if not isinstance(entries, list) or int(entry) >= len(entries):
                raise ScenarioError(f"{path} is no entry of the scenario's {whole}: they are numbered from 0")
            path, value = whole, [value if k == int(entry) else each for k, each in enumerate(entries)]
        scenario_file.put(values, path, value, path)


def scaled(path: str, value: Any, factor: Any) -> Any:
    """Return a number, or every number of a list, times a factor; whole numbers stay whole."""
    if isinstance(value, list):
        return [scaled(path, each, factor) for each in value]
    if not _is_number(value):
        raise ScenarioError(f"{path}{FACTOR}: the scenario has {value!r} there, and only numbers can be multiplied")
    if not _is_number(factor) or not isfinite(value * factor):
        raise ScenarioError(f"{path}{FACTOR}: {factor!r} is no factor: take a number")
    return round(value * factor) if isinstance(value, int) else value * factor


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _at(values: Any, path: str) -> Any:
    """Return what is at a path, None if nothing is."""
    for part in path.split("."):
        if isinstance(values, dict):
            values = values.get(part)
        elif isinstance(values, list) and part.isdecimal() and int(part) < len(values):
            values = values[int(part)]
        else:
            return None
    return values
