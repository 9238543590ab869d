"""Sweep files: one TOML file says which scenario, what is fixed, and what each of its sweeps varies.

Raises ScenarioError with the path of what is wrong, its value, the limit and the cure.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, ValidationError, model_validator

from hil import scenario_file
from hil.errors import ScenarioError
from hil.record import toml_table, toml_value
from hil.scenario_parts import Part
from hil.sweep.columns import OF_A_JOINT, OF_A_RUN, TIP
from hil.sweep.paths import flat

MOST_POINTS = 1_000_000
OURS = {"bus.fidelity": "functional", "clock.kind": "virtual"}
PARTS = ("set", "vary", "figure")
FIGURES = (*OF_A_JOINT, *OF_A_RUN, TIP)
"""What a figure can show: of a joint, its number left out, and of a run."""
TAGS = ("choices", "range", "normal")

Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e300, le=1e300)]
Count = Annotated[int, Field(ge=1, le=MOST_POINTS)]


def plain(value: Any) -> Any:
    """Return a value as it is; raise ValueError for what no scenario takes: dates, infinities, huge numbers."""
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    if isinstance(value, list):
        return [plain(each) for each in value]
    if isinstance(value, bool | str) or (isinstance(value, int | float) and abs(value) < 2**63):
        return value
    raise ValueError(f"{value} is no value of a scenario's: take a number below 2^63, true, false, a string or a list")


Table = Annotated[dict[str, Any], BeforeValidator(plain)]
Choices = Annotated[list[Any], BeforeValidator(plain), Field(min_length=1, max_length=MOST_POINTS)]


class Range(Part):
    """From one number to another, both included; log: equal ratios instead of equal differences."""

    start: Finite = Field(alias="from")
    to: Finite
    steps: Annotated[int, Field(ge=2, le=MOST_POINTS)] | None = None
    """How many values, of a grid or a list; random samples fill the range."""
    log: bool = False

    @model_validator(mode="after")
    def _positive(self) -> "Range":
        if self.log and min(self.start, self.to) <= 0:
            raise ValueError(f"from {self.start:g} to {self.to:g} with log: both must be above 0")
        return self


class Normal(Part):
    """A normal distribution: mean and standard deviation."""

    normal: tuple[Finite, Annotated[float, Field(ge=0, le=1e300)]]


def _kind(values: Any) -> str:
    if isinstance(values, list):
        return "choices"
    return "normal" if isinstance(values, Normal) or (isinstance(values, dict) and "normal" in values) else "range"


Vary = Annotated[
    Annotated[Choices, Tag("choices")] | Annotated[Range, Tag("range")] | Annotated[Normal, Tag("normal")],
    Discriminator(_kind),
]


class Figure(Part):
    """A figure of a sweep: paths that it varies, or columns of its table; of columns by joint a panel each.

    x, y: of the axes; by: a line each; value: the colour of a heat map.
    """

    kind: Literal["lines", "heat-map", "pareto"]
    x: str
    y: str
    by: str | None = None
    value: str | None = None

    @model_validator(mode="after")
    def _fitting(self) -> "Figure":
        if (self.value is not None) != (self.kind == "heat-map"):
            raise ValueError(f"kind = {self.kind!r}: value, the colour, goes with a heat-map, and only with one")
        if self.by is not None and self.kind != "lines":
            raise ValueError(f"kind = {self.kind!r}: by goes with lines")
        shown = self.value or self.y
        if shown not in FIGURES:
            near = get_close_matches(shown, FIGURES, 1, 0.3)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(FIGURES)}"
            raise ValueError(f"kind = {self.kind!r}: {shown!r} is not a figure of a run: {hint}")
        return self

    @property
    def axes(self) -> list[str]:
        """What is not shown, but what it is shown over."""
        return [name for name in (self.x, self.y, self.by) if name is not None and name != (self.value or self.y)]


class Sweep(Part):
    """One sweep: what it varies, and how."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=64)]
    method: Literal["grid", "list", "latin-hypercube", "monte-carlo"]
    samples: Count | None = None
    fixed: Table = Field(default={}, alias="set")
    vary: Annotated[dict[str, Vary], Field(min_length=1)]
    figure: Figure | None = None

    @property
    def is_random(self) -> bool:
        """Whether its points are drawn."""
        return self.method in ("latin-hypercube", "monte-carlo")

    @model_validator(mode="after")
    def _fitting(self) -> "Sweep":
        if self.is_random and self.samples is None:
            raise ValueError(f"method = {self.method!r} needs samples, for example samples = 100")
        if not self.is_random and self.samples is not None:
            raise ValueError(f"method = {self.method!r} takes no samples: its lists say how many points there are")
        for path, values in self.vary.items():
            self._check(path, values)
        if self.figure is not None:
            self._check_figure(self.figure)
        return self

    def _check_figure(self, figure: Figure) -> None:
        """Refuse axes that are not there, and pictures in which runs would hide one another."""
        known = [*self.vary, *OF_A_RUN, TIP]
        for name in figure.axes:
            if name not in known:
                near = get_close_matches(name, known, 1, 0.3)
                hint = f"did you mean {near[0]}?" if near else f"a run has {', '.join((*OF_A_RUN, TIP))}"
                raise ValueError(f"figure: {name!r} is neither varied nor a figure of a whole run: {hint}")
        hidden = [path for path in self.vary if path not in figure.axes]
        if hidden and figure.kind != "pareto":
            raise ValueError(
                f"figure: kind = {figure.kind!r} does not show {', '.join(hidden)}, which the sweep varies, too: "
                "make sweeps of their own of it, or take kind = 'pareto'"
            )

    def _check(self, path: str, values: Any) -> None:
        """Refuse values that the method cannot take."""
        if self.is_random and isinstance(values, Range) and values.steps is not None:
            raise ValueError(f"vary {path!r}: method = {self.method!r} fills a range: leave steps out")
        if not self.is_random and isinstance(values, Normal):
            raise ValueError(f"vary {path!r}: a {self.method} takes a list or a range, normal is of random methods")
        if not self.is_random and isinstance(values, Range) and values.steps is None:
            raise ValueError(f"vary {path!r}: a range of a {self.method} needs steps, for example steps = 5")


