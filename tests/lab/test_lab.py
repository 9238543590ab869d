"""The lab without QEMU: what it would boot, fetch and run. With HIL_LAB=1 it boots, too: 15 s each time."""

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from tests.lab import boot, initramfs, packages, report

ROOT = Path(__file__).parents[2]
booted = pytest.mark.skipif(os.environ.get("HIL_LAB") != "1", reason="HIL_LAB=1 boots the lab here; or make lab")
DEPENDS = {
    "virtio": "virtio_ring",
    "virtio_ring": "",
    "virtio_pci": "virtio,virtio_pci_legacy_dev,virtio_ring",
    "virtio_pci_legacy_dev": "",
    "9p": "9pnet,netfs",
    "9pnet": "",
    "9pnet_virtio": "9pnet,virtio,virtio_ring",
    "netfs": "",
    "can": "",
    "can-raw": "can",
    "can-bcm": "can",
    "can-dev": "",
    "vcan": "can-dev",
    "sja1000": "can-dev",
    "kvaser_pci": "sja1000,can-dev",
    "sch_tbf": "",
}


@pytest.fixture
def kernel(tmp_path: Path) -> Path:
    """An unpacked kernel package, as far as the lab looks at it."""
    folder = tmp_path / "lib" / "modules" / "6" / "kernel"
    folder.mkdir(parents=True)
    for name, needs in DEPENDS.items():
        (folder / f"{name}.ko").write_bytes(f"\0license=GPL\0depends={needs}\0name={name}\0".encode())
    return tmp_path


@pytest.fixture
def job() -> initramfs.Job:
    command = ("sh", "-c", "echo 'a b' \"$HOME\"; exit 3")
    kept = (Path("/tmp/wt/build"), Path("/tmp/wt"), Path("/tmpfiles"), Path("/srv"), Path("/run/x y"))
    return initramfs.Job(command, Path("/srv/check out"), Path("/srv/out"), {"HIL_X": "a b"}, kept)


def members(archive: bytes) -> dict[str, bytes]:
    """Return the files of a cpio archive, read as the format's description says."""
    found: dict[str, bytes] = {}
    at = 0
    while True:
        assert archive[at : at + 6] == b"070701"
        fields = [int(archive[at + 6 + 8 * k : at + 14 + 8 * k], 16) for k in range(13)]
        size, name_size = fields[6], fields[11]
        name = archive[at + 110 : at + 110 + name_size - 1].decode()
        begin = (at + 110 + name_size + 3) // 4 * 4
        if name == "TRAILER!!!":
            return found
        found[name] = archive[begin : begin + size]
        at = (begin + size + 3) // 4 * 4


def test_modules_come_after_what_they_need(kernel: Path) -> None:
    modules = initramfs.find_modules(kernel)
    names = initramfs.order(modules)
    assert set(initramfs.ROOTS) <= set(names)
    for k, name in enumerate(names):
        assert set(initramfs.dependencies(modules[name].read_bytes())) <= set(names[:k])
    assert names == initramfs.order(dict(reversed(modules.items())))


def test_a_missing_module_is_named(kernel: Path) -> None:
    modules = initramfs.find_modules(kernel)
    del modules["sja1000"]
    with pytest.raises(LookupError, match="no module sja1000"):
        initramfs.order(modules)


def test_the_initramfs_holds_what_init_uses(kernel: Path, job: initramfs.Job) -> None:
    busybox = kernel / "busybox"
    busybox.write_bytes(b"ELF")
    files = members(initramfs.archive(kernel, busybox, job))
    inserted = re.findall(r"^for module in (.*?);", files["init"].decode(), re.M)[0].split()
    assert {f"modules/{name}.ko" for name in inserted} == {name for name in files if name.startswith("modules/")}
    assert files["bin/busybox"] == b"ELF"
    assert {"dev", "dev/console", "mnt", "proc", "sys"} <= files.keys()


def test_the_scripts_are_a_shells_and_keep_every_word(job: initramfs.Job) -> None:
    for script in initramfs.scripts(job, ["can"]):
        subprocess.run(["sh", "-n"], input=script, text=True, check=True)
    first, second = initramfs.scripts(job, ["can"])
    lines = [shlex.split(line) for line in second.splitlines() if not line.startswith("for")]
    assert [*job.command, "</dev/null"] in lines
    assert ["cd", "/srv/check out"] in lines
    assert "HIL_X=a b" in lines[0]
    assert first.count("for path in '/run/x y' /tmp/wt; do") == 2


def test_the_guest_reads_everything_and_writes_only_results() -> None:
    words = boot.machine(Path("vmlinuz"), Path("initramfs"), Path("/a,b"), Path("code"))
    shares = [words[k + 1] for k, word in enumerate(words) if word == "-virtfs"]
    assert [("readonly=on" in share, "path=/a,,b," in share) for share in shares] == [(True, False), (False, True)]
    assert words.count("kvaser_pci,canbus=cable") == 2
    assert "none" in words[words.index("-net") :]


