"""A node that nobody hears any more, in virtual time: the brakes are commanded within three periods.

Counted from when the first frame was due that did not come: a period behind the last one of its kind.
"""

import pytest

from dbc.compiler import load_arm
from hil import scenario_file
from hil.assemble import build_nodes
from hil.drive import Direct
from hil.frame_log import FrameLog
from hil.rig import make_kernel, run_inline
from hil.scenario import Scenario
from hil.summary import faults

CODEC = load_arm()
T_NS = 1_000_000
VOICE = {"plant": "Encoder_1", "dsp": "AccelRef", "joint1": "Current_1", "joint2": "Current_2", "joint3": "Current_3"}
ENDS_BY = {
    "plant": ("joint1", "joint fault"),
    "dsp": ("joint", "joint fault"),
    "joint1": ("plant", "current lost"),
    "joint2": ("plant", "current lost"),
    "joint3": ("plant", "current lost"),
}
"""Who says Stop to those that are still on the bus, and why."""


def cut_off(node: str, from_s: float, to_s: float = 1.0) -> Scenario:
    """Return a run with the cable of a node broken from then until then."""
    fault = f'wire.faults=[{{kind = "cut off", node = "{node}", from_s = {from_s}, to_s = {to_s}}}]'
    return scenario_file.load("paper-joint", ["duration_s=0.3", "trajectory.time_s=0.25", fault])


@pytest.mark.parametrize("at_us", [0, 100, 330, 420, 480, 650, 850, 999])
@pytest.mark.parametrize("node", VOICE)
def test_brakes_are_commanded_within_three_periods(node: str, at_us: int) -> None:
    """Not by the rig, which ends with the first Stop: a plant that is cut off never hears it.

    No cut between a frame's acknowledgement and its end, where the receivers have it and the sender (and the log) not.
    """
    scenario = cut_off(node, 0.1 + at_us * 1e-6)
    kernel, log = make_kernel(scenario), FrameLog()
    kernel.watchers.append(log.watch)
    nodes = build_nodes(scenario)
    for each in nodes:
        kernel.join(Direct(each))
    kernel.start()
    kernel.run(110 * T_NS)
    voice = CODEC[VOICE[node]].identifier
    heard = [end_ns for end_ns, identifier, _, _ in log.frames if identifier == voice and end_ns < 102 * T_NS]
    braked_ns = nodes[0].report()["braked_ns"]
    assert 100 * T_NS <= max(heard) + T_NS < braked_ns <= max(heard) + T_NS + 3 * T_NS


@pytest.mark.parametrize("node", VOICE)
def test_the_run_ends_and_says_who_was_lost(node: str) -> None:
    (end,) = faults(run_inline(cut_off(node, 0.1004)))
    who, reason = ENDS_BY[node]
    assert end["node"].startswith(who)
    assert end["reason"] == reason
    assert 0.1 < end["time_s"] < 0.106
    if who == "plant":
        assert end["cause"] == f"no Current of {node} for 3 periods: brakes engaged"


def test_two_currents_that_do_not_come_are_held_over() -> None:
    """The third would have been too many."""
    outcome = run_inline(cut_off("joint2", 0.1, 0.102))
    assert outcome.reports["plant"]["missed_currents"]["joint2"] == 2
    assert faults(outcome) == []


def test_a_node_that_is_back_behind_the_third_is_too_late() -> None:
    outcome = run_inline(cut_off("joint2", 0.1, 0.104))
    assert outcome.reports["plant"]["braked_ns"] == 103 * T_NS
    (end,) = faults(outcome)
    assert end["time_s"] < 0.104