class SweepFile(Part):
    """A sweep file; scenario: the values of a scenario, as read and with all settings, before any default."""

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    scenario: Table
    sweep: Annotated[tuple[Sweep, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _names(self) -> "SweepFile":
        twice = [name for name, count in Counter(each.name for each in self.sweep).items() if count > 1]
        if twice:
            raise ValueError(f"two sweeps are named {twice[0]!r}: give each a name of its own")
        return self

    @property
    def name(self) -> str:
        """The scenario's name."""
        return str(self.scenario.get("name", "scenario"))


def load(name_or_path: str, settings: Sequence[str] = ()) -> SweepFile:
    """Return the built-in sweep of that name, or that of a .toml file; settings: `path=value`, on top of its own."""
    values = scenario_file.parse(scenario_file.read(name_or_path, "sweep"), name_or_path)
    scenario = _scenario(values.get("scenario"), name_or_path)
    for path, value in _fixed(values.pop("set", {}), name_or_path):
        scenario_file.put(scenario, path, value, f"{name_or_path}: set {path}")
    for setting in settings:
        scenario_file.apply(scenario, setting)
    _flatten(values.get("sweep"), name_or_path)
    try:
        return SweepFile.model_validate(values | {"scenario": scenario})
    except ValidationError as error:
        raise ScenarioError("\n".join(_explain(error, name_or_path))) from None


def _flatten(sweeps: Any, source: str) -> None:
    """Make a path of every key that the sweeps set and vary; leave what is none to the validation."""
    for each in sweeps if isinstance(sweeps, list) else ():
        if isinstance(each, dict):
            each["set"] = dict(_fixed(each.get("set", {}), source))
            if isinstance(each.get("vary"), dict):
                each["vary"] = dict(flat(each["vary"]))


def _scenario(named: Any, source: str) -> dict[str, Any]:
    """Return the values of the scenario: a table, a built-in name, or a path beside the sweep file.

    What the sweep itself does not set runs under the rule `functional` and in virtual time.
    """
    if isinstance(named, dict):
        for path, value in OURS.items():
            part, key = path.split(".")
            if isinstance(inner := named.setdefault(part, {}), dict):
                inner.setdefault(key, value)
        return named
    if not isinstance(named, str):
        raise ScenarioError(f'{source}: scenario is missing: name one, for example scenario = "paper-joint"')
    if named not in scenario_file.builtin_names():
        named = str(Path(source).parent / named)
    values = scenario_file.parse(scenario_file.read(named), named)
    for path, value in OURS.items():
        scenario_file.put(values, path, value, f"{source}: {path}")
    return values


def _fixed(given: Any, source: str) -> Iterator[tuple[str, Any]]:
    """Yield path and value of what is set: a table, or a list of path=value."""
    if isinstance(given, dict):
        yield from flat(given)
    elif isinstance(given, list) and all(isinstance(each, str) for each in given):
        for setting in given:
            yield scenario_file.parted(setting, f"{source}: set {setting!r}")
    else:
        raise ScenarioError(f"{source}: set = {given!r}: write a table, or a list of path=value")


def _explain(error: ValidationError, source: str) -> Iterator[str]:
    items = error.errors(include_url=False)
    for item in items:
        if item["loc"] == ("sweep",) and item["type"] == "too_short" and len(items) > 1:
            continue  # only because those in it are wrong
        path = ".".join(str(part) for part in item["loc"] if part not in TAGS)
        if item["type"] == "extra_forbidden":
            yield f"{source}: unknown key {path}: docs/sweep.md shows all keys of a sweep file"
        elif item["type"] == "missing":
            yield f"{source}: {path} is missing"
        else:
            value = "" if isinstance(item["input"], dict) else f" = {item['input']!r}"
            yield f"{source}: {path}{value}: {item['msg'].removeprefix('Value error, ')}"


def to_toml(file: SweepFile) -> str:
    """Return a sweep file that holds its scenario itself; reading it gives the same sweeps."""
    lines = [f"seed = {file.seed}", "", "[scenario]", *toml_table("scenario.", file.scenario)]
    for sweep in file.sweep:
        values = sweep.model_dump(mode="json", by_alias=True, exclude_none=True)
        lines += ["", "[[sweep]]", *toml_table("", {key: value for key, value in values.items() if key not in PARTS})]
        for part in (part for part in PARTS if part in values):
            lines += ["", f"[sweep.{part}]"]
            lines += [f"{toml_value(path)} = {toml_value(value)}" for path, value in values[part].items()]
    return "\n".join(lines) + "\n"
