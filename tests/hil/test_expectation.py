"""What a node hears and sends, against the whole run: nobody else's frames, and all of its own."""

import re

import pytest

from dbc.compiler import load_arm
from hil import scenario_file
from hil.assemble import build_nodes
from hil.expectation import expectation
from hil.rig import run_inline
from hil.witness import sender_of

NAMES = {frame.identifier: name for name, frame in load_arm().items()}


def listed(scenario, name, verb):
    line = re.findall(rf"^  {verb} (.*)$", expectation(scenario, name), re.M)[0]
    return {int(each, 16) for each in re.findall(r"\w+ 0x(\w+) \(", line)}


@pytest.mark.parametrize("arm", ["one-joint", "paper-joint", "five-joints"])
def test_it_lists_what_a_node_sends_and_listens_to(arm):
    scenario = scenario_file.load(arm, ["duration_s=0.1"])
    sent = {(NAMES[identifier], identifier) for _, identifier, _, _ in run_inline(scenario).log.frames}
    for node in build_nodes(scenario):
        mine = {identifier for name, identifier in sent if sender_of(name) == node.name}
        assert mine <= listed(scenario, node.name, "sends")
        assert {*node.wakes_on, *node.stores} <= listed(scenario, node.name, "hears")
