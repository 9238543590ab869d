"""Joints of machine code in the rig: the Python joints' frames, given the clocks that the machine code took."""

import json
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest

from firmware_py.joint_cpu import JointCPU
from hil.frame_log import FrameLog
from hil.i8086 import joint as joint_module
from hil.i8086.interpreted_board import InterpretedBoard
from hil.i8086.joint import Joint8086
from hil.node import Node
from hil.processes import run_processes
from hil.rig import Outcome, directly, run_inline
from hil.scenario_file import load
from hil.wire.bits import INTERMISSION_BITS, frame_bits
from hil.wire.kernel import Kernel
from tests.conftest import SHORT

SCENARIOS = ("paper-joint", "paper-task", "load-step")
Trace = dict[str, list[int]]


class Recorded:
    """Notes how long every step of the joints took, ns."""

    def __init__(self) -> None:
        self.trace: Trace = {}

    def seat(self, kernel: Kernel, node: Node) -> None:
        if isinstance(node, Joint8086):
            step, kept = node.step, self.trace.setdefault(node.name, [])

            def noted(*arguments: Any) -> tuple[int, ...]:
                answer = step(*arguments)
                kept.append(node.compute_ns)
                return answer

            node.step = noted
        directly(kernel, node)


def replayed(trace: Trace) -> Callable[[Kernel, Node], None]:
    """Return a seat that gives Python joints these computing times, step by step."""

    def seat(kernel: Kernel, node: Node) -> None:
        if isinstance(node, JointCPU):
            step, times = node.step, iter(trace[node.name])

            def timed(*arguments: Any) -> Any:
                node.compute_ns = next(times)
                return step(*arguments)

            node.step = timed
        directly(kernel, node)

    return seat


def same(one: FrameLog, other: FrameLog) -> bool:
    return one.sha256() == other.sha256()


def recorded(name: str, *settings: str) -> tuple[Outcome, Trace]:
    recorder = Recorded()
    return run_inline(load(name, ["joint.cpu=i8086", *settings]), seat=recorder.seat), recorder.trace


@pytest.mark.parametrize("clock_hz", [5e6, 8e6, 10e6])
@pytest.mark.parametrize("name", SCENARIOS)
def test_frames_are_the_python_joints_given_the_clocks(name: str, clock_hz: float) -> None:
    clock = f"joint.clock_hz={clock_hz:g}"
    machine, trace = recorded(name, clock)
    assert [len(times) for times in trace.values()] == [machine.scenario.cycles] * 3
    # until the first step, a joint declares what its longest straight line takes
    declared = [f"joint{n}.compute_s={machine.scenario.compute_ns(n) / 1e9}" for n in (1, 2, 3)]
    python = load(name, declared)
    assert same(machine.log, run_inline(python, seat=replayed(trace)).log)
    for number, times in enumerate(trace.values(), 1):
        least_ns, most_ns = machine.scenario.least_compute_ns(number), machine.scenario.compute_ns(number)
        assert least_ns <= min(times) < max(times) <= most_ns
    if clock_hz == 5e6:  # where the time shows: at 8 MHz no Current finds the bus free, below
        assert not same(machine.log, run_inline(load(name, ["joint.clock_hz=5e6"])).log)
        assert not same(machine.log, run_inline(python).log)


@pytest.mark.parametrize(("clock_hz", "busy"), [(8e6, {1, 2, 3}), (5e6, {2, 3})])
def test_which_joints_have_computed_while_the_bus_is_busy(clock_hz: float, busy: set[int]) -> None:
    """Their Currents follow the frame before as soon as they may: with Encoder frames, or the Current of another."""
    outcome = run_inline(load("paper-joint", [*SHORT, "joint.cpu=i8086", f"joint.clock_hz={clock_hz:g}"]))
    bit_ns, free = outcome.scenario.bit_ns, set()
    for before, frame in pairwise(outcome.log.frames):
        began_ns = frame[0] - frame_bits(frame[1], frame[2]) * bit_ns
        if frame[1] in (0x121, 0x122, 0x123) and began_ns > before[0] + INTERMISSION_BITS * bit_ns:
            free.add(frame[1] - 0x120)
    assert free == {1, 2, 3} - busy


