"""A Linux with SocketCAN, anywhere: Debian's kernel under QEMU, with this machine's file system and Python in it.

`python -m tests.lab.boot` runs the tests of tests/lab/inside there and writes their report, `python -m tests.lab.boot
-- COMMAND...` runs any command. It has vcan0, and two Kvaser PCI cards on one emulated bus, can0 and can1, at 1 Mbit/s.
What it writes is lost, but for the folder of results; it has no network.
"""

import argparse
import os
import platform
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Never

from tests import micropython
from tests.lab import packages, report
from tests.lab.initramfs import Job, archive

ROOT = Path(__file__).parents[2]
TIMEOUT_S = 1200.0
"""Wall time after which QEMU is killed; the tests take some 450 s of one CPU to themselves."""
ACCELERATOR = "tcg,thread=multi"
"""Software: kvm hangs where the host itself is a guest."""
SKIPPED, TIMED_OUT, SILENT = 77, 124, 125
"""Exit codes beside the command's own: no lab can be here; killed; the guest died. `make lab` lets a skip pass."""


def tests(results: Path) -> tuple[str, ...]:
    """Return the command that runs the tests which need SocketCAN."""
    options = ("-p", "no:cacheprovider", "-m", "socketcan", "-rsx", "--durations=5")
    return (sys.executable, "-m", "pytest", *options, f"--junitxml={results / 'junit.xml'}", "tests/lab/inside")


def job(command: tuple[str, ...], results: Path, tools: Path) -> Job:
    """Return what the guest is to do, in this checkout, with this Python and the variables HIL_* of this process."""
    environment = {name: value for name, value in os.environ.items() if name.startswith("HIL_")} | {
        "PATH": f"{Path(sys.executable).parent}:{tools}/usr/bin:/usr/sbin:/usr/bin:/sbin:/bin",
        "PYTHONPATH": str(ROOT),
        "PYTHONDONTWRITEBYTECODE": "1",
        "HIL_LAB_INSIDE": "1",
        "HIL_LAB_CARDS": "can0,can1",
        "HIL_LAB_RESULTS": str(results),
        "LANG": "C.UTF-8",
        "TERM": "dumb",
    }
    python = Path(sys.prefix), Path(sys.base_prefix)
    kept = (ROOT, results, tools, *python, Path(environment.get(micropython.NAMED_IN, ROOT)).parent)
    return Job(command, ROOT, results, environment, kept)


def machine(kernel: Path, initramfs: Path, results: Path, code: Path, accelerator: str = ACCELERATOR) -> list[str]:
    """Return the command line of QEMU; it dies with the thread that starts it."""
    return [
        *("setpriv", "--pdeathsig", "KILL", "qemu-system-x86_64"),
        *("-M", "q35", "-accel", accelerator, "-cpu", "max", "-smp", "2", "-m", "2G"),
        *("-nodefaults", "-display", "none", "-monitor", "none", "-no-reboot", "-net", "none"),
        *("-kernel", str(kernel), "-initrd", str(initramfs)),
        *("-append", "console=ttyS0 quiet panic=-1 mitigations=off"),
        *("-serial", "stdio", "-serial", f"file:{code}"),
        *("-virtfs", _share("root", Path("/")) + ",readonly=on,multidevs=remap"),
        *("-virtfs", _share("results", results)),
        *("-object", "can-bus,id=cable"),
        *("-device", "kvaser_pci,canbus=cable", "-device", "kvaser_pci,canbus=cable"),
    ]


def _share(tag: str, path: Path) -> str:
    quoted = str(path).replace(",", ",,")
    return f"local,path={quoted},mount_tag={tag},security_model=none"


