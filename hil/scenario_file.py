"""Scenarios from files: find, read, set single values, validate, check what spans several keys.

Raises ScenarioError with the path of what is wrong, its value, the limit and the cure.
"""

import difflib
import tomllib
from collections.abc import Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from hil.errors import ScenarioError
from hil.joint_check import check_clocks, check_crystals, check_machine_code
from hil.scenario import Model, Scenario, check_interval
from hil.scenario_parts import to_ns
from hil.wire.fault import check_faults
from hil.wire.rates import bit_time_refusal
from plant.parameters import MAX_JOINTS

TASK_JOINTS = 3
KINDS = ("quintic", "circle", "line", "path")
"""Of a motion; pydantic puts the chosen one into the path of what is wrong."""
SHORTEST_LAG_S = 1e-5
"""The plant takes steps of a quarter of the lag: below this it would hardly move."""


def builtin_names(kind: str = "scenario") -> list[str]:
    """Return the names of the built-in scenarios, or sweeps, in order."""
    folder = resources.files(f"hil.{kind}s")
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def load(name_or_path: str, settings: Sequence[str] = ()) -> Scenario:
    """Return the built-in scenario of that name, or that of a .toml file, with `path=value` settings applied."""
    return build(parse(read(name_or_path), name_or_path), settings)


def build(values: dict[str, Any], settings: Sequence[str] = ()) -> Scenario:
    """Return the scenario of these values with `path=value` settings applied."""
    for setting in settings:
        apply(values, setting)
    try:
        scenario = Scenario.model_validate(values)
    except ValidationError as error:
        raise ScenarioError("\n".join(_explain(error))) from None
    check(scenario)
    return scenario


def parse(text: str, source: str) -> dict[str, Any]:
    """Return the values of a TOML text."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(f"{source}: not a TOML file: {error}") from None
    except RecursionError:
        raise ScenarioError(f"{source}: not a TOML file that we read: brackets in brackets without end") from None


def read(name_or_path: str, kind: str = "scenario") -> str:
    """Return the text of the built-in scenario, or sweep, of that name, or that of a .toml file."""
    if name_or_path in builtin_names(kind):
        return (resources.files(f"hil.{kind}s") / f"{name_or_path}.toml").read_text()
    path = Path(name_or_path)
    if path.suffix == ".toml":
        try:
            return path.read_text(encoding="utf-8-sig")
        except (OSError, UnicodeDecodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "not a text file"
            raise ScenarioError(f"{kind} file {name_or_path}: {reason}") from None
    raise ScenarioError(
        f"no {kind} {name_or_path!r}: built in are {', '.join(builtin_names(kind))}; a file's name ends in .toml"
    )


def apply(values: dict[str, Any], setting: str) -> None:
    """Set one value by `path=value`."""
    asked = f"--set {setting!r}"
    put(values, *parted(setting, asked), asked)


def parted(setting: str, asked: str) -> tuple[str, Any]:
    """Return path and value of `path=value`; what is not a TOML value is taken as a string."""
    path, equals, text = setting.partition("=")
    if not equals or not path:
        raise ScenarioError(f"{asked}: write path=value, for example joint.observer=false")
    try:
        return path, tomllib.loads(f"value = {text}")["value"]
    except (tomllib.TOMLDecodeError, RecursionError):
        return path, text


def put(values: dict[str, Any], path: str, value: Any, asked: str) -> None:
    """Set the value at a path; asked: who wants it, for the message of a ScenarioError."""
    *parents, key = path.split(".")
    inner: Any = values
    for parent in parents:
        inner = _inside(inner, parent, asked)
    if not isinstance(inner, dict):
        raise ScenarioError(f"{asked}: {'.'.join(parents)} is no table in this scenario: choose one of its keys")
    inner[key] = value


def _inside(values: Any, key: str, asked: str) -> Any:
    """Return the table or list of that key, made if it is not there; of a list, the entry of that number from 0."""
    if isinstance(values, dict):
        found = values.setdefault(key, {})
    elif key.isdecimal() and int(key) < len(values):
        found = values[int(key)]
    else:
        raise ScenarioError(f"{asked}: entry {key} of {len(values)}: they are numbered from 0")
    if not isinstance(found, dict | list):
        raise ScenarioError(f"{asked}: {key} is a value, not a table, in this scenario")
    return found


# -- what pydantic found, in our words --


def _explain(error: ValidationError) -> Iterator[str]:
    for item in error.errors(include_url=False):
        path = ".".join(str(part) for part in item["loc"] if not _is_tag(str(part)))
        if item["type"] == "extra_forbidden":
            yield f"scenario: unknown key {path}{suggestion(path)}"
        elif item["type"] == "missing":
            yield f"scenario: {path} is missing: set it in the file or with --set {path}=..."
        else:
            yield f"scenario: {path} = {item['input']!r}: {item['msg'].removeprefix('Value error, ')}"


def _is_tag(part: str) -> bool:
    """Return whether part of a path is pydantic's, which says what of a union it has tried."""
    return part in KINDS or part.startswith(("constrained-", "literal["))


def suggestion(path: str) -> str:
    """Return what to try in place of a path that no scenario, or not this one, has."""
    known = list(known_paths(Scenario))
    last = path.rpartition(".")[2]
    if path in known:
        return ": it does not go with the kind that is chosen beside it"
    near = difflib.get_close_matches(path, known, 1, 0.75) or [k for k in known if k.rpartition(".")[2] == last][:1]
    return f": did you mean {near[0]}?" if near else "; the scenario.toml of any run folder shows all keys"


