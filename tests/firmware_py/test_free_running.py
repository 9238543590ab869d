"""The joint CPU by its own timer: what a tick finds, against a loop over instants and against closed forms."""

import random
from fractions import Fraction
from functools import partial
from itertools import pairwise
from math import floor

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_py import joint_cpu
from firmware_py.free_running import FreeRunning, Timer
from firmware_py.joint_cpu import FAULT, INIT, RUN

T_NS, ENCODER_NS = 1_000_000, 140_000
"""The period, and when the bench's Encoder frame ends in it."""


@pytest.fixture(scope="module")
def make_free(make_bench):
    """Return a function (ppm, phase_ns) -> a bench that plays to a joint with such a timer."""
    return lambda ppm=0, phase_ns=300_000: make_bench(
        make_cpu=partial(FreeRunning, crystal_ppb=ppm * 1000, phase_ns=phase_ns)
    )


@pytest.fixture
def free(make_free):
    bench = make_free()
    bench.start(count=1000)
    return bench


def references(bench, *cycles):
    for cycle in cycles:
        bench.reference(cycle, 0, 0, 0)


# -- its timer --


@given(
    period_ns=st.integers(1000, 10**9),
    ppb=st.integers(-10_000_000, 10_000_000),
    start_ns=st.integers(-(10**12), 10**12),
    ticks=st.integers(1, 500),
)
def test_no_rounding_of_the_timer_adds_up(period_ns, ppb, start_ns, ticks):
    timer = Timer(period_ns, ppb)
    timer.set(start_ns)
    found = [timer.next() for _ in range(ticks)]
    exact = Fraction(period_ns) / (1 + Fraction(ppb, 10**9))
    assert found == [start_ns + floor(n * exact) for n in range(1, ticks + 1)]


@pytest.mark.parametrize(("ppm", "phase_ns", "tick_ns"), [(0, 0, 1_000_000), (100, 5, 999_905), (-100, 0, 1_000_100)])
def test_first_encoder_of_the_run_is_answered_at_once_and_sets_the_timer(make_free, make_bench, ppm, phase_ns, tick_ns):
    free, joint = make_free(ppm, phase_ns), make_bench()
    assert free.start((7, 8, 9), count=500) == joint.start((7, 8, 9), count=500)
    assert free.timer_ns == free.cpu.timer_ns == ENCODER_NS + tick_ns


def test_until_the_run_it_is_the_joint_cpu(make_free, make_bench):
    said = []
    for bench in (make_free(1000), make_bench()):
        answers = [bench.encoder(-30, 5), bench.encoder(-29, 6, corrupt=True)]
        bench.send_parameter(1, 7, version=2)
        answers += [bench.encoder(-28, 5), bench.set_up(-27)]
        bench.reference(-9, 1, 2, 3)
        answers += [bench.encoder(cycle, 0) for cycle in (-5, -4, -3)]  # ready, and only old references: a fault
        said.append((answers, bench.cpu.state, bench.cpu.fault, bench.timer_ns))
    assert said[0] == said[1]
    assert said[0][1:] == (FAULT, joint_cpu.REFERENCE_LOST, None)


# -- what a tick finds --


def play(bench, encoder_ends_ns, until_ns):
    """Play Encoder frames and ticks as their instants come, a tick before a frame; return the cycle of each Current."""
    bench.start(count=0)
    cycles = [0]
    frames = list(enumerate(encoder_ends_ns, start=1))
    while frames or bench.cpu.timer_ns < until_ns:
        if frames and frames[0][1] < bench.cpu.timer_ns:
            cycle, end_ns = frames.pop(0)
            references(bench, cycle - 1)
            message = bench.message("Encoder")
            bench._take(bench.cpu.on_frame(message.identifier, message.pack(10 * cycle, cycle & 0xFF), end_ns))
        else:
            cycles.append(bench.current(bench.timer())[2])
    return cycles


def naive(encoder_ends_ns, ticks_ns):
    """Return (what each tick samples, doubled, missed) by looking for the last frame that ended before it."""
    samples = [0]
    for tick_ns in ticks_ns:
        samples.append(sum(end_ns < tick_ns for end_ns in encoder_ends_ns))
    steps = [later - earlier for earlier, later in pairwise(samples)]
    return samples, steps.count(0), sum(step - 1 for step in steps if step > 1)


