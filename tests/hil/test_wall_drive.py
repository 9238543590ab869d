"""Nodes driven by the machine's clock, on a machine that is repeatable: on time, late, frozen, cut off."""

import random
from collections import defaultdict
from itertools import pairwise
from typing import Any

import pytest

from firmware_py.joint_cpu import STOP_JOINT_FAULT
from hil import scenario_file
from hil.rig import run_inline
from hil.scenario import Scenario
from hil.stamps import SystemStamps
from tests.hil.clockwork import BUS_NS, CODEC, WORK_NS, Clockwork
from tests.hil.test_stamps import Clocks

T_NS = 1_000_000
MS = 1_000_000
STOP, SYNC = 0x010, 0x080
SETUP_CYCLES = 60
"""What the set-up needs: the tests are of the run."""


def load(name: str = "paper-joint", **settings: object) -> Scenario:
    wall = {"clock.kind": "wall", "clock.setup_cycles": SETUP_CYCLES, "bus.fidelity": "functional", "duration_s": 0.2}
    given = wall | settings
    return scenario_file.load(name, [f"{key}={value}" for key, value in given.items()])


def data_of(frames: Any) -> dict[int, list[bytes]]:
    found = defaultdict(list)
    for _, identifier, data, *_ in frames:
        found[identifier].append(data)
    return found


def ran(scenario: Scenario, **trouble: Any) -> Clockwork:
    machine = Clockwork(scenario, **trouble)
    machine.run(60.0)
    assert all(process.drive.finished for process in machine.processes.values())
    return machine


def plant(machine: Clockwork) -> dict[str, Any]:
    return machine.drive("plant").node.report()


# -- on time --


@pytest.mark.parametrize("pace", [1.0, 0.25, 0.01])
@pytest.mark.parametrize("name", ["paper-joint", "paper-task", "one-joint"])
def test_on_time_the_payloads_are_those_of_functional(name: str, pace: float) -> None:
    scenario = load(name, **{"clock.pace": pace})
    assert data_of(ran(scenario).witness.log.frames) == data_of(run_inline(scenario).log.frames)


def test_a_period_is_one_period_of_the_clock() -> None:
    """Absolute deadlines: no drift, though each Sync takes the DSP and the bus a while."""
    machine = ran(load(**{"clock.pace": 0.1}))
    syncs = [at_ns for at_ns, identifier, _, _ in machine.sent_ns if identifier == SYNC][-200:]
    assert {after - before for before, after in pairwise(syncs)} == {10 * T_NS}


def test_under_bits_a_current_acts_when_its_frame_came() -> None:
    """Against `functional` with the delays that this machine has: each chain of work and bus, by hand."""
    scenario = load(**{"bus.fidelity": "bits"})
    encoders_ns = [WORK_NS["plant"] + n * BUS_NS for n in (1, 2, 3)]
    delays_ns = [end + WORK_NS[f"joint{n}"] + BUS_NS for n, end in enumerate(encoders_ns, start=1)]
    same = load(**{"bus.action_delay_s": [delay_ns * 1e-9 for delay_ns in delays_ns]})
    assert data_of(ran(scenario).witness.log.frames) == data_of(run_inline(same).log.frames)


def test_states_go_out_before_the_end_of_their_cycle() -> None:
    machine = ran(load())
    assert machine.began_ns is not None
    for at_ns, identifier, data, _ in machine.sent_ns:
        if identifier >= 0x400 and at_ns > machine.began_ns:
            cycle, phase_ns = divmod(at_ns - machine.began_ns, T_NS)
            assert (cycle & 0xFF, phase_ns > 800_000) == (CODEC.by_identifier[identifier].unpack(data)[-1], True)


def test_whoever_comes_late_to_the_set_up_is_waited_for() -> None:
    machine = Clockwork(load(), lose=lambda identifier, _: identifier == 0x122)
    machine.run(1.0)
    assert machine.witness.cycle == -SETUP_CYCLES
    assert machine.witness.missing() == "joint2"


# -- late --


def test_a_deadline_missed_by_less_than_a_period_is_late_and_no_more() -> None:
    machine = ran(load(), frozen={"dsp": [(50 * MS - 100_000, 50 * MS + 400_000)]})
    dsp = machine.drive("dsp").counters()
    assert (dsp["overruns"], dsp["skipped_cycles"]) == (0, 0)
    assert [late_ns for late_ns in dsp["late_ns"] if late_ns > WORK_NS["dsp"]] == [500_000]
    syncs = [at_ns - machine.began_ns for at_ns, identifier, _, _ in machine.sent_ns if identifier == SYNC]
    assert [at_ns for at_ns in syncs if 49 * MS <= at_ns <= 52 * MS] == [49 * MS, 50 * MS + 500_000, 51 * MS, 52 * MS]


