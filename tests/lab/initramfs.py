"""The initramfs that the lab's kernel starts from: busybox, modules in an order that works, and what to do with them.

Ref: Linux, Documentation/driver-api/early-userspace/buffer-format.rst (the "newc" format of cpio).
Its /init mounts the host's file system read-only, with memory over what must be writable, and leaves the rest to
a script of that system's shell: interfaces up, one command, its exit code through the second serial port.
"""

import lzma
import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOTS = ("virtio_pci", "9pnet_virtio", "9p", "can_raw", "can_bcm", "vcan", "kvaser_pci", "sch_tbf")
"""The modules that are wanted; what they depend on comes before them. sch_tbf: a wire that takes its time."""
MEMORY = ("/tmp", "/run", "/dev/shm")
"""Where the guest has memory of its own instead of the host's folder."""
FOLDER, FILE, DEVICE = 0o040755, 0o100755, 0o020600

INIT = """#!/bin/busybox sh
/bin/busybox --install -s /bin
export PATH=/bin
mount -t proc proc /proc && mount -t sysfs sys /sys && mount -t devtmpfs dev /dev
exec </dev/ttyS0 >/dev/ttyS0 2>&1
hostname lab
stty -onlcr -echo
for module in {modules}; do insmod /modules/$module.ko || echo "lab: $module was not inserted"; done
mount -t 9p -o trans=virtio,version=9p2000.L,ro,msize=524288,cache=loose root /mnt || poweroff -f
mkdir /keep
for path in {kept}; do mkdir -p "/keep$path" && mount -o bind "/mnt$path" "/keep$path"; done
for path in proc sys dev; do mount -o move /$path /mnt/$path; done
mkdir -p /mnt/dev/shm /mnt/dev/pts
mount -t devpts devpts /mnt/dev/pts
for path in {memory}; do mount -t tmpfs tmpfs /mnt$path; done
chmod 1777 /mnt/tmp /mnt/dev/shm
for path in {kept}; do mkdir -p "/mnt$path" && mount -o bind "/keep$path" "/mnt$path"; done
mkdir -p /mnt/run/lab
cp /bin/busybox /second /mnt/run/lab/
mount -t 9p -o trans=virtio,version=9p2000.L,msize=524288 results {results} || poweroff -f
exec switch_root /mnt /bin/sh /run/lab/second
"""

SECOND = """export HOME=/run/lab {environment}
cd {folder}
ip link set lo up
ip link add dev vcan0 type vcan
ip link set vcan0 up
for card in can0 can1; do ip link set $card type can bitrate 1000000 && ip link set $card up; done
{command} </dev/null
code=$?
/run/lab/busybox sync
/run/lab/busybox umount {results}
echo $code >/dev/ttyS1
echo 0 >/proc/sys/kernel/printk
/run/lab/busybox poweroff -f
"""


@dataclass(frozen=True)
class Job:
    """A command for the guest: where, with what, and the only folder into which it may write for good."""

    command: tuple[str, ...]
    folder: Path
    results: Path
    environment: dict[str, str]
    kept: tuple[Path, ...]
    """Folders of the host that the guest must see even if they lie below one of MEMORY."""


def scripts(job: Job, modules: list[str]) -> tuple[str, str]:
    """Return /init and its second half."""
    hidden = {path for path in job.kept if any(path.is_relative_to(memory) for memory in MEMORY)}
    kept = sorted(str(path) for path in hidden if not hidden & set(path.parents))
    first = INIT.format(
        modules=" ".join(modules),
        memory=" ".join(MEMORY),
        kept=shlex.join(kept),
        results=shlex.quote(f"/mnt{job.results}"),
    )
    second = SECOND.format(
        environment=" ".join(f"{name}={shlex.quote(value)}" for name, value in job.environment.items()),
        folder=shlex.quote(str(job.folder)),
        command=shlex.join(job.command),
        results=shlex.quote(str(job.results)),
    )
    return first, second


def find_modules(kernel: Path) -> dict[str, Path]:
    """Return the modules of an unpacked kernel package by name, with underscores."""
    files = [path for path in kernel.rglob("*.ko*") if path.is_file()]
    return {path.name.partition(".")[0].replace("-", "_"): path for path in files}


def contents(module: Path) -> bytes:
    """Return a module as insmod takes it."""
    return lzma.decompress(module.read_bytes()) if module.suffix == ".xz" else module.read_bytes()


def dependencies(module: bytes) -> list[str]:
    """Return the modules that a module says it needs."""
    said = re.search(rb"\0depends=([^\0]*)\0", module)
    names = said.group(1).decode() if said else ""
    return [name.replace("-", "_") for name in names.split(",") if name]


def order(modules: dict[str, Path], roots: tuple[str, ...] = ROOTS) -> list[str]:
    """Return the wanted modules and those that they need, each after what it needs."""
    found: list[str] = []

    def visit(name: str) -> None:
        if name in found:
            return
        if name not in modules:
            raise LookupError(f"the kernel has no module {name}: it has {len(modules)}")
        for needed in dependencies(contents(modules[name])):
            visit(needed)
        found.append(name)

    for root in roots:
        visit(root)
    return found


def entry(name: str, mode: int, data: bytes = b"", device: tuple[int, int] = (0, 0), number: int = 0) -> bytes:
    """Return one member of a cpio archive."""
    fields = (number, mode, 0, 0, 1, 0, len(data), 0, 0, *device, len(name) + 1, 0)
    head = b"070701" + b"".join(b"%08x" % field for field in fields) + name.encode() + b"\0"
    return _padded(head) + _padded(data)


def _padded(data: bytes) -> bytes:
    return data + b"\0" * (-len(data) % 4)


def archive(kernel: Path, busybox: Path, job: Job) -> bytes:
    """Return the initramfs for one job."""
    modules = find_modules(kernel)
    names = order(modules)
    first, second = scripts(job, names)
    members: list[tuple[str, int, bytes]] = [
        *((folder, FOLDER, b"") for folder in ("bin", "dev", "mnt", "modules", "proc", "sys")),
        ("bin/busybox", FILE, busybox.read_bytes()),
        ("init", FILE, first.encode()),
        ("second", FILE, second.encode()),
        *((f"modules/{name}.ko", FILE, contents(modules[name])) for name in names),
    ]
    body = b"".join(entry(name, mode, data, number=k) for k, (name, mode, data) in enumerate(members, 1))
    return body + entry("dev/console", DEVICE, device=(5, 1)) + entry("TRAILER!!!", 0)