@settings(max_examples=40, deadline=None)
@given(
    ppm=st.sampled_from([0, 20, -20, 100, -100, 3000, -3000, 10_000, -10_000]),
    phase_ns=st.one_of(st.integers(0, 10_000), st.integers(0, 980_000), st.integers(970_000, 980_000)),
    jitter_ns=st.sampled_from([0, 300, 8_000, 118_000]),
    seed=st.integers(0, 999),
)
def test_samples_are_those_of_a_loop_over_instants(make_free, ppm, phase_ns, jitter_ns, seed):
    chance, cycles = random.Random(seed), 220
    ends_ns = [ENCODER_NS + k * T_NS + chance.randint(0, jitter_ns) for k in range(1, cycles)]
    bench = make_free(ppm, phase_ns)
    found = play(bench, ends_ns, until_ns=cycles * T_NS)
    exact = Fraction(T_NS) / (1 + Fraction(ppm, 10**6))
    ticks_ns = [ENCODER_NS + phase_ns + floor(n * exact) for n in range(1, len(found))]
    samples, doubled, missed = naive(ends_ns, ticks_ns)
    report = bench.cpu.report()
    assert found == samples
    assert (report["doubled_samples"], report["missed_samples"]) == (doubled, missed)
    assert report["beats"] == abs(doubled - missed)
    assert bench.cpu.state == RUN


@pytest.mark.parametrize("ppm", [-10_000, -1000, -100, 0, 100, 1000, 10_000])
@pytest.mark.parametrize("phase_ns", [20_000, 500_000, 960_000])
def test_beats_without_jitter_are_those_of_the_closed_form(make_free, ppm, phase_ns):
    """Tick n is phase + n T / (1 + e) behind Encoder 0: n minus the whole periods in that is how often it slid past."""
    cycles = 1200
    bench = make_free(ppm, phase_ns)
    ticks = len(play(bench, [ENCODER_NS + k * T_NS for k in range(1, cycles)], cycles * T_NS)) - 1
    passed = Fraction(phase_ns, T_NS) + ticks / (1 + Fraction(ppm, 10**6))
    slid = ticks - floor(passed)
    report = bench.cpu.report()
    assert (report["doubled_samples"], report["missed_samples"]) == (max(slid, 0), max(-slid, 0))
    assert report["beats"] == abs(slid)
    assert abs(report["beats"] - abs(ppm) * 1e-6 * cycles) <= 1.0


def test_a_doubled_sample_reads_as_rest_and_one_behind_a_missed_one_as_double_speed(free):
    speeds = []
    for seen, *cycles in ((1, 1), (2, 2), (0,), (4, 3, 4), (5, 5)):  # 40 counts a period
        for cycle in cycles:
            references(free, cycle - 1)
            free.encoder(cycle, 1000 + 40 * cycle)
        answer = free.current(free.timer())
        assert not seen or answer[2] == seen
        speeds.append(free.cpu.w_prev)
    assert speeds == [40, 40, 0, 80, 40]
    report = free.cpu.report()
    assert (report["doubled_samples"], report["missed_samples"], report["strikes"]) == (1, 1, 1)


def test_doubled_sample_before_any_tick_is_that_of_cycle_0(free):
    assert free.current(free.timer())[2] == 0
    assert (free.cpu.w_prev, free.cpu.doubled_samples) == (0, 1)


def test_frames_that_the_bus_lost_are_no_missed_samples_and_no_beat(free):
    for cycle in (1, 2, 4, 5, 7):
        references(free, cycle - 1)
        free.encoder(cycle, 1000)
        free.timer()
        if cycle in (2, 5):
            references(free, cycle)
            free.timer()
    report = free.cpu.report()
    assert (report["missed_encoders"], report["missed_samples"], report["doubled_samples"]) == (2, 0, 2)
    assert (report["beats"], report["strikes"], report["fault"]) == (0, 0, "")


def test_what_is_repeated_or_damaged_is_counted_and_changes_nothing(free):
    references(free, 0)
    free.encoder(1, 1040)
    assert free.encoder(1, 5000) == []
    assert free.encoder(2, 5000, corrupt=True) == []
    assert free.current(free.timer())[2] == 1
    assert free.cpu.w_prev == 40
    report = free.cpu.report()
    assert (report["repeated_encoders"], report["crc_errors"], report["missed_samples"]) == (1, 1, 0)


