"""Joints of a scenario: how long they compute, by which timer they sample, and what of it is refused."""

import pytest

from hil import scenario_file
from hil.assemble import build_nodes
from hil.bus_rig import for_bus
from hil.constants import worst_case_ends_ns
from hil.drive import Direct
from hil.errors import ScenarioError
from hil.record import to_toml
from hil.rig import make_kernel, run_inline
from tests.conftest import SHORT

REFUSED = {
    "joint.compute_s=0.0001 joint.clock_hz=10e6": r"joint.compute_s = 0.0001 beside clock_hz = 1e\+07: .* leave",
    "joint2.compute_s=0.0001 joint2.clocks=900": r"joint2.compute_s = 0.0001 beside clocks = 900: the comput",
    "joint.clocks=0 joint.clock_hz=8e6": r"joint.clocks = 0: Input should be greater than or equal to 1",
    "joint.clock_hz=0": r"joint.clock_hz = 0: Input should be greater than or equal to 1000",
    "joint.clock_hz=1e6": r"joint1: compute_s = 0.001 is not below clock.period_s = 0.001",
    "joint.clock_hz=2e6": r"frames of one cycle need 1272 us .* leaves 1000 us: raise .* or compute faster",
    "joint1.crystal_ppm=10001": r"joint1.crystal_ppm = 10001: Input should be less than or equal to 10000",
    "joint1.crystal_ppm=fast": r"joint1.crystal_ppm = 'fast': Input should be a valid number",
    "joint2.crystal_ppm=100 clock.kind=sync": r"joint2: crystal_ppm = 100 with clock.kind = 'sync', .* virtual",
    "joint.crystal_ppm=0 clock.kind=wall": r"joint1: crystal_ppm = 0 with clock.kind = 'wall'",
    "joint2.crystal_ppm=100 bus.fidelity=functional": r"bus.fidelity = 'functional': a timer of its own drifts",
    "joint2.crystal_ppm=1 joint.cpu=examples.pd_joint:SpeedDamping": r"crystal_ppm = 1 with cpu = 'examples.pd_",
    "joint2.crystal_phase_s=1e-4": r"joint2.crystal_phase_s without a timer: set joint2.crystal_ppm, too",
    "joint2.crystal_ppm=-100 joint2.crystal_phase_s=0.0011": r"crystal_phase_s 0.0011 s is not below the timer",
    "joint.cpu=i8086 joint.compute_s=0.0001": (
        r"joint1: cpu = 'i8086' with joint.compute_s = 0.0001: .* leave compute_s out, or give it to other joints"
    ),
    "joint3.cpu=i8086 joint3.clocks=900": r"joint3: cpu = 'i8086' with joint3.clocks = 900: .* leave clocks out$",
    "joint2.cpu=i8086 joint.word.bits=12 joint.word.overflow=wrap": (
        r"joint2: cpu = 'i8086' with joint.word.bits = 12, joint.word.overflow = wrap: .* or take cpu = 'python'"
    ),
    "joint2.cpu=i8086 joint2.crystal_ppm=100": r"joint2: crystal_ppm = 100 with cpu = 'i8086': only 'python' has",
    "joint.cpu=i8086 joint.clock_hz=4e6": r"frames of one cycle need .* leaves 1000 us: raise .* or compute faster",
    "joint.cpu=i8086 joint.clock_hz=1e6": r"joint1: compute_s = 0.00112\d+ is not below clock.period_s = 0.001",
    "joint.cpu=i8086 joint.g_rad_s=1000": r"joint.g_rad_s = 1000.0 .* g T = 1.000 must stay below 1",
    "joint1.cpu=i8088": r"joint1.cpu = 'i8088': ModuleNotFoundError: .* write python, i8086, or package.module:Class",
    "joint.crystal_ppm=10000 joint.compute_s=0.000991": r"time 0.000991 s is not below .* period of 0.000990099 s",
}


@pytest.mark.parametrize("settings", REFUSED)
def test_a_joint_that_cannot_be_is_refused_with_the_value_the_limit_and_the_cure(settings: str) -> None:
    with pytest.raises(ScenarioError, match=REFUSED[settings]):
        build_nodes(scenario_file.load("paper-joint", settings.split()))


