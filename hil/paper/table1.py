"""Table 1 counted on running code: operations a sample of the observer and of Newton-Euler inverse dynamics.

The observer: `firmware_py.joint_cpu.make_step` in a run of a scenario, on words that count. Inverse dynamics:
`hil.paper.newton_euler` on the same words.

Ref: the paper's table 1.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from firmware_py.dsp.inverse_dynamics import ArmModel, joint_torques
from firmware_py.joint_cpu import SIGNALS, JointCPU
from firmware_py.words import InstrumentedWords
from hil import scenario_file
from hil.paper.newton_euler import UNIT, WORD_BITS, Ledger, Link, Operations, newton_euler
from hil.rig import run_inline

LARGEST_ARM = 6

AS_READ = {
    "w": Operations(9, 7),
    "w'": Operations(9, 9),
    "v'": Operations(27, 21),
    "v' of the centre": Operations(18, 15),
    "F": Operations(3, 0),
    "N": Operations(24, 18),
    "f": Operations(9, 9),
    "n": Operations(30, 30),
    "tau": Operations(3, 2),
}
"""A link's share of the paper's 132 n and 111 n by line: our reading, since the paper gives the totals alone."""

DIFFERENCE = (
    "2 n products more: w x (z q') inside w' takes two, for which the paper's total has no room; 4 sums more: at the "
    "base w = w' = 0, so four sums of link 1 add to a known zero, which we make and count. Nothing else differs"
)
"""Why our counts, 134 n and 111 n, are not the paper's."""


@dataclass(frozen=True)
class Row:
    """Operations a sample for an arm of so many joints."""

    joints: int
    newton_euler: Operations
    newton_euler_paper: Operations
    observer: Operations
    observer_paper: Operations
    planar: Operations
    """Of `firmware_py.dsp.inverse_dynamics`, which is no line of the paper's."""

    @property
    def explained(self) -> bool:
        """Newton-Euler costs what the paper says and DIFFERENCE, no more and no less."""
        paper = self.newton_euler_paper
        return self.newton_euler == (paper.multiplications + 2 * self.joints, paper.additions + 4)

    @property
    def costs(self) -> tuple[Operations, ...]:
        """In this order."""
        return self.newton_euler, self.newton_euler_paper, self.observer, self.observer_paper, self.planar


class Number:
    """A float whose products (and quotients by constants) and sums words count, for code that is not written on words.

    What it meets may be a plain number; sines and cosines of it are.
    """

    def __init__(self, value: float, words: Any) -> None:
        self._value, self._words = value, words

    def __float__(self) -> float:
        return self._value

    def __mul__(self, other: Any) -> "Number":
        return Number(self._words.multiply(self._value, float(other)), self._words)

    def __truediv__(self, constant: float) -> "Number":
        return self * (1.0 / constant)

    def __add__(self, other: Any) -> "Number":
        return Number(self._words.add(self._value, float(other)), self._words)

    def __sub__(self, other: Any) -> "Number":
        return Number(self._words.subtract(self._value, float(other)), self._words)

    def __neg__(self) -> "Number":
        return Number(-self._value, self._words)

    __rmul__, __radd__ = __mul__, __add__


class CountedJoint(JointCPU):
    """The joint CPU on words that count; its report has `costs`: (multiplications, additions, steps that cost this)."""

    def __init__(self, number: int, words: Any, *rest: Any) -> None:
        JointCPU.__init__(self, number, InstrumentedWords(words.bits, len(SIGNALS)), *rest)
        self.costs: Counter[Operations] = Counter()

    def control(self, count: int, a_ref: int) -> tuple[int, int]:
        """Count one step."""
        self.words.multiplications = self.words.additions = 0
        i, estimate = JointCPU.control(self, count, a_ref)
        self.costs[Operations(self.words.multiplications, self.words.additions)] += 1
        return i, estimate

    def report(self) -> dict[str, Any]:
        """Add what the steps cost."""
        report: dict[str, Any] = JointCPU.report(self)
        return report | {"costs": [(*cost, steps) for cost, steps in self.costs.items()]}


def observer_steps(name: str = "paper-joint") -> dict[Operations, int]:
    """Return how many steps of all joints of a scenario's run cost what."""
    outcome = run_inline(scenario_file.load(name, [f"joint.cpu={__name__}:CountedJoint"]), compiled=False)
    steps: Counter[Operations] = Counter()
    for report in outcome.reports.values():
        steps.update({Operations(m, a): count for m, a, count in report.get("costs", [])})
    return dict(steps)


def newton_euler_ledger(joints: int) -> Ledger:
    """Return what inverse dynamics of an arm takes, by line; it depends on the number of joints alone."""
    ledger = Ledger()
    link = Link(a=0.3, d=0.1, alpha=0.5, mass=1.0, centre=(0.1, 0.2, 0.3), inertia=UNIT)
    newton_euler(ledger, [link] * joints, [(0.1, 0.2, 0.3)] * joints, (0.0, 0.0, 9.8))
    return ledger


def newton_euler_paper(joints: int) -> Operations:
    """Return what inverse dynamics of an arm takes as table 1 has it."""
    return Operations(132 * joints, 111 * joints - 4)


def planar_operations(joints: int) -> Operations:
    """Return the operations of the planar arm's inverse dynamics, as the DSP computes them."""
    words = InstrumentedWords(WORD_BITS)
    of_each: Any = (Number(0.3, words),) * joints
    arm = ArmModel(of_each, of_each, of_each, of_each, (2.0,) * joints, 9.8)
    joint_torques(arm, of_each, of_each, of_each, (1.0,) * joints)
    return Operations(words.multiplications, words.additions)


def table_1(step: tuple[int, int]) -> Iterator[Row]:
    """Yield a row for every number of joints. step: multiplications and additions of the observer's step."""
    for n in range(1, LARGEST_ARM + 1):
        counted = newton_euler_ledger(n).total
        observer = Operations(n * step[0], n * step[1])
        yield Row(n, counted, newton_euler_paper(n), observer, Operations(3 * n, 6 * n), planar_operations(n))