def boot(
    command: tuple[str, ...],
    results: Path = report.RESULTS,
    timeout_s: float = TIMEOUT_S,
    accelerator: str = ACCELERATOR,
) -> int:
    """Run a command in the lab, its output to ours; return its exit code. Raise Missing where there can be no lab."""
    if platform.machine() != "x86_64":
        raise packages.Missing(f"the guest runs this machine's Python, and {platform.machine()} is not x86_64")
    packages.install()
    kernel = packages.unpacked(packages.kernel_package(), parts=packages.KERNEL)
    busybox = packages.unpacked("busybox-static") / "bin" / "busybox"
    tools = packages.unpacked("can-utils")
    results.mkdir(parents=True, exist_ok=True)
    (image,) = kernel.glob("boot/vmlinuz-*")
    with tempfile.TemporaryDirectory() as scratch:
        initramfs, code = Path(scratch, "initramfs"), Path(scratch, "code")
        initramfs.write_bytes(archive(kernel, busybox, job(command, results.resolve(), tools)))
        return run_to_end(machine(image, initramfs, results, code, accelerator), code, timeout_s)


def run_to_end(command: list[str], code: Path, timeout_s: float) -> int:
    """Run QEMU to its end, which is ours at the latest; return the exit code that the guest wrote."""
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL)
    try:
        process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        print(f"lab: not done after {timeout_s:g} s; QEMU was killed", file=sys.stderr)
        return TIMED_OUT
    finally:
        process.kill()
        process.wait()
    said = code.read_text().strip() if code.exists() else ""
    if not said.isdecimal():
        print(f"lab: the guest ended without an exit code (QEMU: {process.returncode})", file=sys.stderr)
        return SILENT
    return int(said)


def reported(run: Callable[[tuple[str, ...]], int], results: Path) -> int:
    """Run the tests and write their report; return an exit code that says whether all was shown."""
    packages.install()
    report.clear(results)
    build_board(results)
    fetch_micropython()
    compile_tests()
    code = run(tests(results))
    return report.main(results) or code


def build_board(results: Path) -> None:
    """Build the joint in C where the tests look for it: a compiler takes a minute in the guest."""
    make = ("make", "--silent", "-C", str(ROOT / "examples" / "joint_c"), f"BUILD={results / 'joint_c'}")
    subprocess.run([*make, f"CANTOOLS={sys.executable} -m cantools"], check=True, stdout=subprocess.DEVNULL)


def fetch_micropython() -> None:
    """Have the guest find MicroPython, for which it has no network; where there is none, its test will say so."""
    with suppress(packages.Missing):
        os.environ[micropython.NAMED_IN] = str(micropython.program())


def compile_tests() -> None:
    """Leave what the tests import as bytecode: the guest may not write it, and compiles fifty times as slowly."""
    collect = (sys.executable, "-m", "pytest", "--collect-only", "tests/lab/inside")
    subprocess.run(collect, cwd=ROOT, env=os.environ | {"PYTHONDONTWRITEBYTECODE": ""}, capture_output=True)


def _terminated(number: int, _frame: object) -> Never:
    raise SystemExit(128 + number)


def main(words: list[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.lab.boot", description=__doc__.splitlines()[0])
    parser.add_argument("--timeout", type=float, default=TIMEOUT_S, help="seconds until QEMU is killed (%(default)g)")
    parser.add_argument("--results", type=Path, default=report.RESULTS, help="the folder that the guest may write into")
    parser.add_argument("--accel", default=ACCELERATOR, help="QEMU's accelerator (%(default)s); kvm where it works")
    parser.add_argument("command", nargs="*", help="after --: what to run inside; default: the tests")
    options = parser.parse_args(words)
    signal.signal(signal.SIGTERM, _terminated)
    results = options.results.resolve()
    run = partial(boot, results=results, timeout_s=options.timeout, accelerator=options.accel)
    try:
        return run(tuple(options.command)) if options.command else reported(run, results)
    except packages.Missing as missing:
        print(f"{'=' * 30} THE LAB WAS SKIPPED {'=' * 30}\n{missing}\n{'=' * 81}", file=sys.stderr)
        return SKIPPED
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