COMPUTING = {
    "": (125_000, 125_000, 125_000),
    "joint.compute_s=0.0001": (100_000, 100_000, 100_000),
    "joint.clock_hz=5e6": (200_000, 200_000, 200_000),
    "joint.clock_hz=8e6 joint.clocks=808": (101_000, 101_000, 101_000),
    "joint.clock_hz=3e6": (333_333, 333_333, 333_333),
    "joint2.clock_hz=10e6": (125_000, 100_000, 125_000),
    "joint2.clock_hz=10e6 joint2.clocks=716": (125_000, 71_600, 125_000),
    "joint.clock_hz=8e6 joint2.clocks=800": (125_000, 100_000, 125_000),
    "joint.clock_hz=8e6 joint.clocks=1600 joint3.clock_hz=10e6": (200_000, 200_000, 160_000),
    "joint.clock_hz=5e6 joint1.compute_s=0.00001": (10_000, 200_000, 200_000),
    "joint.compute_s=0.00005 joint3.clock_hz=5e6": (50_000, 50_000, 200_000),
    "joint.compute_s=0.00005 joint3.clocks=2000": (50_000, 50_000, 250_000),
}
"""Clocks over Hz, by hand; in ns."""


@pytest.mark.parametrize("settings", COMPUTING)
def test_computing_time_is_clocks_over_hertz_or_what_is_given(settings: str) -> None:
    scenario = scenario_file.load("paper-joint", settings.split())
    assert tuple(scenario.compute_ns(n) for n in (1, 2, 3)) == COMPUTING[settings]
    assert scenario_file.build(scenario_file.parse(to_toml(scenario), "resolved")) == scenario


def test_a_processor_at_8_mhz_makes_the_frames_of_125_us() -> None:
    clocked = scenario_file.load("paper-joint", [*SHORT, "joint.clock_hz=8e6"])
    assert run_inline(clocked).log.sha256() == run_inline(scenario_file.load("paper-joint", SHORT)).log.sha256()


def test_a_slower_processor_queues_its_current_later_by_as_much() -> None:
    """From the end of Encoder_1 to that of Current_1, which nothing holds up, in every cycle of the set-up."""

    def answers(clocks: int) -> list[int]:
        scenario = scenario_file.load("one-joint", ["joint.clock_hz=10e6", f"joint1.clocks={clocks}"])
        kernel, frames = make_kernel(scenario), []
        kernel.watchers.append(lambda *frame: frames.append(frame))
        for node in build_nodes(scenario):
            kernel.join(Direct(node))
        kernel.start()
        kernel.run(-1)
        ends = {kind: [end for end, each, _, _ in frames if each == kind] for kind in (0x101, 0x121)}
        return [current - encoder for encoder, current in zip(ends[0x101], ends[0x121], strict=True)]

    assert [late - early for early, late in zip(answers(500), answers(1200), strict=True)] == [70_000] * 200


def test_the_current_of_a_joint_by_its_own_timer_is_bits_in_the_budget_and_no_promise() -> None:
    """The sum of the longest frames of a cycle, from ARCHITECTURE.md: nothing waits for what is computed."""
    ends = worst_case_ends_ns(
        scenario_file.load("paper-joint", ["joint.crystal_ppm=5", "dsp.compute_s=0", "joint.compute_s=0.0009"])
    )
    assert ends["State"] == 1000 * (65 + 3 * 95 + 3 * 115 + 135 + 135 - 3)


def test_a_joint_by_its_own_timer_is_refused_on_a_bus_without_time() -> None:
    scenario = scenario_file.load("paper-joint", ["joint2.crystal_ppm=100"])
    with pytest.raises(ScenarioError, match=r"joint2: crystal_ppm = 100 with clock.kind = 'sync', bus.fidelity = 'fun"):
        for_bus(scenario)


def test_a_crystal_s_error_is_kept_to_the_part_in_1e9() -> None:
    scenario = scenario_file.load("paper-joint", ["joint.crystal_ppm=0", "joint2.crystal_ppm=-12.3456"])
    assert [scenario.crystal_ppb(n) for n in (1, 2, 3)] == [0, -12346, 0]
