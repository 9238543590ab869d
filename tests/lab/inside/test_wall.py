"""The rig by the machine's clock, dilated as far as the lab needs: payloads, latencies, load, and what may go wrong."""

import json
import os
import re
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from hil import scenario_file
from hil.bus_rig import run_on_bus
from hil.can_node import Place
from hil.can_port import CanPort
from hil.errors import NodeError
from hil.rig import Outcome
from hil.scenario import Scenario
from hil.summary import faults
from hil.wall_summary import real_time
from hil.wire.bits import INTERMISSION_BITS, frame_bits
from tests.hil.frames import standard
from tests.lab.inside import kernel, rig, warm
from tests.lab.inside.conftest import Join, needs
from tests.lab.inside.test_rig import AT_THE_OTHER, Got
from tests.lab.inside.test_trouble import Once

DILATION = 200
"""Seconds of the lab for one of the robot: a period lasts 200 ms, of which a cycle's work takes some 30."""
DURATION_S = 0.1
SHORT_S = 0.06
"""Where something goes wrong in the middle."""
T_NS = 1_000_000
SYNC = 0x080
BITRATE = 1_000_000


def dilated(duration_s: float = DURATION_S, *more: str) -> Scenario:
    """Return paper-joint by the clock, cut."""
    return scenario_file.load(
        "paper-joint", [*rig.settings(duration_s), "clock.kind=wall", f"clock.pace={1 / DILATION}", *more]
    )


def compared(outcome: Outcome) -> str:
    """Assert that nothing was late and the payloads are those of `functional`; return it in a line."""
    wanted, found = rig.of(rig.functional("paper-joint", DURATION_S)), rig.of(outcome)
    same = sum(one == other for key in wanted for one, other in zip(wanted[key], found.get(key, []), strict=False))
    count = sum(map(len, wanted.values()))
    assert found == wanted, f"{same} of {count} payloads are the same"
    assert faults(outcome) == []
    return f"{same} of {count} payloads equal those of functional, sha256 {rig.sha256(found)[:16]}"


def latencies(outcome: Outcome) -> list[str]:
    """Return quantiles in lines, having checked them; overruns first."""
    figures = real_time(outcome)["real_time"]
    assert figures["overruns"] == figures["skipped_cycles"] == figures["foreign_stamps"] == 0
    late = figures["sync_late"]
    assert late["count"] == sum(late["counts"]) == outcome.scenario.cycles
    assert figures["sync_interval"]["p50_s"] == pytest.approx(DILATION * 1e-3, rel=0.01)
    named = {"Sync behind its deadline": late} | {
        f"{name} behind Sync": figures["since_sync"][name] for name in ("Encoder_1", "Current_3", "AccelRef")
    }
    lines = [
        f"time dilated {DILATION} times; overruns 0, skipped cycles 0, steps of the clock {figures['clock_steps']}"
    ]
    for name, found in named.items():
        shown = ", ".join(f"{key.removesuffix('_s')} {found[key] * 1e3:.2f}" for key in found if key in QUANTILES)
        lines.append(f"{name}, ms of wall time: {shown}; histogram {histogram(found)}")
    refused = {line for lines in figures["refused"].values() for line in lines}
    return [*lines, "; ".join(sorted(refused)) or "SCHED_FIFO, mlockall, affinity: all permitted"]


QUANTILES = ("p50_s", "p99_s", "p99.9_s", "max_s")


def histogram(found: dict[str, Any]) -> str:
    """Return the bins that are not empty: from (ms): how many."""
    bins = zip(found["edges_s"], found["counts"], strict=False)
    return " ".join(f"{edge * 1e3:.3g}:{count}" for edge, count in bins if count)


@contextmanager
def busload(channel: str, folder: Path) -> Iterator[Callable[[], tuple[int, int]]]:
    """Have canbusload -e count meanwhile; give what asks for (frames, bits), behind the last frame."""
    canbusload = needs(kernel.program, "canbusload")
    before, path = kernel.listeners(channel), folder / "canbusload.log"
    with path.open("w") as log, subprocess.Popen([canbusload, "-e", f"{channel}@{BITRATE}"], stdout=log) as process:
        try:
            kernel.wait_for(lambda: kernel.listeners(channel) > before, "canbusload listens")

            def counted() -> tuple[int, int]:
                time.sleep(2.5)  # it says what it has counted once a second
                lines = re.findall(rf"{channel}@\d+ +(\d+) +(\d+) ", path.read_text())
                return sum(int(frames) for frames, _ in lines), sum(int(bits) for _, bits in lines)

            yield counted
        finally:
            process.terminate()


