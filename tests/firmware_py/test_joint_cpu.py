"""The joint CPU as a transcript of the bus: what it answers to each frame, and what it never does."""

import ast
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import firmware_py
from dbc.crc import crc16
from firmware_py import joint_cpu
from firmware_py.joint_cpu import A_REF, DW, FAULT, INIT, READY, RUN, SIGNALS, TABLE_CRC
from firmware_py.words import InstrumentedWords
from hil.rig import run_inline

STOP_END, STOP_JOINT_FAULT = 0, 2


def ccitt_false(values):
    """CRC-16/CCITT-FALSE over int16 values, low byte first, bit by bit."""
    register = 0xFFFF
    for value in values:
        for byte in (value % 65536 % 256, value % 65536 // 256):
            for bit in range(8):
                top = (register >> 15) ^ (byte >> (7 - bit) & 1)
                register = (register << 1 & 0xFFFF) ^ (0x1021 if top else 0)
    return register


def as_int16(pattern):
    return (pattern + 0x8000) % 0x10000 - 0x8000


def names(answers):
    return [name for name, _, _ in answers if name not in ("State", "Heartbeat")]


# -- what it is --


@pytest.mark.parametrize("module", ["joint_cpu.py", "words.py"])
def test_module_imports_nothing_and_uses_no_floats(module):
    tree = ast.parse((Path(firmware_py.__file__).parent / module).read_text())
    nodes = list(ast.walk(tree))
    assert not [node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom)]
    assert not [node for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, float)]
    assert not [node for node in nodes if isinstance(node, ast.Div)]


def test_order_of_the_parameter_table():
    assert joint_cpu.PARAMETERS_NAMES == ("KA", "KB", "KJ", "shift", "current_limit")
    assert (joint_cpu.KA, joint_cpu.KB, joint_cpu.KJ, joint_cpu.SHIFT, joint_cpu.CURRENT_LIMIT, TABLE_CRC) == (
        0,
        1,
        2,
        3,
        4,
        5,
    )


def test_filters(bench, codec):
    assert set(bench.cpu.wakes_on) == {codec["Encoder_1"].identifier, codec["Stop"].identifier}
    assert set(bench.cpu.stores) == {codec["AccelRef"].identifier, codec["Parameter_1"].identifier}
    assert bench.cpu.on_start(0) == (0, None, [])


# -- init and ready --


@pytest.mark.parametrize("number", [1, 2, 3])
def test_answers_with_zero_current_after_its_computing_time(make_bench, bus, number):
    bench = make_bench(number)
    answers = bench.encoder(-7, 12345)
    (current,) = [answer for answer in answers if answer[0] == "Current"]
    assert current == ("Current", bus.compute_ns, (0, 0, -7 % 256))
    assert bench.busy_ns == bus.compute_ns
    assert bench.timer_ns is None
    assert bench.cpu.state == INIT


def test_answers_zero_in_ready_too_whatever_the_counter_does(bench):
    bench.set_up()
    assert bench.cpu.state == READY
    for cycle in range(-12, -1):
        assert bench.current(bench.encoder(cycle, 4000 * cycle)) == (0, 0, cycle % 256)


def test_acknowledges_each_parameter_with_the_crc_of_its_table(bench):
    table = [0] * 5
    for cycle, (index, value) in enumerate([(2, -32768), (0, 22938), (4, 16384), (3, 13), (1, -1), (0, 5)]):
        table[index] = value
        bench.send_parameter(index, value)
        answers = bench.encoder(cycle - 50, 0)
        assert answers[0] == ("Acknowledge", bench.cpu.compute_ns, (index, value, 1, ccitt_false(table)))
        assert names(answers) == ["Acknowledge", "Current"]
        assert bench.cpu.state == INIT


def test_one_acknowledgement_for_each_parameter(bench):
    bench.send_parameter(0, 1)
    assert names(bench.encoder(-9, 0)) == ["Acknowledge", "Current"]
    assert names(bench.encoder(-8, 0)) == ["Current"]


