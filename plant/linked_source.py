"""The source of a function and of all that it uses, as one text: what Numba is given to compile, and keeps.

A text that is complete names its content: a change anywhere in it is another text, so machine code that was kept can
never be that of an older source. What may be used: functions with their source, numbers, and names of math and numpy.
"""

import builtins
import dis
import inspect
import math
from collections.abc import Iterator
from textwrap import dedent
from types import CodeType, FunctionType
from typing import Any

HEAD = "from __future__ import annotations\n"
"""Annotations stay text: what they name is not in it."""


def linked_source(function: FunctionType) -> str:
    """Return the text; TypeError names what cannot be in it, or what two things are called."""
    lines: dict[str, str] = {}
    found: dict[str, Any] = {}
    waiting: list[tuple[str, Any]] = [(function.__name__, function)]
    while waiting:
        name, value = waiting.pop()
        if name in found:
            if found[name] is not value and found[name] != value:
                raise TypeError(f"{name}: {found[name]!r} and {value!r}: give one of them another name")
            continue
        found[name] = value
        lines[name] = _definition(name, value)
        if isinstance(value, FunctionType):
            waiting += [(value.__name__, value), *_used(value)]
    return HEAD + "\n".join(sorted(lines.values(), key=_order))


def _order(text: str) -> tuple[int, str]:
    """Put imports first, then functions, then what is named after them."""
    return 0 if text.startswith(("import", "from")) else 1 if text.startswith("def") else 2, text


def _definition(name: str, value: Any) -> str:
    """Return the lines that define a name."""
    if isinstance(value, FunctionType):
        return dedent(inspect.getsource(value)) if name == value.__name__ else f"{name} = {value.__name__}\n"
    if isinstance(value, bool | int | float):
        return f"{name} = {value!r}\n" if math.isfinite(value) else f'{name} = float("{value!r}")\n'
    if inspect.ismodule(value) and value.__name__ == "numpy":
        return f"import numpy as {name}\n"
    if getattr(math, name, None) is value:
        return f"from math import {name}\n"
    raise TypeError(f"{name} = {value!r}: neither a function of ours, nor a number, nor of math or numpy")


def _used(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Yield name and value of what a function takes from outside."""
    code = function.__code__
    cells = zip(code.co_freevars, function.__closure__ or (), strict=True)
    yield from ((name, cell.cell_contents) for name, cell in cells)
    for name in _global_names(code):
        if name in function.__globals__:
            yield name, function.__globals__[name]
        elif not hasattr(builtins, name):
            raise TypeError(f"{function.__name__} uses {name}, which is nowhere")


def _global_names(code: CodeType) -> set[str]:
    names = {each.argval for each in dis.get_instructions(code) if each.opname == "LOAD_GLOBAL"}
    inner = [_global_names(each) for each in code.co_consts if isinstance(each, CodeType)]
    return names.union(*inner)
