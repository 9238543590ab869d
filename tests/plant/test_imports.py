"""The plant knows no clock, no bus, no process and no firmware."""

import ast
from pathlib import Path

import pytest

import plant

SOURCES = sorted(Path(plant.__file__).parent.glob("*.py"))
FORBIDDEN = {"time", "datetime", "can", "socket", "multiprocessing", "threading", "asyncio", "hil", "firmware_py"}


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.name)
def test_module_imports_nothing_forbidden(source):
    names = set()
    for node in ast.walk(ast.parse(source.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add((node.module or "").split(".")[0])
    assert not names & FORBIDDEN