def test_right_crc_gives_ready(bench, tables):
    bench.set_up()
    assert bench.cpu.state == READY
    assert tuple(bench.cpu.table) == tables[0]
    assert bench.cpu.fault == joint_cpu.NO_FAULT


@given(table=st.lists(st.integers(-32768, 32767), min_size=5, max_size=5), wrong=st.integers(-32768, 32767))
def test_ready_only_by_the_crc_of_the_table(make_bench, table, wrong):
    bench = make_bench(table=table)
    for index, value in enumerate(table):
        bench.send_parameter(index, value)
        bench.encoder(index - 30, 0)
    bench.send_parameter(TABLE_CRC, wrong)
    bench.encoder(-20, 0)
    right = as_int16(ccitt_false(table))
    if wrong != right:
        assert (bench.cpu.state, bench.cpu.fault) == (INIT, joint_cpu.PARAMETERS)
    bench.send_parameter(TABLE_CRC, right)
    bench.encoder(-19, 0)
    usable = table[3] >= 0 and table[4] != -32768
    expected = (READY, joint_cpu.NO_FAULT) if usable else (FAULT, joint_cpu.PARAMETERS)
    assert (bench.cpu.state, bench.cpu.fault) == expected


@pytest.mark.parametrize("entry", range(TABLE_CRC + 1))
def test_entry_of_another_database_is_not_stored_and_takes_readiness_away(bench, tables, entry):
    """Acknowledge says what stands there, and of which version the joint is."""
    bench.set_up()
    value = [*tables[0], ccitt_false(tables[0])][entry]
    bench.send_parameter(entry, 7, version=2)
    _, _, answer = bench.encoder(-19, 0)[0]
    assert answer == (entry, 7 if entry == TABLE_CRC else value, 1, ccitt_false(tables[0]))
    assert (bench.cpu.state, bench.cpu.fault) == (INIT, joint_cpu.PARAMETERS)
    assert (tuple(bench.cpu.table), bench.cpu.version) == (tables[0], 1)
    bench.send_parameter(TABLE_CRC, as_int16(ccitt_false(tables[0])))
    bench.encoder(-18, 0)
    assert (bench.cpu.state, bench.cpu.fault) == (READY, joint_cpu.NO_FAULT)


def test_board_that_still_runs_stops_the_next_set_up_by_itself(bench, tables):
    """Its rig was killed without a Stop. It acknowledges equal entries, and without references is in fault at once."""
    bench.start()
    drive(bench, 3)
    for index, cycle in enumerate((-60, -59, -58)):
        bench.send_parameter(index, tables[0][index])
        answers = bench.encoder(cycle, 0)
        if "Stop" in names(answers):
            break
    assert "Stop" in names(answers)
    assert bench.cpu.state == FAULT


def test_not_ready_never_runs(bench):
    for cycle in range(-10, 3):
        bench.reference(cycle - 1, 100, 100, 100)
        assert bench.current(bench.encoder(cycle, 0))[:2] == (0, 0)
    assert bench.cpu.state == INIT


def test_new_value_takes_ready_away(bench):
    bench.set_up()
    bench.send_parameter(1, 7)
    bench.encoder(-3, 0)
    bench.reference(-1, 0, 0, 0)
    bench.encoder(0, 0)
    assert bench.cpu.state == INIT


def test_index_beyond_the_table_changes_nothing(bench):
    bench.set_up()
    bench.send_parameter(TABLE_CRC + 1, 7)
    assert names(bench.encoder(-3, 0)) == ["Acknowledge", "Current"]
    assert bench.cpu.state == READY
    assert bench.cpu.table == bench.table


# -- into run --


@pytest.mark.parametrize("number", [1, 2, 3])
@pytest.mark.parametrize("value", [0, 100, -100, 32767, -32768])
def test_first_current_is_the_reference_alone(make_bench, number, value):
    bench = make_bench(number)
    first = [0, 0, 0]
    first[number - 1] = value
    _, _, kj, shift, limit = bench.table
    expected = max(-limit, min(limit, kj * value + (1 << shift >> 1) >> shift))
    assert bench.current(bench.start(first, count=54321)) == (expected, 0, 0)
    assert bench.cpu.state == RUN
    assert bench.timer_ns == 140_000 + 3_500_000


