"""MicroPython's unix port for the tests: where HIL_MICROPYTHON says, on the path, or Debian's, kept in the cache.

`python -m tests.micropython` prints where it is. `steps` has the joint's control step computed there, row by row.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

from firmware_py.joint_cpu import SIGNALS
from tests.lab import packages
from tests.lab.packages import Missing
from tests.wanting import wanting

ROOT = Path(__file__).parents[1]
PACKAGE = "micropython"
NAMED_IN = "HIL_MICROPYTHON"
INSTEAD = {"bookworm": "trixie"}
"""Releases of Debian without that package, and the next one."""
ARGUMENTS = 10
"""Of the step: count, count_prev, w_prev, d, a_ref, ka, kb, kj, shift, current_limit."""
RESULTS = 4
"""w, d, i, estimate."""
LIMIT_S = 600.0
"""Wall time of `steps`, which takes 6 s for a million rows."""


def program() -> Path:
    """Return the program; raise Missing with the reason where it cannot be had."""
    named = os.environ.get(NAMED_IN) or shutil.which(PACKAGE)
    if named:
        return Path(named)
    return packages.kept(packages.cache().with_name(PACKAGE), _fetch) / PACKAGE


def needed() -> Path:
    """Return the program; where it cannot be had skip the test, under CI fail it."""
    try:
        return program()
    except Missing as missing:
        wanting(f"NO MICROPYTHON, so the joint on MicroPython is NOT TESTED: {missing}")


# -- Debian's --


def _fetch(scratch: Path) -> None:
    """Unpack the program and the libraries that it wants, loader included: it runs beside those of this machine."""
    files, apt = scratch / "files", _apt(scratch)
    packages.ask("apt-get", *apt, "update")
    said = packages.ask("apt-cache", *apt, "depends", PACKAGE)
    packages.ask("apt-get", *apt, "download", PACKAGE, *re.findall(r"^  Depends: (\S+)", said, re.M), cwd=scratch)
    for archive in scratch.glob("*.deb"):
        packages.unpack(archive, files)
    loader = next(iter(sorted(files.glob("usr/lib/*/ld-linux*.so*"))), None)
    if loader is None:
        raise Missing(f"{PACKAGE}: no loader among {', '.join(each.name for each in scratch.glob('*.deb'))}")
    script = files / PACKAGE
    inside = loader.relative_to(files)
    script.write_text(
        f'#!/bin/sh\nhere=$(dirname "$(readlink -f "$0")")\n'
        f'exec "$here/{inside}" --library-path "$here/{inside.parent}" "$here/usr/bin/{PACKAGE}" "$@"\n'
    )
    script.chmod(0o755)


def _apt(scratch: Path) -> list[str]:
    """Return options with which apt knows a release that has the package, and touches nothing of this machine's."""
    release = _release()
    sources = scratch / "debian.sources"
    sources.write_text(_sources(release).replace(release, INSTEAD.get(release, release)))
    for folder in ("lists", "cache"):
        (scratch / folder / "partial").mkdir(parents=True)
    settings = {
        "Dir::Etc::sourcelist": sources,
        "Dir::Etc::sourceparts": os.devnull,
        "Dir::State::lists": scratch / "lists",
        "Dir::State::status": os.devnull,
        "Dir::Cache": scratch / "cache",
        "APT::Sandbox::User": "root",
        "Acquire::Languages": "none",
    }
    return [word for name, value in settings.items() for word in ("-o", f"{name}={value}")]


def _release() -> str:
    """Return the code name of this machine's Debian."""
    said = Path("/etc/os-release").read_text() if Path("/etc/os-release").exists() else ""
    found = re.search(r"^VERSION_CODENAME=(\w+)$", said, re.M)
    if found is None:
        raise Missing(f"install {PACKAGE}, or name it in HIL_MICROPYTHON: this is no Debian, so nothing was fetched")
    return found[1]


def _sources(release: str) -> str:
    """Return this machine's stanzas that name its release: those of the distribution, and nobody else's."""
    texts = [path.read_text() for path in sorted(Path("/etc/apt").glob("sources.list.d/*.sources"))]
    stanzas = [each for text in texts for each in re.split(r"\n\s*\n", text) if re.search(rf"\b{release}\b", each)]
    if not stanzas:
        raise Missing(f"install {PACKAGE}, or name it in HIL_MICROPYTHON: no *.sources of apt here names {release}")
    return "\n\n".join(stanzas) + "\n"


# -- the step --


def steps(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return w, d, i and estimate of every row, and what each adds to `saturations`, in the order of SIGNALS.

    rows: integers, the ten arguments of the step in their order. The words are Words(16, len(SIGNALS)).
    """
    assert rows.ndim == 2
    assert rows.shape[1] == ARGUMENTS
    table = np.ascontiguousarray(rows, dtype=np.int32)
    assert (table == rows).all()
    command = [needed(), ROOT / "tests" / "on_micropython" / "steps.py"]
    env = os.environ | {"MICROPYPATH": str(ROOT)}
    done = subprocess.run(command, env=env, input=table.tobytes(), capture_output=True, timeout=LIMIT_S, check=False)
    assert done.returncode == 0, done.stderr.decode()
    found = np.frombuffer(done.stdout, dtype=np.int32).reshape(-1, RESULTS + len(SIGNALS))
    assert len(found) == len(rows)
    return found[:, :RESULTS], found[:, RESULTS:]


if __name__ == "__main__":
    try:
        print(program())
    except Missing as why:
        sys.exit(str(why))