@pytest.mark.row("wall")
@pytest.mark.usefixtures("nodes")
def test_dilated_run_on_vcan0(vcan: str, tmp_path: Path, got: Got, report: Callable[..., None]) -> None:
    """canbusload hears set-up and run, as does a socket of ours; each of its seconds has the bits of its frames."""
    ear = CanPort("socketcan", vcan, None)  # its buffer holds all frames of the run
    with busload(vcan, tmp_path) as counted:
        outcome = run_on_bus(dilated(), Place("socketcan", vcan, {}))
        frames, bits = counted()
    heard = list(iter(lambda: ear.receive(0.0), None))
    ear.close()
    got(compared(outcome))
    for line in latencies(outcome):
        got(line)
    ours = sum(frame_bits(identifier, data) + INTERMISSION_BITS for identifier, data in heard)
    got(f"canbusload -e: {frames} frames, {bits} bits; ours: {len(heard)} frames, {ours} bits with intermission")
    assert (frames, bits) == (len(heard), ours)
    run_bits = sum(frame_bits(i, data) + INTERMISSION_BITS for _, i, data, _ in outcome.log.frames)
    a_second = run_bits / outcome.wall_s
    got(f"in the run {a_second:.0f} bits per wall second, {a_second / BITRATE:.2%} of the bus")
    report("wall", real_time(outcome))


@pytest.mark.row("wall")
@pytest.mark.usefixtures("nodes")
def test_dilated_run_at_two_cards(cards: tuple[str, str], got: Got) -> None:
    before = kernel.losses(*cards)
    place, elsewhere = Place("socketcan", cards[0], {}), dict.fromkeys(AT_THE_OTHER, cards[1])
    outcome = run_on_bus(dilated(), place, elsewhere=elsewhere)
    got(compared(outcome))
    for line in latencies(outcome):
        got(line)
    assert kernel.losses(*cards) == before


@pytest.mark.row("wall")
def test_stamps_of_the_controller_are_read_where_there_are_any(vcan: str, join: Join, got: Got) -> None:
    """vcan0 has none: the kernel's own are taken, frame by frame, and that is counted."""
    port = CanPort("socketcan", vcan, {0x121})
    port.stamp(by_controller=True)
    before_ns = time.monotonic_ns()
    join(vcan).send(standard(0x121, 1, 2, 3))
    after_ns = time.monotonic_ns()
    assert port.receive(5.0) == (0x121, b"\1\2\3")
    assert before_ns - T_NS <= port.came_ns <= after_ns + T_NS
    assert port.by_controller is not None
    assert port.by_controller.bare == 1
    port.close()
    got("SO_TIMESTAMPING asked for: vcan0 has no controller, so the kernel's stamp was taken, and counted")


@pytest.mark.row("timing")
def test_responses_by_the_clock(vcan: str, tmp_path: Path, got: Got) -> None:
    """The command, as a user types it; the lab's processes take milliseconds where a board takes 125 us."""
    settings = [f"--set={each}" for each in rig.settings(SHORT_S)]
    words = ("timing", "paper-joint", "-i", "socketcan", "-c", vcan, "--pace", str(1 / DILATION), "--json", *settings)
    out, err = warm.hil(tmp_path, *words).communicate()
    found = json.loads(out)
    cycles = round(SHORT_S / 1e-3)
    assert found["clock"] == "wall", err
    for row in found["messages"]:
        if row["name"].startswith(("Encoder", "Current", "AccelRef")):
            response = row["response"]
            assert response["count"] == sum(response["counts"]) == cycles
            shown = ", ".join(f"{key.removesuffix('_s')} {response[key] * 1e3:.2f}" for key in QUANTILES)
            ratio = row["max_to_bound"]
            got(f"{row['name']}, ms: {shown}; bound {row['response_bound_s'] * 1e3:.3f}, largest / bound {ratio:.0f}")
    for chain in found["chains"]:
        got(f"{chain['name']}: largest {chain['measured']['max_s'] * 1e3:.2f} ms; missed {chain['misses']}")
        assert sum(chain["misses"].values()) == 0