def test_run_begins_at_the_encoder_behind_the_first_reference(bench):
    bench.set_up()
    bench.encoder(-3, 0)
    bench.reference(-3, 0, 0, 0)  # of cycle k: for Encoder k + 1
    assert bench.cpu.state == READY
    bench.encoder(-2, 0)
    assert bench.cpu.state == RUN


@pytest.mark.parametrize("age", [0, 2, 3, 255])
def test_reference_of_another_cycle_does_not_begin_the_run(bench, age):
    bench.set_up()
    bench.reference(10 - age, 0, 0, 0)
    bench.encoder(10, 0)
    assert bench.cpu.state == READY


def test_reference_with_wrong_crc_does_not_begin_the_run(bench):
    bench.set_up()
    bench.reference(-1, 5, 5, 5, corrupt=True)
    bench.encoder(0, 0)
    assert bench.cpu.state == READY


def test_entering_is_bumpless_after_a_moving_set_up(bench):
    bench.set_up()
    for cycle in range(-10, 0):
        bench.encoder(cycle, 700 * cycle)
    bench.reference(-1, 0, 0, 0)
    assert bench.current(bench.encoder(0, 0)) == (0, 0, 0)
    bench.reference(0, 0, 0, 0)
    assert bench.current(bench.encoder(1, 0)) == (0, 0, 1)


# -- run --


def drive(bench, cycles, count=0, reference=(0, 0, 0), first=1):
    """Carry a running joint through whole cycles at one count; return its currents."""
    currents = []
    for cycle in range(first, first + cycles):
        bench.reference(cycle - 1, *reference)
        currents.append(bench.current(bench.encoder(cycle, count)))
    return currents


@pytest.mark.parametrize("number", [1, 2, 3])
def test_takes_its_own_value_of_the_cycle_before(make_bench, number):
    bench = make_bench(number)
    bench.start()
    _, _, kj, shift, _ = bench.table
    for cycle in range(1, 600):  # past two wraps of the cycle counter
        values = [1000 + cycle, 2000 + cycle, 3000 + cycle]
        bench.reference(cycle - 1, *values)
        reference, estimate, echoed = bench.current(bench.encoder(cycle, 0))
        assert echoed == cycle % 256
        assert bench.cpu.a_ref == values[number - 1]
        assert reference == max(-16384, min(16384, (kj * values[number - 1] + (1 << shift >> 1) >> shift) + estimate))
    assert bench.cpu.strikes == bench.cpu.missed_encoders == 0
    assert bench.cpu.state == RUN


@pytest.mark.parametrize("cycle", [254, 255, 256, 257, 512])
def test_cycle_counter_wraps_without_a_miss_or_strike(bench, cycle):
    bench.start()
    drive(bench, cycle)
    assert (bench.cpu.strikes, bench.cpu.missed_encoders, bench.cpu.state) == (0, 0, RUN)


@pytest.mark.parametrize("age", [0, 2, 3, 200])
def test_reference_of_another_cycle_is_a_strike_and_the_old_one_holds(bench, age):
    bench.start((50, 0, 0))
    bench.reference(0, 60, 0, 0)
    bench.encoder(1, 0)
    bench.reference(2 - age, 9999, 0, 0)
    bench.encoder(2, 0)
    assert (bench.cpu.a_ref, bench.cpu.strikes) == (60, 1)
    assert bench.cpu.state == RUN


def test_two_missing_references_hold_and_the_next_one_resets_the_row(bench):
    bench.start((50, 0, 0))
    for first in (1, 4, 7):
        held = bench.cpu.a_ref
        for cycle in (first, first + 1):
            bench.encoder(cycle, 0)
            assert (bench.cpu.state, bench.cpu.a_ref) == (RUN, held)
        bench.reference(first + 1, first, 0, 0)
        bench.encoder(first + 2, 0)
        assert (bench.cpu.state, bench.cpu.a_ref) == (RUN, first)
    assert bench.cpu.strikes == 6


