"""`hil cpu`: what it finds against another engine, listing and source; what it refuses; how a run that stops ends."""

import json
import re
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from hil.errors import ScenarioError
from hil.i8086.show import show_cpu
from hil.i8086.study import study, with_machine_code
from hil.rig import run_inline
from tests.conftest import SHORT

SOURCE = Path(__file__).parents[3] / "firmware_py" / "targets" / "i8086"
CUT = "wire.faults=[{kind='cut off', node='joint1', from_s=0.1}]"
NEVER = "wire.faults=[{kind='cut off', node='joint1', from_s=-0.2}]"


def found_of(*settings: str) -> dict[str, Any]:
    return study(with_machine_code("paper-joint", [*SHORT, *settings])).found


@pytest.fixture(scope="module")
def found() -> dict[str, Any]:
    return found_of("joint.clock_hz=5e6", "joint2.cpu=i8086")


def shown(found: dict[str, Any]) -> list[list[str]]:
    out = StringIO()
    show_cpu(Console(width=80, file=out), found)
    assert max(map(len, out.getvalue().splitlines())) <= 80
    return [line.split() for line in out.getvalue().splitlines()]


def test_an_interrupt_takes_what_another_engine_s_joints_tell(found: dict[str, Any]) -> None:
    outcome = run_inline(with_machine_code("paper-joint", [*SHORT, "joint.clock_hz=5e6"]))
    assert found["frame_log_sha256"] == outcome.log.sha256()
    for joint in found["joints"]:
        told = outcome.reports[f"joint{joint['joint']}"]["clocks"]
        assert joint["interrupt"]["clocks"] == pytest.approx(told)
        assert joint["steps"] == outcome.scenario.cycles


def test_nothing_is_beyond_what_is_declared_and_bounded(found: dict[str, Any]) -> None:
    for joint in found["joints"]:
        assert joint["saturated_steps"] == 0
        for what in ("step", "interrupt"):
            row = joint[what]
            least, most = row["bounds"]
            clocks = row["clocks"]
            assert least <= clocks["least"] < clocks["mean"] < clocks["most"] <= row["straight"] < most
        assert sum(joint["clocks_by_kind"].values()) == pytest.approx(joint["interrupt"]["clocks"]["mean"])


def test_a_limit_that_is_met_takes_more_and_stays_within_the_bounds() -> None:
    (joint, *_) = found_of("joint.limit_A=0.05")["joints"]
    assert joint["saturated_steps"] > 0
    row = joint["interrupt"]
    assert row["straight"] < row["clocks"]["most"] <= row["bounds"][1]
    assert joint["additions"] == {"least": 14, "mean": 14.0, "most": 14}


def labels(listing: str) -> dict[str, int]:
    """Return where each label is: at the next offset of the listing."""
    found, waiting = {}, []
    for line in listing.splitlines():
        text, offset = line[40:], line[7:15].strip()
        waiting += re.findall(r"^(\w+):$", text)
        if offset:
            found |= dict.fromkeys(waiting, int(offset, 16))
            waiting = []
    return found


def test_operations_and_bytes_are_those_of_source_and_listing(found: dict[str, Any]) -> None:
    assert found["law"] == {"multiplications": 3, "additions": 6}
    source, at = (SOURCE / "joint.asm").read_text(), labels((SOURCE / "joint.lst").read_text())
    size = found["bytes"]
    assert (
        size["code"]
        == len((SOURCE / "joint.bin").read_bytes())
        == sum(size[key] for key in ("entries", "interrupt", "step", "saturating"))
    )
    assert (size["entries"], size["interrupt"]) == (at["interrupt"], at["step"] - at["interrupt"])
    assert size["step"] == at["kb_dw_saturates"] - at["step"]
    assert size["data"] == sum(2 * int(words) for words in re.findall(r"resw +(\d+)", source))


def test_what_is_shown_is_what_was_found(found: dict[str, Any]) -> None:
    lines = shown(found)
    joint = found["joints"][1]
    clocks = joint["step"]["clocks"]
    assert [
        *("2", "step", "63", str(clocks["least"]), f"{clocks['mean']:.1f}", str(clocks["most"])),
        *("853", "766", "to", "1237"),
    ] in lines
    assert ["8", "109.6", "141.0", "14.1%", "189.0", "18.9%", "fits", "189.0", "965.0"] in lines
    cost = found["cost"]
    row = cost["newton_euler"][0]
    us = [f"{row['floor_clocks'] / mhz:.0f}" for mhz in (5, 8, 10)]
    times = f"{row['floor_clocks'] / (3 * cost['step']['clocks']):.0f}"
    assert ["Newton-Euler,", "alone", "396", "329", f"{row['floor_clocks']:.0f}", *us, times] in lines
    json.dumps(found, allow_nan=False)


def test_a_run_without_a_step_has_bounds_alone() -> None:
    result = study(with_machine_code("one-joint", ["duration_s=0.2", "trajectory.time_s=0.1", NEVER]))
    assert (result.faults[0]["node"], result.found["cost"]) == ("dsp", None)
    lines = shown(result.found)
    assert ["1", "step", "-", "-", "-", "-", "877", "790", "to", "1261"] in lines
    assert not any("Newton-Euler," in line for line in lines)


@pytest.mark.parametrize(
    ("scenario", "settings", "message"),
    [
        pytest.param("drift", [], "joint1: crystal_ppm = 100 .* leave one of them out", id="crystal"),
        pytest.param("paper-joint", ["joint.word.bits=12"], "joint.word.bits = 12: .* leave them out", id="word"),
        pytest.param("paper-joint", ["joint2.cpu=my:Own"], "joint2: cpu = 'my:Own': .* take cpu = 'python'", id="own"),
        pytest.param("paper-joint", ["joint.compute_s=1e-5"], "compute_s = 1e-05: .* leave compute_s out", id="time"),
        pytest.param("paper-joint", ["joint3.clocks=900"], "joint3.clocks = 900: .* leave clocks out", id="clocks"),
        pytest.param("paper-joint", ["joint.clock_hz=1.1e6"], "raise clock_hz", id="slow"),
        pytest.param("paper-joint", ["joint.clock_hz=4e6"], "one cycle need .* compute faster", id="too slow"),
    ],
)
def test_a_joint_that_cannot_be_of_machine_code_says_why(scenario: str, settings: list[str], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        study(with_machine_code(scenario, settings))


def test_joints_that_say_python_are_of_machine_code_all_the_same() -> None:
    scenario = with_machine_code("paper-joint", ["joint2.cpu=python", "clock.kind=virtual"])
    assert [scenario.cpu(n) for n in (1, 2, 3)] == ["i8086"] * 3


def test_a_run_that_stops_itself_is_shown_and_ends_with_6(hil: Any, short_settings: list[str]) -> None:
    run = hil.run("cpu", "--json", *short_settings, "--set", CUT)
    assert run.returncode == 6
    assert "hil: the run stopped at 0.1" in run.stderr
    steps = [joint["steps"] for joint in json.loads(run.stdout)["joints"]]
    assert 100 <= min(steps) <= max(steps) < 110