def test_processes_make_the_same_frames() -> None:
    scenario = load("paper-joint", [*SHORT, "joint.cpu=i8086", "joint.clock_hz=5e6"])
    inline, processes = run_inline(scenario), run_processes(scenario, "arm")
    assert same(inline.log, processes.log)
    assert inline.reports["joint2"]["clocks"] == processes.reports["joint2"]["clocks"]


def test_one_joint_may_be_of_machine_code_among_others() -> None:
    settings = [*SHORT, "joint.clock_hz=5e6"]
    mixed = run_inline(load("paper-joint", [*settings, "joint2.cpu=i8086"]))
    assert [name for name, report in mixed.reports.items() if "clocks" in report] == ["joint2"]
    clocks = mixed.reports["joint2"]["clocks"]
    assert 1000 < clocks["least"] < clocks["mean"] < clocks["most"]


def test_the_summary_has_the_clocks_of_each_joint_of_machine_code(hil: Any) -> None:
    words = [word for setting in (*SHORT, "joint2.cpu=i8086", "joint.clock_hz=5e6") for word in ("--set", setting)]
    (found,) = json.loads(hil.run("run", "--inline", "--json", *words).stdout)["clocks"].items()
    name, clocks = found
    assert (name, clocks["clock_hz"]) == ("joint2", 5e6)
    told = hil.run("run", "--inline", *words).stdout
    least, most, mean = clocks["least"], clocks["most"], clocks["mean"]
    us = f"{least / 5:.1f} to {most / 5:.1f} us at 5 MHz"
    assert f"joint2, an 8086: {least} to {most} clocks an interrupt, {mean:.1f} in the mean: {us}\n" in told


def test_hil_timing_says_what_its_bounds_leave_out(hil: Any) -> None:
    """1488 clocks over all paths of joint 2 beside the 1104 declared (docs/cpu.md): 384 clocks."""
    words = [word for setting in (*SHORT, "joint2.cpu=i8086", "joint.clock_hz=5e6") for word in ("--set", setting)]
    assert "where it takes longer: joint2 up to 76.8 us\n" in hil.run("timing", "paper-joint", "--bus", *words).stdout
    assert (
        json.loads(hil.run("timing", "paper-joint", "--bus", "--json", *words[:-4]).stdout)["beyond_declared_s"] == {}
    )


def test_without_unicorn_the_frames_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = load("paper-joint", [*SHORT, "joint.cpu=i8086", "joint.clock_hz=5e6"])
    fast = run_inline(scenario)

    def not_installed() -> None:
        raise ImportError

    monkeypatch.setattr(joint_module, "UnicornBoard", not_installed)
    assert isinstance(joint_module.make_board(), InterpretedBoard)
    slow = run_inline(scenario)
    assert same(fast.log, slow.log)
    assert fast.reports == slow.reports


def test_time_passes_as_counted() -> None:
    """The Current is queued behind its Encoder's end by the clocks over the clock."""
    slow_dsp = "dsp.compute_s=0.0005"  # so that its AccelRef leaves the bus free
    outcome = run_inline(load("one-joint", ["joint.cpu=i8086", "joint.clock_hz=5e6", slow_dsp]))
    encoder = next(frame for frame in outcome.log.frames if frame[1] == 0x101)
    current = next(frame for frame in outcome.log.frames if frame[1] == 0x121)
    began_ns = current[0] - frame_bits(current[1], current[2]) * outcome.scenario.bit_ns
    clocks = (began_ns - encoder[0]) * 5e6 / 1e9
    assert clocks == round(clocks)
    assert outcome.reports["joint1"]["clocks"]["least"] <= clocks <= outcome.reports["joint1"]["clocks"]["most"]