def test_three_missing_references_in_a_row_fault(bench):
    bench.start((50, 0, 0))
    drive(bench, 3)
    for cycle in (4, 5):
        bench.encoder(cycle, 0)
        assert bench.cpu.state == RUN
    answers = bench.encoder(6, 0)
    assert bench.cpu.state == FAULT
    assert bench.cpu.report()["fault"] == "reference lost"
    assert names(answers) == ["Stop", "Current"]
    assert answers[0] == ("Stop", 0, (STOP_JOINT_FAULT,))
    assert bench.current(answers) == (0, 0, 6)
    assert bench.timer_ns is None


def test_reference_with_wrong_crc_is_a_strike_and_counted(bench):
    bench.start((50, 0, 0))
    bench.reference(0, 70, 0, 0, corrupt=True)
    bench.encoder(1, 0)
    assert (bench.cpu.a_ref, bench.cpu.strikes) == (50, 1)
    assert bench.cpu.report()["crc_errors"] == 1


# -- damaged and missing frames --


def test_encoder_with_wrong_crc_is_discarded_and_counted(bench):
    bench.start()
    drive(bench, 3)
    before = bench.timer_ns
    assert bench.encoder(4, 20000, corrupt=True) == []
    assert (bench.busy_ns, bench.timer_ns) == (0, before)
    assert bench.cpu.report()["crc_errors"] == 1
    bench.reference(4, 0, 0, 0)
    assert bench.current(bench.encoder(5, 0)) == (0, 0, 5)
    assert bench.cpu.missed_encoders == 1


def test_parameter_with_wrong_crc_is_discarded_and_counted(bench):
    bench.send_parameter(0, 77, corrupt=True)
    assert names(bench.encoder(-9, 0)) == ["Current"]
    assert bench.cpu.table == [0] * 5
    assert bench.cpu.report()["crc_errors"] == 1


@given(data=st.binary(max_size=8))
def test_arbitrary_bytes_never_move_the_state(make_bench, data):
    bench = make_bench()
    for name in ("AccelRef", "Parameter_1"):
        message = bench.codec[name]
        if message.unpack(data) is None:
            bench.cpu.store(message.identifier, data, 0)
    message = bench.codec["Encoder_1"]
    if message.unpack(data) is None:
        assert bench.cpu.on_frame(message.identifier, data, 0) == (0, None, [])
    bench.encoder(0, 0)
    assert (bench.cpu.state, bench.cpu.table) == (INIT, [0] * 5)


def reference_currents(bench, counts, a_refs):
    """Step through (count, count_prev override) without a bus."""
    step, state = bench.cpu.step, (0, 0, 0)
    results = []
    for (count, count_prev), a_ref in zip(counts, a_refs, strict=True):
        before, w_prev, d = state
        w, d, i, estimate = step(
            bench.cpu.words, count, before if count_prev is None else count_prev, w_prev, d, a_ref, *bench.table
        )
        state = count, w, d
        results.append((i, estimate))
    return results


@pytest.mark.parametrize(("move", "half"), [(21, 10), (20, 10), (-21, -11), (0, 0)])
def test_one_missing_encoder_halves_the_next_difference(make_bench, move, half):
    """Counts at 3, 6, 9; cycle 4 is missing; at cycle 5 the joint has moved on by `move`."""
    bench = make_bench(3)
    bench.start()
    for cycle in (1, 2, 3):
        bench.reference(cycle - 1, 0, 0, 40)
        bench.encoder(cycle, 3 * cycle)
    bench.reference(3, 0, 0, 40)
    bench.reference(4, 0, 0, 40)
    answer = bench.current(bench.encoder(5, 9 + move))
    counts = [(0, None), (3, None), (6, None), (9, None), (9 + move, 9 + move - half)]
    assert answer[:2] == reference_currents(make_bench(3), counts, [0, 40, 40, 40, 40])[-1]
    assert bench.cpu.w_prev == half
    assert (bench.cpu.missed_encoders, bench.cpu.strikes, bench.cpu.state) == (1, 0, RUN)
    bench.reference(5, 0, 0, 40)
    bench.encoder(6, 9 + move + 4)
    assert bench.cpu.w_prev == 4  # the next difference is whole again