@pytest.mark.parametrize(("script", "code"), [("echo 3 >code", 3), ("echo 0 >code", 0), ("true", boot.SILENT)])
def test_the_exit_code_is_the_guests(script: str, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert boot.run_to_end(["sh", "-c", script], tmp_path / "code", 20) == code


def test_what_takes_too_long_is_killed(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    began = time.monotonic()
    assert boot.run_to_end(["sleep", "60"], tmp_path / "code", 0.1) == boot.TIMED_OUT
    assert time.monotonic() - began < 30
    assert "not done after 0.1 s" in capfd.readouterr().err


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="no setpriv: util-linux")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_nothing_is_left_when_the_lab_is_killed(number: int, tmp_path: Path, children_of: Any) -> None:
    machine = boot.machine(Path("k"), Path("i"), tmp_path, tmp_path / "code")
    stand_in = [*machine[: machine.index("qemu-system-x86_64")], "sleep", "60"]
    source = f"from pathlib import Path; from tests.lab.boot import run_to_end; run_to_end({stand_in}, Path('x'), 60)"
    with subprocess.Popen([sys.executable, "-c", source], cwd=ROOT, stderr=subprocess.DEVNULL) as lab:
        while not (children := children_of(lab.pid)) or Path(f"/proc/{children[0]}/comm").read_text() != "sleep\n":
            time.sleep(0.01)
        lab.send_signal(number)
        lab.wait(20)
    deadline = time.monotonic() + 20
    while alive(children[0]):
        assert time.monotonic() < deadline
        time.sleep(0.01)


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_without_privilege_the_missing_packages_are_named(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    assert boot.main([]) == boot.SKIPPED
    said = capfd.readouterr().err
    assert "THE LAB WAS SKIPPED" in said
    assert "install these packages: qemu-system-x86 iproute2 util-linux build-essential" in said


def test_the_kernel_is_the_one_that_debian_means(monkeypatch: pytest.MonkeyPatch) -> None:
    said = "linux-image-amd64\n  Depends: linux-image-6.1.0-1-amd64\n  Suggests: linux-image-9-amd64\n"
    monkeypatch.setattr(packages, "ask", lambda *_words: said)
    assert packages.kernel_package() == "linux-image-6.1.0-1-amd64"


def test_what_is_cached_is_not_fetched_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fetched = []

    def fetch(package: str, scratch: Path, parts: list[str]) -> None:
        fetched.append((package, parts))
        (scratch / "files").mkdir()

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(packages, "_fetch", fetch)
    assert packages.unpacked("can-utils") == packages.unpacked("can-utils") == tmp_path / "hil" / "lab" / "can-utils"
    assert fetched == [("can-utils", ["*"])]


def test_what_somebody_else_has_made_meanwhile_is_taken(tmp_path: Path) -> None:
    def make(scratch: Path) -> None:
        for folder in (tmp_path / "made", scratch / "files"):
            folder.mkdir()
            (folder / "file").write_text(folder.name)

    assert (packages.kept(tmp_path / "made", make) / "file").read_text() == "made"
    assert [path.name for path in tmp_path.iterdir()] == ["made"]


def test_what_cannot_be_fetched_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(packages, "ask", lambda *_words, **_: (_ for _ in ()).throw(packages.Missing("no network")))
    with pytest.raises(packages.Missing, match="no network"):
        packages.unpacked("can-utils")
    assert list((tmp_path / "hil" / "lab").iterdir()) == []


def test_the_report_has_a_row_for_each_thing_to_show(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for name, passed in (("vcan0-a", True), ("vcan0-b", False), ("cards-a", True), ("own-a", True)):
        row = {"row": name.partition("-")[0], "got": [f"{name} | 3 frames"], "passed": passed}
        (tmp_path / f"row-{name}.json").write_text(json.dumps(row))
    assert report.main(tmp_path) == 1
    found = dict(zip([*report.ROWS, "own"], report.rows(tmp_path), strict=True))
    assert {name: row.passed for name, row in found.items() if row.got} == {"vcan0": False, "cards": True, "own": True}
    assert found["burst"].passed is None
    lines = (tmp_path / "report.md").read_text().splitlines()
    assert len(lines) == 6 + len(found)
    assert lines[-1] == "The tests did not come to their end."
    assert "vcan0-a \\| 3 frames<br>vcan0-b \\| 3 frames | FAILED |" in lines[4]
    assert "NOT SHOWN" in capfd.readouterr().out
    report.clear(tmp_path)
    assert not any(row.got for row in report.rows(tmp_path))


def test_what_is_shown_and_a_good_exit_make_a_good_exit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(_command: tuple[str, ...]) -> int:
        for name in report.ROWS:
            (tmp_path / f"row-{name}.json").write_text(json.dumps({"row": name, "got": [], "passed": True}))
        return 3

    monkeypatch.setattr(packages, "install", lambda: None)
    monkeypatch.setattr(boot, "build_board", lambda _results: None)
    monkeypatch.setattr(boot, "fetch_micropython", lambda: None)
    monkeypatch.setattr(boot, "compile_tests", lambda: None)
    assert boot.reported(run, tmp_path) == 3
    assert boot.reported(lambda command: run(command) - 3, tmp_path) == 0
    assert boot.reported(lambda _command: 0, tmp_path) == 1


@booted
def test_a_command_of_the_readme_runs_in_the_lab() -> None:
    (command,) = re.findall(r"^```sh lab\n(.*?)^```", (ROOT / "README.md").read_text(), re.M | re.S)
    words = shlex.split(command, comments=True)
    run = subprocess.run([sys.executable, *words[1:]], cwd=ROOT, capture_output=True, text=True, timeout=600)
    if run.returncode == boot.SKIPPED:
        pytest.skip(run.stderr)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "bitrate 1000000" in run.stdout


@booted
def test_the_lab_tells_how_its_command_ended(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    script = f"echo \"$HIL_LAB_INSIDE 'x  y'\"; echo kept >{tmp_path}/file; touch {ROOT}/file || exit 7"
    try:
        assert boot.boot(("sh", "-c", script), tmp_path, 600) == 7
    except packages.Missing as missing:
        pytest.skip(str(missing))
    assert "1 'x  y'\n" in capfd.readouterr().out
    assert (tmp_path / "file").read_text() == "kept\n"
