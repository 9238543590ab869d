"""The run folder: resolved scenario, frame log, signals, summary, figures; there whole or not at all."""

import json
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import fields
from errno import ENOTDIR
from pathlib import Path
from typing import Any

from dbc.compiler import arm_dbc
from hil.errors import MissingExtraError, OutputError
from hil.evaluate import Evaluation
from hil.exact_constants import rad_per_count
from hil.rig import Outcome
from hil.scenario import Scenario

FRAME_LOG = "frames.log"
SIGNALS = "signals.parquet"
DATABASE = "arm.dbc"
SUMMARY = "summary.json"
SCENARIO = "scenario.toml"


@contextmanager
def run_folder(path: Path) -> Iterator[Path]:
    """Give a folder to write to, which takes its name only when everything is in it; raise OutputError otherwise."""
    check_new(path)
    with _explained(path):
        partial = Path(tempfile.mkdtemp(prefix=f".{path.name[:100]}-", suffix=".partial", dir=path.parent))
        try:
            yield partial
            if path.exists():
                path.rmdir()
            partial.chmod(0o755)
            partial.rename(path)
        finally:
            shutil.rmtree(partial, ignore_errors=True)


def check_new(path: Path) -> None:
    """Refuse, before a run, a folder that holds something already or could not be written."""
    with _explained(path):
        if path.resolve() == Path.cwd():
            raise OutputError(f"run folder {path} is the current directory: name a new one")
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise OutputError(f"run folder {path} is there already: choose another --out, or remove it")
        if path.parent.exists() and not path.parent.is_dir():
            raise NotADirectoryError(ENOTDIR, "Not a directory")
        path.parent.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path.parent).close()


def _explained(path: Path) -> AbstractContextManager[None]:
    return explained(f"run folder {path}", "nothing was kept: choose another --out")


@contextmanager
def explained(what: str, cure: str) -> Iterator[None]:
    """Turn what the system refuses into an OutputError."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{what}: {error.strerror or error}; {cure}") from None


def write_run(folder: Path, outcome: Outcome, evaluation: Evaluation | None, summary: dict[str, Any]) -> None:
    """Write everything but the figures."""
    (folder / SCENARIO).write_text(to_toml(outcome.scenario))
    outcome.log.write_candump(folder / FRAME_LOG, "arm")
    (folder / DATABASE).write_text(arm_dbc(outcome.scenario.joints, rad_per_count(outcome.scenario)))
    (folder / SUMMARY).write_text(json.dumps(summary, indent=2) + "\n")
    if evaluation is not None:
        write_signals(folder / SIGNALS, evaluation)


def parquet(what: str, extra: str) -> Any:
    """Return pyarrow with its module for Parquet; raise MissingExtraError."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise MissingExtraError(
            f"{what} are written by pyarrow, which is not installed: pip install 'hil[{extra}]'"
        ) from None
    return pyarrow


def write_signals(path: Path, evaluation: Evaluation) -> None:
    """Write every signal as a column of float64, one row a cycle; names end in unit and joint or axis."""
    pyarrow = parquet("signals", "report")
    pyarrow.parquet.write_table(pyarrow.table(signal_columns(evaluation)), path)


def signal_columns(evaluation: Evaluation) -> dict[str, Any]:
    """Return the columns of the signals file by name."""
    columns: dict[str, Any] = {"t_s": evaluation.t_s}
    by_joint = {
        "q_cmd_rad": evaluation.q_cmd,
        "w_cmd_rad_s": evaluation.w_cmd,
        "q_rad": evaluation.q,
        "w_rad_s": evaluation.w,
        "a_ref_rad_s2": evaluation.a_ref,
        "i_ref_A": evaluation.i_ref,
        "current_A": evaluation.current,
        "estimate_Nm": evaluation.estimate,
        "disturbance_Nm": evaluation.disturbance.total(),
    }
    for field in fields(evaluation.disturbance):
        by_joint[f"disturbance_{field.name}_Nm"] = getattr(evaluation.disturbance, field.name)
    for name, values in by_joint.items():
        columns |= {f"{name}_{n + 1}": values[:, n] for n in range(values.shape[1])}
    by_axis = {
        "tip_cmd_m": evaluation.x_cmd,
        "tip_m": evaluation.x,
        "tip_speed_cmd_m_s": evaluation.v_cmd,
        "tip_speed_m_s": evaluation.v,
    }
    for name, values in by_axis.items():
        columns |= {f"{name}_{axis}": values[:, k] for k, axis in enumerate("xy")}
    return columns | evaluation.world


def to_toml(scenario: Scenario) -> str:
    """Return a scenario with every value written out; reading it gives the same scenario."""
    return "\n".join(toml_table("", scenario.model_dump(mode="json", exclude_none=True))).lstrip("\n") + "\n"


def toml_table(path: str, values: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of a table: its own values, then the tables in it."""
    tables = {key: value for key, value in values.items() if isinstance(value, dict) or _is_tables(value)}
    for key, value in values.items():
        if key not in tables:
            yield f"{key} = {toml_value(value)}"
    for key, value in tables.items():
        name = f"{path}{key}"
        for each in value if isinstance(value, list) else [value] if value else []:
            yield from ("", f"[[{name}]]" if isinstance(value, list) else f"[{name}]")
            yield from toml_table(f"{name}.", each)


def toml_value(value: Any) -> str:
    """Return a value in one line of TOML; its strings are those of JSON, but for DEL."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{toml_value(key)} = {toml_value(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return f"[{', '.join(map(toml_value, value))}]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False).replace("\x7f", "\\u007f")


def _is_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], dict)