def test_half_a_difference_across_the_counters_wrap(make_bench):
    bench = make_bench(1)
    bench.start(count=65530)
    bench.reference(0, 0, 0, 0)
    bench.reference(1, 0, 0, 0)
    bench.encoder(2, 4)  # ten counts on, past 65535
    assert bench.cpu.w_prev == 5


def test_two_missing_encoders_keep_the_speed(make_bench):
    bench = make_bench(1)
    bench.start()
    for cycle in (1, 2, 3):
        bench.reference(cycle - 1, 0, 0, 0)
        bench.encoder(cycle, 5 * cycle)
    bench.reference(5, 0, 0, 0)
    bench.encoder(6, 33)
    assert (bench.cpu.w_prev, bench.cpu.missed_encoders, bench.cpu.state) == (5, 2, RUN)
    bench.reference(6, 0, 0, 0)
    bench.encoder(7, 37)
    assert bench.cpu.w_prev == 4


@pytest.mark.parametrize("missing", [3, 4, 100])
def test_three_missing_encoders_fault_at_the_next_one(bench, missing):
    bench.start()
    drive(bench, 3)
    cycle = 4 + missing
    bench.reference(cycle - 1, 0, 0, 0)
    answers = bench.encoder(cycle, 0)
    assert (bench.cpu.state, bench.cpu.report()["fault"]) == (FAULT, "encoder lost")
    assert names(answers) == ["Stop", "Current"]
    assert bench.current(answers) == (0, 0, cycle)
    assert bench.cpu.missed_encoders == missing


def test_silence_of_the_encoder_faults_by_timer_after_three_periods(bench):
    bench.start((500, 0, 0))
    drive(bench, 3, reference=(500, 0, 0))
    assert 3 * 1_000_000 + 140_000 + 3 * 1_000_000 < bench.timer_ns <= 3 * 1_000_000 + 140_000 + 4 * 1_000_000
    assert bench.cpu.i != 0
    answers = bench.timer()
    assert sorted(answers) == [("Current", 0, (0, 0, 3)), ("Stop", 0, (STOP_JOINT_FAULT,))]
    assert bench.timer_ns is None
    assert (bench.cpu.state, bench.cpu.i, bench.cpu.report()["fault"]) == (FAULT, 0, "encoder lost")


def test_every_encoder_puts_the_timer_off(bench):
    bench.start()
    for cycle in range(1, 10):
        drive(bench, 1, first=cycle)
        assert bench.timer_ns == cycle * 1_000_000 + 140_000 + 3_500_000


def test_fault_lasts(bench):
    bench.start((500, 0, 0))
    bench.timer()
    for cycle in range(9, 14):
        bench.reference(cycle - 1, 500, 500, 500)
        assert bench.current(bench.encoder(cycle, 100 * cycle)) == (0, 0, cycle)
    bench.send_parameter(TABLE_CRC, as_int16(ccitt_false(bench.table)))
    bench.encoder(14, 0)
    assert (bench.cpu.state, bench.cpu.report()["fault"]) == (FAULT, "encoder lost")


# -- parameters and Stop in run --


@pytest.mark.parametrize("index", range(TABLE_CRC + 2))
def test_parameters_are_refused_in_run(bench, tables, index):
    bench.start()
    drive(bench, 2)
    bench.send_parameter(index, 1234, version=7)
    bench.reference(2, 0, 0, 0)
    bench.encoder(3, 0)
    assert (bench.cpu.state, tuple(bench.cpu.table), bench.cpu.version) == (RUN, tables[0], 1)


@pytest.mark.parametrize("reason", [0, 2, 3, 4, 6])
def test_stop_gives_no_current_and_finishes(bench, reason):
    bench.start((500, 0, 0))
    drive(bench, 3, reference=(500, 0, 0))
    assert not bench.cpu.finished
    assert bench.stop(reason, 3_900_000) == [("Current", 0, (0, 0, 3))]
    assert bench.cpu.finished
    assert bench.timer_ns is None
    assert bench.cpu.state == INIT
    assert bench.cpu.report()["fault"] == ("" if reason == STOP_END else "stopped")
    answers = bench.encoder(4, 0)
    assert names(answers) == ["Current"]
    assert bench.current(answers) == (0, 0, 4)


