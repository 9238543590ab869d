"""What counted clocks come to: at each of the 8086's clocks, in a period, and beside Newton-Euler inverse dynamics.

Ref: the paper's table 1 (132 n multiplications and 111 n - 4 additions); Intel 8086 Family User's Manual 1979.
Not counted: CAN, the prefetch queue, wait states.
"""

from typing import Any

from hil.constants import cycle_ns
from hil.i8086.clocks import FORMS
from hil.i8086.straight_line import interrupt_bounds
from hil.paper.newton_euler import Operations
from hil.paper.table1 import LARGEST_ARM, newton_euler_paper
from hil.scenario import Scenario
from hil.timing.computing import CLOCKS_HZ, at_clock, with_clock

STEP = Operations(3, 6)
"""Of the law, by table 1."""
ADD_CLOCKS = FORMS["03"].register + FORMS["13"].register
"""ADD and ADC of registers: a sum of 32 bits."""


def by_clock(scenario: Scenario) -> list[dict[str, Any]]:
    """Return what each of the 8086's clocks means (at_clock), with bounds over all paths and the shortest periods, s.

    bound_s: of an interrupt, of the joint that takes the most. shortest_period_s: at which this interrupt leaves no
    time, `cpu`; and which the frames of a cycle need at the scenario's bit rate, `bus`.
    """
    most = max(interrupt_bounds(scenario, n)[1] for n in range(1, scenario.joints + 1))
    found = []
    for clock_hz in CLOCKS_HZ:
        bound_s = most / clock_hz
        shortest_s = {"cpu": bound_s, "bus": cycle_ns(with_clock(scenario, clock_hz)) / 1e9}
        found.append({**at_clock(scenario, clock_hz), "bound_s": bound_s, "shortest_period_s": shortest_s})
    return found


def floor_clocks(operations: Operations, imul_clocks: float) -> float:
    """Return what operations take that are nothing but an IMUL each, or ADD and ADC of registers."""
    return operations.multiplications * imul_clocks + operations.additions * ADD_CLOCKS


def newton_euler(joints: int, imul_clocks: float, step_clocks: float) -> dict[str, Any]:
    """Return an estimate of the clocks of inverse dynamics of an arm of so many joints, in fixed point on this CPU.

    imul_clocks, step_clocks: means of a run. floor: nothing but its operations; as_the_step: as many times its floor as
    the step takes of its own, for all that is around operations: moves, shifts, saturations.
    """
    operations = newton_euler_paper(joints)
    floor = floor_clocks(operations, imul_clocks)
    return {
        "joints": joints,
        **operations._asdict(),
        "floor_clocks": floor,
        "clocks_as_the_step": floor * step_clocks / floor_clocks(STEP, imul_clocks),
    }


def beside_newton_euler(joints: int, imul_clocks: float, step_clocks: float) -> dict[str, Any]:
    """Return the step's clocks, and those of inverse dynamics of this arm and of one of six joints."""
    arms = sorted({joints, LARGEST_ARM})
    return {
        "imul_clocks": imul_clocks,
        "add_clocks": ADD_CLOCKS,
        "step": {**STEP._asdict(), "floor_clocks": floor_clocks(STEP, imul_clocks), "clocks": step_clocks},
        "newton_euler": [newton_euler(n, imul_clocks, step_clocks) for n in arms],
    }
