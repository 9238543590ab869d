"""Fault scripts from TOML files: one [[fault]] table each, as fault.py describes them."""

import tomllib
from collections.abc import Sequence
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from hil.errors import ScenarioError
from hil.wire.fault import Fault, check_faults


class _File(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    fault: tuple[Fault, ...] = ()


def load(path: Path, functional: bool, fd: bool) -> Sequence[Fault]:
    """Return the faults of a file; raise ScenarioError naming what is wrong in it."""
    try:
        script = _File.model_validate(tomllib.loads(path.read_text()))
    except OSError as error:
        raise ScenarioError(f"fault script {path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ScenarioError(f"fault script {path}: no TOML: {error}") from None
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ScenarioError(f"fault script {path}: {where}: {first['msg']}") from None
    check_faults(script.fault, (), functional, fd)
    return script.fault
