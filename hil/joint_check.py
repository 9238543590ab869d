"""Joints that cannot be: a computing time given twice, timers that nothing can drift against.

Raises ScenarioError with the key, its value, the limit and the cure.
"""

from hil.errors import ScenarioError
from hil.scenario import Scenario
from hil.scenario_joint import CLOCK_HZ, I8086, INTERRUPT_CLOCKS, PYTHON, Joint, OneJoint
from hil.scenario_word import Word


def check_clocks(scenario: Scenario) -> None:
    """Refuse a computing time that is given twice."""
    own: list[tuple[str, Joint | OneJoint]] = [(f"joint{n}", scenario.own(n)) for n in range(1, scenario.joints + 1)]
    for name, part in [("joint", scenario.joint), *own]:
        given = [
            f"{key} = {value:g}"
            for key, usual in (("clock_hz", CLOCK_HZ), ("clocks", INTERRUPT_CLOCKS))
            if (value := getattr(part, key)) not in (None, usual)
        ]
        if part.compute_s is not None and given:
            raise ScenarioError(
                f"{name}.compute_s = {part.compute_s} beside {', '.join(given)}: the computing time is either "
                "compute_s or clocks / clock_hz: leave one of them out"
            )


def check_machine_code(scenario: Scenario) -> None:
    """Refuse a joint of machine code with a computing time or formats that are not the code's own."""
    for joint in range(1, scenario.joints + 1):
        if scenario.cpu(joint) == I8086:
            _check_machine_code(scenario, joint)


def _check_machine_code(scenario: Scenario, joint: int) -> None:
    named = f"joint{joint}: cpu = {I8086!r}"
    for key, usual in (("compute_s", None), ("clocks", INTERRUPT_CLOCKS)):
        given = scenario.of_joint(joint, key)
        if given != usual:
            own = getattr(scenario.own(joint), key) is not None
            where, cure = (f"joint{joint}", "") if own else ("joint", ", or give it to other joints one by one")
            raise ScenarioError(
                f"{named} with {where}.{key} = {given}: its computing time is the clocks that its machine code takes "
                f"over clock_hz: leave {key} out{cure}"
            )
    if scenario.joint.word != Word():
        changed = [f"{key} = {value}" for key, value in scenario.joint.word if value != getattr(Word(), key)]
        raise ScenarioError(
            f"{named} with joint.word.{', joint.word.'.join(changed)}: its machine code is of the default formats: "
            f"leave them out, or take cpu = {PYTHON!r}"
        )


def check_crystals(scenario: Scenario) -> None:
    """Refuse a joint by its own timer where no such timer can be, and one that could not keep up with it."""
    for joint in range(1, scenario.joints + 1):
        if scenario.crystal_ppb(joint) is not None:
            _check_crystal(scenario, joint)
        elif scenario.own(joint).crystal_phase_s is not None:
            raise ScenarioError(f"joint{joint}.crystal_phase_s without a timer: set joint{joint}.crystal_ppm, too")


def _check_crystal(scenario: Scenario, joint: int) -> None:
    ppm = scenario.of_joint(joint, "crystal_ppm")
    named = f"joint{joint}: crystal_ppm = {ppm:g}"
    if scenario.clock.kind != "virtual" or scenario.bus.fidelity != "bits":
        raise ScenarioError(
            f"{named} with clock.kind = {scenario.clock.kind!r}, bus.fidelity = {scenario.bus.fidelity!r}: a timer of "
            "its own drifts in virtual time, against frames that take some: take 'virtual' and 'bits', or leave it out"
        )
    if scenario.cpu(joint) != PYTHON:
        raise ScenarioError(
            f"{named} with cpu = {scenario.cpu(joint)!r}: only {PYTHON!r} has a timer of its own to sample by; "
            "leave one of them out"
        )
    period_s = scenario.clock.period_s / (1 + ppm * 1e-6)
    times = {
        "crystal_phase_s": scenario.of_joint(joint, "crystal_phase_s"),
        "computing time": scenario.compute_ns(joint) * 1e-9,
    }
    for what, value_s in times.items():
        if value_s >= period_s:
            raise ScenarioError(f"{named}: {what} {value_s:g} s is not below the timer's period of {period_s:.9f} s")