def test_stop_keeps_an_earlier_fault(bench):
    bench.start()
    bench.timer()
    bench.stop(STOP_JOINT_FAULT)
    assert (bench.cpu.state, bench.cpu.report()["fault"]) == (FAULT, "encoder lost")
    assert bench.cpu.finished


def test_stopped_joint_runs_again_only_after_a_set_up(bench):
    """And then as if for the first time: at rest, no disturbance known."""
    first = bench.start((500, 0, 0))
    drive(bench, 5, count=7, reference=(500, 0, 0))
    bench.stop(STOP_END)
    bench.reference(9, 500, 0, 0)
    bench.encoder(10, 0)
    assert bench.cpu.state == INIT
    bench.set_up(20)
    bench.reference(29, 500, 0, 0)
    again = bench.current(bench.encoder(30, 1000))
    assert bench.cpu.state == RUN
    assert again[:2] == bench.current(first)[:2]


def test_row_of_strikes_does_not_reach_into_the_next_run(bench):
    bench.start()
    bench.encoder(1, 0)
    bench.encoder(2, 0)
    bench.stop(STOP_END)
    bench.set_up(20)
    bench.reference(29, 0, 0, 0)
    bench.encoder(30, 0)
    assert bench.cpu.state == RUN
    bench.encoder(31, 0)  # the first strike since a good reference
    assert bench.cpu.state == RUN


# -- State and Heartbeat --