@pytest.mark.parametrize("periods", [1, 2])
def test_periods_that_were_missed_are_skipped_and_counted_not_made_up_for(periods: int) -> None:
    machine = ran(load(), frozen={"dsp": [(50 * MS - 100_000, (50 + periods) * MS)]})
    dsp = machine.drive("dsp").counters()
    assert (dsp["overruns"], dsp["skipped_cycles"]) == (1, periods)
    assert machine.witness.figures()["skipped_cycles"] == periods
    syncs = [at_ns - machine.began_ns for at_ns, identifier, _, _ in machine.sent_ns if identifier == SYNC]
    near = [at_ns / MS for at_ns in syncs if 48 * MS <= at_ns <= (53 + periods) * MS]
    assert len(near) == 6
    assert all(after - before > 0.5 for before, after in pairwise(near))
    assert len(plant(machine)["rows"]) == 201
    for n in (1, 2, 3):
        assert machine.drive(f"joint{n}").node.report()["missed_encoders"] == periods
    assert plant(machine)["fault"] == ""


def test_a_dsp_that_is_gone_for_longer_finds_the_arm_braked() -> None:
    machine = ran(load(), frozen={"dsp": [(50 * MS - 100_000, 60 * MS)]})
    assert plant(machine)["fault"] == "no Sync for 3 periods: brakes engaged"
    assert plant(machine)["braked_ns"] == round(52.25 * T_NS)
    stops = [(at_ns - machine.began_ns, name) for at_ns, identifier, _, name in machine.sent_ns if identifier == STOP]
    assert 52.25 * MS < stops[0][0] < 52.5 * MS


def test_all_stamps_set_back_are_found_out() -> None:
    """Not one frame's: a clock that is set back by 50 ms in the middle, as by a time server. Stamps find it out."""
    clocks = Clocks(0)
    stamps = SystemStamps(clocks.monotonic, clocks.system)
    wrong = 0
    for k in range(1000):
        clocks.now_ns += T_NS
        if k == 500:
            clocks.ahead_ns -= 50 * MS
        wrong += abs(stamps.heard(clocks.now_ns + clocks.ahead_ns) - clocks.now_ns) > 100_000
    assert (wrong, stamps.steps) == (0, 1)


def test_a_process_that_was_late_itself_accuses_nobody() -> None:
    """The plant sleeps, and finds three Syncs in its socket."""
    machine = ran(load(), frozen={"plant": [(50 * MS + 300_000, 53 * MS + 200_000)]})
    assert plant(machine)["fault"] != "no Sync for 3 periods: brakes engaged"


@pytest.mark.parametrize("periods", [1, 2])
def test_an_encoder_behind_the_next_sync_has_its_own_turn_and_no_other(periods: int) -> None:
    """The plant sleeps in each of the five turns, and says several Encoders at once; turns by docs/board.md."""
    sleeps = [20, 41, 62, 83, 104]
    naps = [(k * MS + 300_000, (k + periods + 1) * MS) for k in sleeps]
    machine = ran(load(), frozen={"plant": naps})
    assert machine.began_ns is not None
    said: dict[int, dict[int, int]] = defaultdict(dict)
    for at_ns, identifier, data, _ in machine.sent_ns:
        if identifier >= 0x400 and at_ns > machine.began_ns:
            said[identifier][CODEC.by_identifier[identifier].unpack(data)[-1]] = (at_ns - machine.began_ns) // T_NS
    late = {k + each: k + periods + 1 for k in sleeps for each in range(1, periods + 1)}
    for n in (1, 2, 3):
        assert said[0x400 + n] == {k: late.get(k, k) for k in range(n, 200, 10)}
        assert said[0x480 + n] == {k: late.get(k, k) for k in range(n + 5, 200, 10)}


def test_brakes_are_commanded_when_the_process_comes_to_it() -> None:
    """Frozen when its deadline came: the time that is reported is not that of the deadline."""
    machine = ran(load(), deaf={"dsp": [(50 * MS, 10**15)]}, frozen={"plant": [(51 * MS, 70 * MS)]})
    assert plant(machine)["braked_ns"] >= 70 * MS - MS // 2


def test_cycles_that_are_skipped_at_the_end_leave_a_run_that_came_to_its_end() -> None:
    machine = ran(load(), frozen={"dsp": [(199 * MS - 100_000, 200 * MS + 100_000)]})
    assert (machine.drive("dsp").counters()["overruns"], machine.witness.figures()["skipped_cycles"]) == (1, 1)
    assert len(plant(machine)["rows"]) == 201
    end_ns, identifier, data, _ = machine.witness.log.frames[-1]
    assert (end_ns, identifier, data) == (200 * MS, STOP, b"\0")


def test_a_frame_late_by_more_than_a_period_is_shown_so() -> None:
    machine = ran(load(), frozen={"joint2": [(50 * MS, 51 * MS + 900_000)]})
    since = machine.witness.figures()["since_sync"]["Current_2"]
    assert 1.9e-3 < since["max_s"] < 2.2e-3


def test_a_slow_joint_is_late_and_its_current_acts_late() -> None:
    machine = ran(load(), frozen={"joint2": [(50 * MS, 50 * MS + 700_000)]})
    assert plant(machine)["missed_currents"] == {"joint1": 0, "joint2": 0, "joint3": 0}
    expected = data_of(run_inline(load()).log.frames)
    found = data_of(machine.witness.log.frames)
    assert found[0x122][:51] == expected[0x122][:51]
    assert found[0x102] != expected[0x102]
    assert plant(machine)["overdue_currents"] == 1


