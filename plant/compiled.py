"""Machine code from generated source, by Numba where it is installed.

The same bits as the source run as Python: no fast-math, no contraction to fused multiply-add, and sin and cos are those
of the C library, as Python's are. Where Python raises (sin of infinity, a division by zero), machine code goes on with
numbers that are not finite: the source has to look for them.
Numba keeps what it compiled beside the file its source came from. Source that is generated, or linked of several
modules, gets such a file of its own, named by its content, in the user's cache folder: so the seconds of compiling are
spent once for each text and machine.
"""

import os
from collections.abc import Callable, Iterable
from functools import cache
from hashlib import sha256
from math import cos, sin
from pathlib import Path
from types import FunctionType
from typing import Any

from plant.linked_source import linked_source

Function = Callable[..., Any]


def machine_code(name: str, text: str, constants: Iterable[float]) -> Function | None:
    """Return the text's function, its first argument any sequence, its last the constants and already there.

    None where Numba is not installed, or where there is no folder for what it compiles.
    """
    function = _compiled(name, text)
    if function is None:
        return None
    from numpy import array

    values = array(list(constants))
    return lambda first, *others: function(array(first), *others, values)


@cache
def machine_code_of(function: FunctionType) -> Function | None:
    """Return a function of plain source, and all that it calls, as machine code; None as above."""
    return _compiled(function.__name__, linked_source(function))


@cache
def _compiled(name: str, text: str) -> Function | None:
    try:
        from numba import njit

        path = _kept(name, text)
        # by this name Numba imports, with the machine code it kept, the module of the function
        namespace: dict[str, Any] = {"sin": sin, "cos": cos, "__name__": __name__}
        exec(compile(text, str(path), "exec"), namespace)
        # numpy's error model: 1 / 0 is infinite, and costs no branch
        for used in [each for each, value in namespace.items() if isinstance(value, FunctionType)]:
            entry = used == name
            options: dict[str, Any] = (
                {"cache": True} if entry else {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
            )
            namespace[used] = njit(error_model="numpy", **options)(namespace[used])
        compiled: Function = namespace[name]
    except (ImportError, OSError, RuntimeError):  # RuntimeError is what Numba says if it cannot keep its code
        return None
    return compiled


def _kept(name: str, text: str) -> Path:
    """Return the file that holds the text; it appears whole or not at all, whoever else is about to write it."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    path = Path(base) / "hil" / f"{name}_{sha256(text.encode()).hexdigest()[:16]}.py"
    if not path.exists():
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        partial = path.with_suffix(f".{os.getpid()}")
        partial.write_text(text)
        partial.replace(path)
    return path
