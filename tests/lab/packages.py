"""Debian packages for the lab: some unpacked into the user's cache, some installed where we may.

Nothing is asked of the network that the cache holds. What is unpacked is not installed, so that takes no privilege.
"""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

KERNEL = "linux-image-amd64"
"""The package that depends on the kernel of this Debian."""
INSTALLED = {
    "qemu-system-x86_64": "qemu-system-x86",
    "ip": "iproute2",
    "setpriv": "util-linux",
    "cc": "build-essential",
}
"""Programs that must be on the path, and whose they are."""
PARTS = {
    KERNEL: ["*boot/vmlinuz-*", *(f"*/kernel/{part}/*" for part in ("drivers/net/can", "drivers/virtio", "fs", "net"))]
}
"""What is unpacked of a package, if not everything."""


class Missing(Exception):
    """What the lab needs cannot be had on this machine."""


def cache() -> Path:
    """Return where unpacked packages are kept."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "hil" / "lab"


def ask(*words: str, cwd: Path | None = None) -> str:
    """Run a program of the package manager and return what it says; raise Missing if it fails."""
    if shutil.which(words[0]) is None:
        raise Missing(f"there is no {words[0]} here: the lab is built from Debian packages")
    env = os.environ | {"DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C"}
    done = subprocess.run(
        words, cwd=cwd, env=env, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise Missing(f"{' '.join(words)}: {done.stderr.strip() or f'exit code {done.returncode}'}")
    return done.stdout


def install() -> None:
    """Install the programs that are not here; raise Missing with their packages' names where we may not."""
    needed = [package for program, package in INSTALLED.items() if shutil.which(program) is None]
    if not needed:
        return
    if os.geteuid() != 0:
        raise Missing(f"install these packages: {' '.join(needed)}")
    print(f"lab: installing {' '.join(needed)}", flush=True)
    archives = cache() / "archives"
    (archives / "partial").mkdir(parents=True, exist_ok=True)
    ask("apt-get", "update")
    kept = [f"Dir::Cache::archives={archives}", "APT::Keep-Downloaded-Packages=true", "APT::Sandbox::User=root"]
    options = [word for setting in kept for word in ("-o", setting)]
    ask("apt-get", "install", "--yes", "--no-install-recommends", *options, *needed)


def kernel_package() -> str:
    """Return the package of this Debian's kernel; ask what is new where apt knows of none yet."""
    with suppress(Missing):
        return _depends_on_image()
    if os.geteuid() != 0:
        raise Missing(f"apt knows no {KERNEL}: run apt-get update, on Debian")
    ask("apt-get", "update")
    return _depends_on_image()


def _depends_on_image() -> str:
    said = ask("apt-cache", "depends", KERNEL)
    for line in said.splitlines():
        kind, _, name = line.strip().partition(": ")
        if kind == "Depends" and name.startswith("linux-image-"):
            return name
    raise Missing(f"{KERNEL} depends on no kernel")


def unpacked(package: str, parts: str = "") -> Path:
    """Return the folder with the files of a package, fetched the first time; `parts` names the row of PARTS."""

    def fetch(scratch: Path) -> None:
        print(f"lab: fetching {package}", flush=True)
        _fetch(package, scratch, PARTS.get(parts, ["*"]))

    return kept(cache() / package, fetch)


def kept(folder: Path, make: Callable[[Path], None]) -> Path:
    """Return a folder of the cache, whole; the first time `make` makes it, as `files` in a folder to work in."""
    if not folder.is_dir():
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent) as scratch:
            make(Path(scratch))
            try:
                (Path(scratch) / "files").rename(folder)
            except OSError:
                if not folder.is_dir():  # where it is, somebody else has made it meanwhile
                    raise
    return folder


def _fetch(package: str, scratch: Path, parts: list[str]) -> None:
    """Download a package into a folder and unpack it beside itself, in `files`."""
    ask("apt-get", "-o", "APT::Sandbox::User=root", "download", package, cwd=scratch)
    (archive,) = scratch.glob("*.deb")
    unpack(archive, scratch / "files", parts)


def unpack(archive: Path, files: Path, parts: Sequence[str] = ("*",)) -> None:
    """Unpack parts of a package into a folder."""
    files.mkdir(exist_ok=True)
    with subprocess.Popen(["dpkg-deb", "--fsys-tarfile", archive], stdout=subprocess.PIPE) as reader:
        tar = ["tar", "-x", "-C", str(files), "--no-same-owner", "--wildcards", *parts]
        unpacking = subprocess.run(tar, stdin=reader.stdout, stderr=subprocess.PIPE, text=True, check=False)
    if reader.returncode or unpacking.returncode:
        raise Missing(f"{archive.name} cannot be unpacked: {unpacking.stderr.strip()}")
