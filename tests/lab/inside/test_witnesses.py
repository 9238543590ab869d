"""Who has no part in the rig: candump hears what the rig logged, cantools reads it, cansend stops the arm."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cantools
import pytest

from hil.can_node import Place
from hil.can_port import CanPort
from hil.rig import Outcome
from hil.sync_rig import run_on_bus
from tests.lab.inside import kernel, rig, warm
from tests.lab.inside.conftest import ROOT, needs
from tests.lab.inside.test_rig import AT_THE_OTHER, PATIENCE_S, Got, same_as_inline

LIMIT_S = 300.0
SYNC = 0x080

Dump = Callable[[str], Path]


@pytest.fixture
def dumped(tmp_path: Path) -> Callable[[str], object]:
    """Have candump write what it hears, in a with statement; what it wrote is whole behind that."""
    candump = needs(kernel.program, "candump")

    @contextmanager
    def dump(channel: str) -> Iterator[Path]:
        path = tmp_path / "candump.log"
        before = kernel.listeners(channel)
        with path.open("w") as log, subprocess.Popen([candump, "-L", channel], stdout=log) as process:
            try:
                kernel.wait_for(lambda: kernel.listeners(channel) > before, f"candump listens to {channel}")
                yield path
                kernel.wait_for(lambda: " 010#" in path.read_text(), "candump has written Stop")
            finally:
                process.terminate()

    return dump


def decoded(frames: list[tuple[int, bytes]]) -> int:
    """Have cantools decode every frame, for its names and ranges; return how many there are."""
    database = cantools.database.load_file(ROOT / "dbc" / "arm.dbc")
    for identifier, data in frames:
        assert database.decode_message(identifier, data)
    return len(frames)


def out_of_order(logged: Outcome, heard: list[tuple[int, bytes]]) -> int:
    """Assert that both heard the same of every identifier, in order; return how many places of all differ."""
    ours = [(identifier, data) for _, identifier, data, _ in logged.log.frames]
    assert rig.payloads(heard) == rig.payloads(ours)
    return sum(one != other for one, other in zip(ours, heard, strict=True))


@pytest.mark.row("witnesses")
@pytest.mark.usefixtures("nodes")
def test_candump_hears_what_the_rig_logs(pair: tuple[str, str], dumped: Dump, got: Got) -> None:
    """In the order of each identifier: what is sent at once by two CPUs may come to two sockets in two orders."""
    elsewhere = {} if pair[0] == pair[1] else dict.fromkeys(AT_THE_OTHER, pair[1])
    place = Place("socketcan", pair[0], {})
    with dumped(pair[1]) as path:
        outcome = run_on_bus(rig.scenario("paper-joint"), place, elsewhere=elsewhere, patience_s=PATIENCE_S)
    heard = rig.log_of(path)
    places = out_of_order(outcome, heard)
    same_as_inline(outcome, "paper-joint")
    got(
        f"{pair[1]}: candump heard the {len(heard)} frames that the rig logged at {pair[0]}, each identifier in order; "
        f"across identifiers {places} places differ; cantools decoded {decoded(heard)}"
    )


@pytest.mark.row("vcan0")
def test_hil_run_as_a_user_types_it(vcan: str, dumped: Dump, got: Got) -> None:
    """Every process an interpreter of its own; what was sent is judged by what candump heard."""
    words = [word for setting in rig.settings() for word in ("--set", setting)]
    command = [sys.executable, "-m", "hil", "run", "paper-joint", "-i", "socketcan", "-c", vcan, "--json", *words]
    with dumped(vcan) as path:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode == 0, done.stderr
    heard, wanted = rig.payloads(rig.log_of(path)), rig.of(rig.functional("paper-joint"))
    assert heard == wanted
    summary = json.loads(done.stdout)
    assert summary["mode"] == "sync"
    assert rig.comparable(summary) == rig.functional_summary("paper-joint")
    got(
        f"`hil run paper-joint -i socketcan -c {vcan}`, {rig.DURATION_S:g} s: {summary['frames']} frames, sha256 "
        f"{rig.sha256(heard)[:16]}, as inline; the same summary; {summary['startup_s']:.0f} s until cycle 0"
    )


@pytest.mark.row("witnesses")
def test_stop_by_cansend_stops_the_arm(vcan: str, tmp_path: Path, got: Got) -> None:
    """`cansend vcan0 010#01`."""
    cansend = needs(kernel.program, "cansend")
    witness = CanPort("socketcan", vcan, {SYNC})
    words = [word for setting in rig.settings(60.0) for word in ("--set", setting)]
    run = warm.hil(tmp_path, "run", "paper-joint", "-i", "socketcan", "-c", vcan, "--json", *words)
    try:
        while witness.receive(LIMIT_S) != (SYNC, bytes([20])):
            pass
        witness.close()
        nodes = rig.children(run.pid)
        subprocess.run([cansend, vcan, "010#01"], check=True)
        _, complaint = run.communicate(LIMIT_S)
    finally:
        run.kill()
    assert run.returncode == 6, complaint
    assert "operator" in complaint
    assert len(nodes) == 5
    assert not [pid for pid in nodes if Path(f"/proc/{pid}").exists()]
    got(f"`cansend {vcan} 010#01`: exit code {run.returncode}, {complaint.strip().splitlines()[-1]!r}")
