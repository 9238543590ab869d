"""Where the tests find MicroPython, and what becomes of one that cannot be had."""

import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests import micropython
from tests.lab import packages

STANZA = "Types: deb\nURIs: https://{}\nSuites: bookworm bookworm-updates\nComponents: main\n"


@pytest.fixture
def bare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine without it, on which nothing was fetched yet; return its cache."""
    monkeypatch.delenv(micropython.NAMED_IN, raising=False)
    monkeypatch.setattr(shutil, "which", lambda _name: None)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "hil"


def packed(folder: Path, name: str, files: dict[str, str]) -> None:
    """Make a package of these files."""
    root = folder / name
    for path, text in ({"DEBIAN/control": f"Package: {name}\nVersion: 1\nArchitecture: all\n"} | files).items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(text)
        (root / path).chmod(0o755)
    control = f"Package: {name}\nVersion: 1\nArchitecture: all\nMaintainer: nobody\nDescription: none\n"
    (root / "DEBIAN" / "control").write_text(control)
    subprocess.run(["dpkg-deb", "--build", root, folder / f"{name}.deb"], check=True, capture_output=True)


@pytest.mark.skipif(shutil.which("dpkg-deb") is None, reason="no dpkg-deb: this is no Debian")
def test_the_next_releases_package_is_unpacked_once_with_its_libraries(
    bare: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[str, ...]] = []
    sources: list[str] = []

    def ask(*words: str, cwd: Path | None = None) -> str:
        asked.append(words)
        (source,) = [word for word in words if word.startswith("Dir::Etc::sourcelist=")]
        sources.append(Path(source.partition("=")[2]).read_text())
        if "download" in words:
            assert cwd is not None
            assert words[-2:] == ("micropython", "libc6")
            loader = "#!/bin/sh\nshift 2; echo loaded $(basename $1) $2\n"
            packed(cwd, "libc6", {"usr/lib/some/ld-linux-some.so.2": loader})
            packed(cwd, "micropython", {"usr/bin/micropython": "ELF"})
        return "micropython\n  Depends: libc6\n"

    monkeypatch.setattr(packages, "ask", ask)
    monkeypatch.setattr(micropython, "_release", lambda: "bookworm")
    monkeypatch.setattr(micropython, "_sources", lambda release: STANZA.format(release))
    monkeypatch.setattr(shutil, "which", lambda name: None if name == "micropython" else f"/usr/bin/{name}")
    path = micropython.program()
    assert path == micropython.program() == bare / "micropython" / "micropython"
    assert len(asked) == 3
    assert set(sources) == {STANZA.format("trixie").replace("bookworm", "trixie")}
    assert all("Dir::State::status=/dev/null" in words for words in asked)
    said = subprocess.run([path, "main.py"], capture_output=True, text=True, check=True).stdout
    assert said == "loaded micropython main.py\n"


@pytest.mark.parametrize("under_ci", [True, False])
def test_where_it_cannot_be_had_tests_skip_with_the_reason_and_fail_under_ci(
    bare: Path, monkeypatch: pytest.MonkeyPatch, under_ci: bool
) -> None:
    monkeypatch.setenv("HIL_LAB", "1" if under_ci else "0")
    monkeypatch.setattr(micropython, "_release", lambda: "bookworm")
    monkeypatch.setattr(micropython, "_sources", lambda release: STANZA.format(release))
    kind: Any = pytest.fail.Exception if under_ci else pytest.skip.Exception
    with pytest.raises(kind, match=r"NO MICROPYTHON, .* NOT TESTED: there is no apt-get here"):
        micropython.needed()
    assert list(bare.iterdir()) == []


@pytest.mark.usefixtures("bare")
def test_a_machine_that_is_no_debian_is_told_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "exists", lambda _path: False)
    with pytest.raises(packages.Missing, match="install micropython, or name it in HIL_MICROPYTHON: this is no Debian"):
        micropython.program()


def test_the_one_that_is_named_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(micropython.NAMED_IN, os.devnull)
    assert micropython.needed() == Path(os.devnull)