def known_paths(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Yield the path of every key of a model; of a union of models, those of each."""
    for path, _ in known_keys(model, prefix):
        yield path


def known_keys(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the path and the annotation of every key of a model; of a union of models, those of each."""
    for key, field in model.model_fields.items():
        inner = _models(field.annotation)
        if not inner:
            yield prefix + key, field.annotation
        for part in inner:
            yield from known_keys(part, f"{prefix}{key}.")


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in getattr(annotation, "__args__", ()) for model in _models(part)]


# -- what spans several keys --


def check(scenario: Scenario) -> None:
    """Refuse what no single key shows: lengths, rates, times that do not fit together."""
    _check_lengths(scenario)
    check_clocks(scenario)
    check_machine_code(scenario)
    _check_rates(scenario)
    check_crystals(scenario)
    _check_faults(scenario)
    _check_spaces(scenario)
    _check_torques(scenario)
    _check_law(scenario)
    if scenario.has_world:
        from hil.world_check import check_world  # with numpy, which a run without a world does without

        check_world(scenario)
    _check_drive(scenario)
    for load in scenario.load:
        check_interval("load", load.at_s, load.until_s, scenario)


def _check_lengths(scenario: Scenario) -> None:
    joints = len(scenario.arm.lengths_m)
    if not 1 <= joints <= MAX_JOINTS:
        raise ScenarioError(f"arm.lengths_m has {joints} entries: an arm has 1 to {MAX_JOINTS} joints, one entry each")
    for path, values in scenario.per_joint().items():
        if len(values) != joints:
            raise ScenarioError(f"{path} has {len(values)} entries, but arm.lengths_m has {joints}: one a joint")


def _check_drive(scenario: Scenario) -> None:
    drive, period_s = scenario.drive, scenario.clock.period_s
    if 0.0 < drive.lag_s < SHORTEST_LAG_S:
        raise ScenarioError(f"drive.lag_s = {drive.lag_s}: 0 (none), or {SHORTEST_LAG_S} s and more")
    for n, jitter_s in enumerate(drive.dead_time_jitter_s):
        if jitter_s > 0.5 * period_s:
            raise ScenarioError(
                f"drive.dead_time_jitter_s.{n} = {jitter_s} is beyond half of clock.period_s = {period_s}: a current "
                "could overtake the one before: lower it"
            )


def _check_spaces(scenario: Scenario) -> None:
    """Refuse task space for other than three joints: its three coordinates (x, y, phi) would not fix the pose."""
    asked = "dsp.space = 'task'" if scenario.dsp.space == "task" else f"trajectory.kind = {scenario.trajectory.kind!r}"
    if scenario.joints != TASK_JOINTS and (scenario.in_task_space or scenario.dsp.space == "task"):
        raise ScenarioError(
            f"{asked}: task space (x, y, phi) takes {TASK_JOINTS} joints, but arm.lengths_m has {scenario.joints}: "
            "take dsp.space = 'joint' and trajectory.kind = 'quintic'"
        )


def _check_torques(scenario: Scenario) -> None:
    for torque in scenario.torque:
        if torque.joint > scenario.joints:
            raise ScenarioError(f"torque.joint = {torque.joint}: the arm has joints 1 to {scenario.joints}")
        check_interval("torque", torque.at_s, torque.until_s, scenario)


def _check_faults(scenario: Scenario) -> None:
    check_faults(scenario.wire.faults, scenario.node_names, scenario.bus.fidelity == "functional", fd=False)


def _check_law(scenario: Scenario) -> None:
    if scenario.dsp.law == "computed-torque" and scenario.joint.observer:
        raise ScenarioError(
            "dsp.law = 'computed-torque' with joint.observer = true: the law sends torques, which the observer would "
            "take for accelerations: set joint.observer = false, or dsp.law = 'acceleration'"
        )
    if scenario.dsp.law == "acceleration" and scenario.model != Model():
        raise ScenarioError(
            f"[model] {scenario.model} with dsp.law = 'acceleration', which needs no model of the arm: "
            "leave it out, or set dsp.law = 'computed-torque'"
        )


def _check_rates(scenario: Scenario) -> None:
    clock, period_ns = scenario.clock, scenario.period_ns
    if scenario.duration_ns % period_ns:
        raise ScenarioError(
            f"duration_s = {scenario.duration_s} is not a multiple of clock.period_s = {clock.period_s}: change either"
        )
    if 1_000_000_000 % scenario.bus.bitrate:
        raise ScenarioError(f"bus.bitrate = {scenario.bus.bitrate}: {bit_time_refusal(scenario.bus.bitrate)}")
    for joint in range(1, scenario.joints + 1):
        if scenario.compute_ns(joint) >= period_ns:
            raise ScenarioError(
                f"joint{joint}: compute_s = {scenario.compute_ns(joint) * 1e-9} is not below "
                f"clock.period_s = {clock.period_s}: it would never keep up: raise clock_hz, or lower compute_s"
            )
    if to_ns(scenario.dsp.compute_s) >= period_ns:
        raise ScenarioError(f"dsp.compute_s = {scenario.dsp.compute_s} is not below clock.period_s = {clock.period_s}")
