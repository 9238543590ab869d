"""What the rig expects of a node that somebody else plays, from the database: frames, identifiers, cycle times."""

from collections.abc import Iterable

from dbc.compiler import Description, describe_arm
from hil.scenario import Scenario

AT_WILL = ("Stop",)
"""Anybody may send it."""


def expectation(scenario: Scenario, name: str) -> str:
    """Return what a node hears and sends, a line each, with the cycle times of arm.dbc."""
    node = name.upper()
    others = {each.upper() for each in scenario.node_names} - {node}
    messages = describe_arm(scenario.joints)
    hears = [each for each in messages if node in each.receivers and (each.senders & others)]
    sends = [each for each in messages if node in each.senders or each.name in AT_WILL]
    clock = scenario.clock
    by = f"by the clock wall at pace {clock.pace:g}" if clock.kind == "wall" else "by Sync"
    period_s = clock.period_s / (clock.pace if clock.kind == "wall" else 1.0)
    answers = f"; it answers Encoder_{name.removeprefix('joint')}" if name.startswith("joint") else ""
    return (
        f"{name} is external: waiting for it{answers}; {by}; one period is {period_s * 1e3:g} ms\n"
        f"  hears {_listed(hears)}\n"
        f"  sends {_listed(sends)}"
    )


def _listed(messages: Iterable[Description]) -> str:
    return ", ".join(
        f"{each.name} {each.identifier:#05x} ({each.length} B{f', every {each.cycle_ms} ms' * bool(each.cycle_ms)})"
        for each in messages
    )