# -- trouble --


def braked(outcome: Outcome, voice: int, got: Got, what: str) -> None:
    """Assert that the brake was commanded within 3 periods of when the first frame was due that did not come."""
    plant = outcome.reports["plant"]
    heard = [t_ns for t_ns, identifier, _, _ in outcome.log.frames if identifier == voice]
    due_ns = heard[-1] // T_NS * T_NS + T_NS
    assert due_ns < plant["braked_ns"] <= due_ns + 3 * T_NS + T_NS // 2
    (end,) = faults(outcome)
    late = (plant["braked_ns"] - due_ns) / T_NS
    said = f"{end['node']}: {end['cause']}"
    got(f"{what}: {plant['fault']}, {late:.2f} periods behind the first that was due; said: {said}")


@pytest.mark.row("wall-trouble")
@pytest.mark.usefixtures("nodes", "lab", "up")
def test_interface_down_and_up_brakes(vcan: str, got: Got) -> None:
    def down_and_up() -> None:
        kernel.set_link(vcan, "down")
        threading.Timer(2.0, kernel.set_link, (vcan, "up")).start()

    outcome = run_on_bus(dilated(SHORT_S), Place("socketcan", vcan, {}), progress=Once(down_and_up))
    braked(outcome, SYNC, got, "interface down, up again after 2 s")
    assert outcome.reports["plant"]["fault"] == "no Sync for 3 periods: brakes engaged"


@pytest.mark.row("wall-trouble")
@pytest.mark.usefixtures("nodes", "lab")
def test_cut_link_brakes(cards: tuple[str, str], got: Got) -> None:
    cut = Once(lambda: kernel.set_link(cards[1], "down"))
    try:
        outcome = run_on_bus(
            dilated(SHORT_S), Place("socketcan", cards[0], {}), elsewhere={"joint1": cards[1]}, progress=cut
        )
    finally:
        kernel.set_link(cards[1], "up")
    braked(outcome, 0x121, got, "link of joint 1 cut")
    assert outcome.reports["plant"]["fault"] == "no Current of joint1 for 3 periods: brakes engaged"


@pytest.mark.row("wall-trouble")
@pytest.mark.usefixtures("nodes")
def test_killed_node_brakes_and_one_that_comes_back_changes_nothing(vcan: str, tmp_path: Path, got: Got) -> None:
    """Joint 2 is somebody else's, so that its end is no error of the rig's own."""
    words = ("node", "joint", "2", "-i", "socketcan", "-c", vcan)
    settings = [f"--set={each}" for each in (*rig.settings(SHORT_S), "clock.kind=wall", f"clock.pace={1 / DILATION}")]
    first = warm.hil(tmp_path, *words, *settings)
    again: list[Any] = []

    def kill_and_restart() -> None:
        first.kill()
        (tmp_path / "again").mkdir()
        again.append(warm.hil(tmp_path / "again", *words, *settings))

    outcome = run_on_bus(
        dilated(SHORT_S), Place("socketcan", vcan, {}), ["joint2"], progress=Once(kill_and_restart), notice=print
    )
    braked(outcome, 0x122, got, "joint 2 killed and restarted")
    assert outcome.reports["plant"]["fault"] == "no Current of joint2 for 3 periods: brakes engaged"
    again[0].kill()
    again[0].wait(60)


@pytest.mark.row("wall-trouble")
def test_a_killed_node_of_the_rig_s_own_is_named(vcan: str, nodes: dict[str, Any], got: Got) -> None:
    kill = Once(lambda: os.kill(nodes["dsp"].pid, signal.SIGKILL))
    with pytest.raises(
        NodeError, match=r"dsp was killed by SIGKILL in the middle of the run; .* Stop with reason 8, current lost"
    ) as caught:
        run_on_bus(dilated(SHORT_S), Place("socketcan", vcan, {}), progress=kill)
    got(f"DSP killed: {caught.value}")