# -- its references --


def test_it_takes_the_newest_reference_whatever_its_cycle(make_free, make_bench):
    """The currents of the joint CPU that is given the same one, and a count of those overwritten unread."""
    free, joint = make_free(), make_bench()
    for bench in (free, joint):
        bench.start()
    free.reference(0, 5, 0, 0)
    free.reference(1, 120, 0, 0)
    joint.reference(0, 120, 0, 0)
    free.encoder(1, 3)
    assert free.current(free.timer())[:2] == joint.current(joint.encoder(1, 3))[:2]
    report = free.cpu.report()
    assert (report["missed_references"], report["strikes"]) == (1, 0)


def test_the_reference_that_began_the_run_is_not_taken_twice(free):
    free.encoder(1, 1000)
    free.timer()
    assert free.cpu.report()["strikes"] == 1
    assert free.cpu.report()["missed_references"] == 0


def test_three_ticks_in_a_row_without_a_new_reference_are_a_fault(free):
    for cycle, comes in ((1, True), (2, False), (3, False), (4, True), (5, False), (6, False), (7, False)):
        if comes:
            references(free, cycle - 1)
        free.encoder(cycle, 1000)
        answers = free.timer()
        assert free.cpu.state == (FAULT if cycle == 7 else RUN)
    assert [(name, fields) for name, _, fields in answers] == [("Current", (0, 0, 7)), ("Stop", (2,))]
    assert free.cpu.report()["fault"] == "reference lost"
    assert (free.cpu.strikes, free.cpu.finished, free.timer_ns) == (5, True, None)


def test_a_damaged_reference_is_a_strike(free):
    free.reference(0, 9, 9, 9, corrupt=True)
    free.encoder(1, 1000)
    free.timer()
    assert (free.cpu.strikes, free.cpu.crc_errors) == (1, 1)


# -- its watchdog, and what stays as it was --


def test_three_ticks_in_a_row_without_a_new_encoder_are_a_fault(free):
    for tick in range(3):
        references(free, tick)
        assert free.cpu.state == RUN
        answers = free.timer()
    assert [(name, fields) for name, _, fields in answers] == [("Current", (0, 0, 0)), ("Stop", (2,))]
    assert free.cpu.report()["fault"] == "encoder lost"
    assert (free.cpu.finished, free.timer_ns, free.busy_ns) == (True, None, 0)


def test_two_are_none(free):
    for cycle in (1, 2, 3):
        references(free, 3 * cycle - 2)
        free.timer()
        references(free, 3 * cycle - 1)
        free.timer()
        references(free, 3 * cycle)
        free.encoder(cycle, 1000)
        free.timer()
    assert (free.cpu.state, free.cpu.doubled_samples) == (RUN, 6)


def test_stop_ends_it_and_its_timer(free):
    free.encoder(1, 1000)
    assert [(name, fields) for name, _, fields in free.stop(0)] == [("Current", (0, 0, 1))]
    assert (free.cpu.state, free.cpu.finished, free.timer_ns) == (INIT, True, None)


def test_a_frame_that_is_no_stop_leaves_the_timer_alone(free, codec):
    set_ns = free.timer_ns
    free._take(free.cpu.on_frame(codec["Stop"].identifier, b"", 700_000))
    assert (free.timer_ns, free.cpu.state, free.cpu.crc_errors) == (set_ns, RUN, 1)


def test_a_parameter_in_run_is_acknowledged_with_what_stands_there(free, tables):
    free.send_parameter(1, 7)
    name, _, fields = free.encoder(1, 1000)[0]
    assert (name, fields[:2]) == ("Acknowledge", (1, tables[0][1]))


def test_it_speaks_of_itself_in_the_turns_of_the_cycle(make_free, make_bench):
    """Though its samples double: State and Heartbeat as the joint CPU sends them in the same cycles."""
    said = []
    for bench in (make_free(10_000, 1000), make_bench()):
        bench.start()
        heard = []
        for cycle in range(1, 40):
            bench.reference(cycle - 1, 0, 0, 0)
            heard += [answer for answer in bench.encoder(cycle, 0) if answer[0] in ("State", "Heartbeat")]
            bench.timer() if isinstance(bench.cpu, FreeRunning) else None
        said.append(heard)
    assert said[0] == said[1]
    assert len(said[0]) == 8
