"""State and Heartbeat: whose turn it is, what they say, and that none is ever queued in the past."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dbc.compiler import load_arm
from dbc.status import Status
from hil.assemble import build_nodes
from hil.constants import tail_ns
from hil.scenario_file import load
from hil.wire.bits import INTERMISSION_BITS, worst_case_bits

CODEC = load_arm()
T_NS, TAIL_NS, NODES = 1_000_000, 160_000, 5
NUMBERS = {0: 0, 1: 1, 2: 2, 3: 3, 7: 4}
"""Turn of each node by the number in its frames' names."""

COUNTERS = (0, 0, 0, 0, 0, 1)


def make(number):
    return Status(CODEC, number, NUMBERS[number], NODES, T_NS, TAIL_NS)


@pytest.mark.parametrize("number", NUMBERS)
@given(cycle=st.integers(-1000, 100_000), inside_ns=st.integers(0, T_NS - TAIL_NS))
def test_node_k_mod_n_sends_in_cycle_k_at_the_tail(number, cycle, inside_ns):
    now_ns = cycle * T_NS + inside_ns
    sends = make(number).sends(now_ns, *COUNTERS)
    assert len(sends) == (cycle % NODES == NUMBERS[number])
    for delay_ns, identifier, data in sends:
        assert now_ns + delay_ns == (cycle + 1) * T_NS - TAIL_NS
        kind = ("State", "Heartbeat")[cycle // NODES % 2]
        assert CODEC.by_identifier[identifier].name == f"{kind}_{number}"
        assert CODEC.by_identifier[identifier].unpack(data)[-1] == cycle % 256


@given(inside_ns=st.integers(T_NS - TAIL_NS, T_NS - 1))
def test_node_that_is_late_never_queues_in_the_past(inside_ns):
    for delay_ns, _, _ in make(1).sends(T_NS + inside_ns, *COUNTERS):
        assert delay_ns >= 0


@pytest.mark.parametrize("first", [-10, 0, 7, 250])
def test_each_cycle_has_one_sender_and_each_node_alternates(first):
    nodes = [make(number) for number in NUMBERS]
    names = []
    for cycle in range(first, first + 4 * NODES):
        sends = [send for node in nodes for send in node.sends(cycle * T_NS, *COUNTERS)]
        assert len(sends) == 1
        names.append(CODEC.by_identifier[sends[0][1]].name)
    assert len(set(names)) == 2 * NODES
    assert names[: 2 * NODES] == names[2 * NODES :]


def test_state_says_everything_it_is_told():
    (sent,) = make(0).sends(0, 2, 3, 1000, 20, 30, 9)
    assert CODEC["State_0"].unpack(sent[2]) == (2, 3, 1000, 20, 30, 0)


def test_heartbeat_counts_the_cycles_it_has_seen():
    node = make(3)
    for cycle in range(8):
        assert len(node.sends(cycle * T_NS, 2, 0, 0, 0, 0, 9)) == (cycle == 3)
    (sent,) = node.sends(8 * T_NS, 2, 0, 0, 0, 0, 9)
    assert CODEC["Heartbeat_3"].unpack(sent[2]) == (2, 9, 9, 8)


@pytest.mark.parametrize(
    ("counters", "shown"),
    [((65535, 255, 255), (65535, 255, 255)), ((65536, 256, 256), (65535, 255, 255)), ((10**9,) * 3, (65535, 255, 255))],
)
def test_counters_stop_at_their_top(counters, shown):
    (sent,) = make(1).sends(T_NS, 2, 0, *counters, 1)
    assert CODEC["State_1"].unpack(sent[2])[2:5] == shown


def test_cycle_count_wraps_at_32_bits():
    node = make(1)
    node.cycles = 2**32 - 1
    (sent,) = node.sends(6 * T_NS, 2, 0, 0, 0, 0, 1)
    assert CODEC["Heartbeat_1"].unpack(sent[2])[2] == 0


def test_tail_is_160_us_and_lets_the_longest_frame_end_in_its_cycle():
    scenario = load("paper-joint")
    assert tail_ns(scenario) == TAIL_NS
    assert (worst_case_bits(8) + INTERMISSION_BITS) * scenario.bit_ns < TAIL_NS


def test_rig_gives_every_node_a_turn_of_its_own():
    nodes = build_nodes(load("paper-joint"))
    assert {node.name: node.status.turn for node in nodes} == {
        "plant": 0,
        "joint1": 1,
        "joint2": 2,
        "joint3": 3,
        "dsp": 4,
    }
    assert {node.status.turns for node in nodes} == {NODES}
