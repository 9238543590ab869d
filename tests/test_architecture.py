"""The invariants of ARCHITECTURE.md that can be read off the source."""

import ast
import tomllib
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("dbc", "firmware_py", "plant", "hil")
FILES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
NOT_BELOW = {"dbc": {"firmware_py", "plant", "hil"}, "firmware_py": {"plant", "hil"}, "plant": {"firmware_py", "hil"}}
OUTSIDE = {
    "time",
    "datetime",
    "can",
    "socket",
    "selectors",
    "select",
    "subprocess",
    "multiprocessing",
    "threading",
    "asyncio",
}
ONLY_IN = {
    "cantools": {"dbc/compiler.py"},
    "matplotlib": {
        "hil/bench/plot.py",
        "hil/figures.py",
        "hil/i8086/figure.py",
        "hil/paper/plots.py",
        "hil/quantise/rest_figure.py",
        "hil/quantise/words_figure.py",
        "hil/sweep/figures.py",
        "hil/timing/drift_figure.py",
        "hil/timing/gantt.py",
        "hil/timing/margin_figures.py",
        "hil/timing/response_figure.py",
        "hil/timing/style.py",
        "hil/timing/waterfall.py",
        "hil/wall_figure.py",
    },
    "distributed": {"hil/sweep/crew.py"},
    "pyarrow": {"hil/record.py"},
    "numba": {"plant/compiled.py"},
    "unicorn": {"hil/i8086/unicorn_board.py"},
    "pymunk": {"plant/pymunk_links.py", "plant/world.py"},
    "pickle": set(),
}


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


@cache
def imports(path: Path) -> dict[str, bool]:
    """Return the top-level packages that a module imports, and whether at its own top level."""
    tree = parsed(path)
    found: dict[str, bool] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        else:
            continue
        for name in names:
            package = name.split(".")[0]
            found[package] = found.get(package, False) or node in tree.body
    return found


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_imports_point_one_way(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    assert not NOT_BELOW.get(package, set()) & imports(path).keys()


@pytest.mark.parametrize("path", [p for p in FILES if p.relative_to(ROOT).parts[0] != "hil"], ids=name_of)
def test_only_the_bench_knows_clocks_buses_sockets_and_processes(path: Path) -> None:
    assert not OUTSIDE & imports(path).keys()


@pytest.mark.parametrize("name", ["firmware_py/joint_cpu.py", "firmware_py/words.py"])
def test_the_joint_cpu_imports_nothing(name: str) -> None:
    assert imports(ROOT / name) == {}


@pytest.mark.parametrize("package", ONLY_IN)
def test_heavy_packages_are_imported_where_they_are_used(package: str) -> None:
    users = {name_of(path): imports(path)[package] for path in FILES if package in imports(path)}
    assert users.keys() == ONLY_IN[package]
    # plant/world.py is itself imported where a world is built (tests/hil/test_world_scenarios.py)
    assert not any(top for name, top in users.items() if name not in ("dbc/compiler.py", "plant/world.py"))


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_every_module_says_what_it_is_and_stays_small(path: Path) -> None:
    """A module opens with a docstring; 350 lines is where a drawer begins."""
    assert ast.get_docstring(parsed(path))
    assert path.read_text().count("\n") <= 350


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_functions_stay_below_60_lines(path: Path) -> None:
    functions = [n for n in ast.walk(parsed(path)) if isinstance(n, ast.FunctionDef)]
    long = {f.name for f in functions if (f.end_lineno or 0) - f.lineno > 60}
    assert long <= {"_bind"}  # firmware_py/words.py: a list of one-line operations


def test_every_package_is_installed() -> None:
    """An editable install hides one that is forgotten."""
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    assert listed == sorted({".".join(path.relative_to(ROOT).parts[:-1]) for path in FILES})


def test_every_dependency_has_its_reason_above_it() -> None:
    lines = (ROOT / "pyproject.toml").read_text().splitlines()
    listed = [
        k for k, line in enumerate(lines) if line.startswith('    "') and (">=" in line or line.endswith('ruff",'))
    ]
    assert len(listed) > 10
    bare = [lines[k] for k in listed if not lines[k - 1].lstrip().startswith("#")]
    assert not bare
