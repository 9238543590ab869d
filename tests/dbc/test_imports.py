"""The package stays free of clocks, buses and sockets, and only its compiler knows cantools."""

import ast
from importlib.resources import files

import pytest

MODULES = [path for path in files("dbc").iterdir() if path.name.endswith(".py")]


def imported(path):
    """The modules that a file imports, anywhere in it."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.name)
def test_no_clock_bus_or_socket(path):
    outermost = {name.split(".")[0] for name in imported(path)}
    assert not outermost & {"asyncio", "can", "datetime", "selectors", "socket", "time"}
    assert path.name == "compiler.py" or "cantools" not in outermost


def test_codec_imports_next_to_nothing():
    assert set(imported(files("dbc") / "codec.py")) == {"struct", "dbc.crc"}