@pytest.mark.parametrize("number", [1, 2, 3])
def test_status_frames_by_turns(make_bench, number):
    bench = make_bench(number)
    bench.start()
    seen = []
    for cycle in range(1, 30):
        bench.reference(cycle - 1, 0, 0, 0)
        answers = bench.encoder(cycle, 0)
        seen += [(cycle, *answer) for answer in answers if answer[0] in ("State", "Heartbeat")]
    turns = [cycle for cycle in range(1, 30) if cycle % 5 == number]
    assert [cycle for cycle, *_ in seen] == turns
    assert [name for _, name, _, _ in seen] == [("State", "Heartbeat")[cycle // 5 % 2] for cycle in turns]
    for _, _, delay_ns, fields in seen:
        assert 140_000 + delay_ns == 1_000_000 - 160_000
        assert fields[0] == RUN


def test_state_says_what_was_counted(bench):
    bench.start((0, 0, 0))
    bench.encoder(1, 0)  # a strike, in this joint's turn
    bench.reference(9, 32767, 0, 0)
    answers = bench.encoder(11, 2000)  # nine encoders missing: fault
    fields = {name: fields for name, _, fields in answers}
    state, fault, saturations, strikes, missed, cycle = fields["State"]
    assert (state, fault, strikes, missed, cycle) == (FAULT, joint_cpu.ENCODER_LOST, bench.cpu.strikes, 9, 11)
    assert saturations == sum(bench.cpu.report()["saturations"].values())


def test_report_counts_saturations_by_signal(bench):
    bench.start((32767, 0, 0))
    drive(bench, 1, count=2000, reference=(32767, 0, 0))
    saturations = bench.cpu.report()["saturations"]
    assert saturations["KB*dw"] == 1
    assert saturations["i"] >= 1
    assert set(saturations) == set(SIGNALS[:A_REF])


# -- a user's own law --


def test_own_law_replaces_control_only(codec, tables, make_bench):
    class Proportional(joint_cpu.JointCPU):
        def control(self, count, a_ref):
            return a_ref - count, 7

    own = make_bench(2)
    own.cpu = Proportional(
        2, own.words, codec, crc16, own.cpu.status, ("AccelRef", 1), own.cpu.period_ns, own.cpu.compute_ns
    )
    assert own.current(own.start((0, 900, 0), count=100)) == (800, 7, 0)
    own.reference(0, 0, 1000, 0)
    assert own.current(own.encoder(1, 100)) == (900, 7, 1)
    assert tuple(own.cpu.table) == tables[1]


# -- head-room --


@pytest.fixture(scope="module")
def paper_run(paper_joint):
    return run_inline(paper_joint)


def replay(bench, frames):
    """Feed a joint the logged Encoder and AccelRef frames; return its Current frames and those of the log."""
    encoder, current, reference = (bench.message(name).identifier for name in ("Encoder", "Current", "AccelRef"))
    bench.set_up()
    bench.reference(-1, 0, 0, 0)
    answered, logged = [], []
    for end_ns, identifier, data, _ in frames:
        if identifier == reference:
            bench.cpu.store(identifier, data, end_ns)
        elif identifier == current:
            logged.append(data)
        elif identifier == encoder:
            _, _, sends = bench.cpu.on_frame(identifier, data, end_ns)
            answered += [sent for _, number, sent in sends if number == current]
    return answered, logged


@pytest.mark.parametrize("number", [1, 2, 3])
def test_nominal_run_leaves_a_factor_of_two_of_room(make_bench, paper_run, number):
    """Printed with -s: the range of every signal."""
    words = InstrumentedWords(16, len(SIGNALS))
    bench = make_bench(number, words)
    answered, logged = replay(bench, paper_run.log.frames)
    assert answered == logged
    assert len(logged) == 1500
    assert words.saturations == [0] * len(SIGNALS)
    assert words.wraps[DW] == 0
    for signal, name in enumerate(SIGNALS[:A_REF]):
        low, high = words.minimum[signal], words.maximum[signal]
        print(f"joint {number} {name:6} {low:>12} {high:>12}")
        room = 16383 << 16 if name == "d" else 16383
        assert max(-low, high) <= room, name
    assert words.multiplications == 3 * 1500
    assert words.additions == 6 * 1500


def test_a_repeated_encoder_is_counted_and_not_answered_twice(bench):
    """CAN may deliver a frame twice (an error at the last bit of EOF); a difference of none is no speed."""
    bench.start()
    drive(bench, 3)
    w, d = bench.cpu.w_prev, bench.cpu.d
    assert bench.encoder(3, 0) == []
    assert (bench.cpu.w_prev, bench.cpu.d) == (w, d)
    assert bench.cpu.report()["repeated_encoders"] == 1
    assert bench.cpu.report()["missed_encoders"] == 0


def test_a_refused_parameter_is_answered_with_what_stands_there(bench, tables):
    bench.start()
    drive(bench, 3)
    bench.send_parameter(0, 1)
    bench.reference(3, 0, 0, 0)
    (answer,) = [fields for name, _, fields in bench.encoder(4, 0) if name == "Acknowledge"]
    assert answer[:2] == (0, tables[bench.number - 1][0])


# -- left out --


def test_joint_that_is_not_set_up_says_stop_when_a_run_is_on(bench):
    """As after a reset in the middle of a run: its current of zero is no answer."""
    bench.reference(40, 7, 7, 7)
    answers = bench.encoder(41, 100)
    assert names(answers) == ["Stop", "Current"]
    assert answers[0] == ("Stop", 0, (STOP_JOINT_FAULT,))
    assert bench.cpu.state == INIT
    assert bench.cpu.report()["fault"] == "node not ready"
    assert names(bench.encoder(42, 100)) == ["Current"]
    bench.set_up()
    assert bench.cpu.report()["fault"] == ""


def test_reference_of_another_run_says_nothing(bench):
    bench.reference(17, 7, 7, 7)
    for cycle in range(20, 300):
        assert names(bench.encoder(cycle, 100)) in (["Current"], ["Current", "State"], ["Current", "Heartbeat"])
    assert bench.cpu.report()["fault"] == ""


def test_stop_forgets_the_reference(bench):
    bench.start((50, 0, 0))
    bench.reference(0, 60, 0, 0)
    bench.stop(1)
    assert "Stop" not in names(bench.encoder(1, 0))