def test_a_stamp_older_than_the_present_acts_now_and_counts() -> None:
    """A clock that is set back by a second while the frames of a cycle come."""

    def shift(identifier: int, at_ns: int) -> int:
        return -1_000_000_000 if identifier == 0x121 and at_ns % (20 * T_NS) < T_NS else 0

    machine = ran(load(), shift=shift)
    assert machine.drive("plant").counters()["old_stamps"] == 10
    assert plant(machine)["fault"] == ""


# -- lost --

VOICES = {"plant": 0x101, "dsp": SYNC, "joint1": 0x121, "joint2": 0x122, "joint3": 0x123}


@pytest.mark.parametrize("pace", [1.0, 0.02])
@pytest.mark.parametrize("at_us", [0, 70, 150, 280, 333, 400, 480, 900])
@pytest.mark.parametrize("node", [*VOICES, "bus"])
def test_link_lost_brakes_within_three_periods(node: str, at_us: int, pace: float) -> None:
    """Counted from when the first frame was due that did not come, in emulated time; `bus`: nobody hears anybody."""
    stretch = round(1 / pace)
    cut = {name: [((50 * MS + at_us * 1000) * stretch, 10**15)] for name in ([node] if node in VOICES else VOICES)}
    machine = ran(load(**{"clock.pace": pace}), deaf=cut)
    voice = VOICES.get(node, SYNC)
    last_ns = max(at_ns for at_ns, identifier, _, _ in machine.sent_ns if identifier == voice)
    due_ns = (last_ns - machine.began_ns) // stretch + T_NS
    braked_ns = plant(machine)["braked_ns"]
    assert 50 * MS < braked_ns <= due_ns + 3 * T_NS
    assert plant(machine)["rows"]


def test_references_lost_brake_within_three_periods() -> None:
    """The joints' strikes."""
    sent: list[int] = []

    def lose(identifier: int, _data: bytes) -> bool:
        sent.append(identifier)
        return identifier == 0x130 and sent.count(0x130) > 51  # the first is that of cycle -1

    machine = ran(load(), lose=lose)
    due_ns = max(at_ns for at_ns, identifier, _, _ in machine.sent_ns if identifier == 0x130) - machine.began_ns + T_NS
    assert due_ns // T_NS == 50
    assert due_ns < plant(machine)["braked_ns"] <= due_ns + 3 * T_NS
    assert machine.drive("joint1").node.report()["fault"] == "reference lost"


@pytest.mark.parametrize("at_us", range(0, 1000, 100))
@pytest.mark.parametrize("name", ["joint1", "joint3"])
def test_a_joint_that_begins_anew_in_the_run_brakes_it_within_three_periods(name: str, at_us: int) -> None:
    """A board's watchdog, say: it answers at once, with a current of zero, and nobody else would notice."""
    at_ns = 50 * MS + at_us * 1000
    machine = Clockwork(load(), reset={name: at_ns})
    machine.run(60.0)
    assert at_ns < plant(machine)["braked_ns"] <= at_ns + 3 * T_NS
    assert machine.drive(name).node.report()["fault"] in ("node not ready", "stopped")
    stops = [data for _, identifier, data, _ in machine.sent_ns if identifier == STOP]
    assert stops[0] == bytes([STOP_JOINT_FAULT])


@pytest.mark.parametrize("seed", range(8))
def test_frames_that_get_lost_one_by_one_are_counted_and_do_no_harm(seed: int) -> None:
    drawn = random.Random(seed)
    may, lost = [0x101, 0x102, 0x103, 0x121, 0x122, 0x123, 0x130], list[int]()

    def lose(identifier: int, _data: bytes) -> bool:
        if machine.began_ns is None or identifier not in may or drawn.random() > 0.005:
            return False
        lost.append(identifier)
        return True

    machine = Clockwork(load(duration_s=0.5), lose=lose)
    machine.run(60.0)
    assert plant(machine)["fault"] == ""
    missing = machine.witness.figures()["missing_frames"]
    names = {frame.identifier: name for name, frame in CODEC.items()}
    assert lost
    for identifier in set(lost):
        assert missing[names[identifier]] >= lost.count(identifier)


def test_a_sync_that_gets_lost_is_a_cycle_without_encoders() -> None:
    sent: list[int] = []

    def lose(identifier: int, _data: bytes) -> bool:
        sent.append(identifier)
        return identifier == SYNC and sent.count(SYNC) == SETUP_CYCLES + 50

    machine = ran(load(), lose=lose)
    assert machine.witness.figures()["skipped_cycles"] == 1
    assert plant(machine)["fault"] == ""
    assert plant(machine)["missed_currents"] == {"joint1": 1, "joint2": 1, "joint3": 1}
    assert machine.drive("joint1").node.report()["missed_encoders"] == 1
