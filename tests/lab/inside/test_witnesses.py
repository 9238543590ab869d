"""`hil run` as a user types it, with candump as the judge; and a Stop of somebody else's."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from hil.can_port import CanPort
from tests.lab.inside import candump, kernel, rig, warm
from tests.lab.inside.conftest import needs
from tests.lab.inside.test_rig import Got

LIMIT_S = 300.0
SYNC = 0x080


@pytest.mark.row("vcan0")
def test_hil_run_as_a_user_types_it(vcan: str, tmp_path: Path, got: Got) -> None:
    """Every process an interpreter of its own."""
    words = [word for setting in rig.settings() for word in ("--set", setting)]
    command = [sys.executable, "-m", "hil", "run", "paper-joint", "-i", "socketcan", "-c", vcan, "--json", *words]
    with candump.dumped(vcan, tmp_path) as path:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode == 0, done.stderr
    heard, wanted = rig.payloads(candump.frames(path)), rig.of(rig.functional("paper-joint"))
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
    long_s = 30.0  # below 40, from which the plant imports Numba: most of a minute here
    words = [word for setting in rig.settings(long_s) for word in ("--set", setting)]
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
