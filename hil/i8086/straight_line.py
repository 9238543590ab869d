"""Clocks without executing: where nothing saturates, the control step is one straight line but for a loop.

The loop's rounds are the parameter `shift` alone, so an interrupt takes what an idle one of that shift does, and what
its three multiplications take more. The interpreter counted the idle one.
"""

from collections.abc import Sequence
from functools import lru_cache

from dbc.compiler import load_arm
from firmware_py.joint_cpu import SHIFT, SIGNALS
from firmware_py.words import Words
from hil.constants import parameter_table
from hil.i8086 import image
from hil.i8086.bounds import Bounds, bounds, joint_rounds
from hil.i8086.clocks import INTERRUPT, MULTIPLY_MOST, multiply
from hil.i8086.interpreted_board import InterpretedBoard
from hil.scenario import Scenario

MULTIPLICATIONS = 3


@lru_cache(maxsize=1)
def _board() -> InterpretedBoard:
    return InterpretedBoard()


def executed_clocks(*given: int) -> int:
    """Return the clocks of any interrupt, by executing it. given: the arguments of the control step."""
    _board().step(Words(16, len(SIGNALS)), *given)
    return _board().clocks


@lru_cache(maxsize=64)
def _clocks_but_multiplications(shift: int) -> int:
    return executed_clocks(*(0,) * 8, shift, 0) - MULTIPLICATIONS * multiply(0, 0)


def straight_clocks(given: Sequence[int], answered: Sequence[int]) -> int:
    """Return the clocks of an interrupt in which nothing saturated, by arguments and results of its step."""
    _count, _count_prev, w_prev, _d, a_ref, ka, kb, kj, shift, _limit = given
    w, _, i, estimate = answered
    return (
        _clocks_but_multiplications(shift)
        + multiply(w - w_prev & 0xFFFF, kb & 0xFFFF)
        + multiply(a_ref & 0xFFFF, kj & 0xFFFF)
        + multiply(i - estimate & 0xFFFF, ka & 0xFFFF)
    )


def most_clocks(scenario: Scenario, joint: int) -> int:
    """Return the most clocks of an interrupt of joint 1 to n in which nothing saturates."""
    return least_clocks(scenario, joint) + MULTIPLICATIONS * MULTIPLY_MOST


def least_clocks(scenario: Scenario, joint: int) -> int:
    """Return the least clocks of an interrupt of joint 1 to n: what saturates takes longer."""
    return _clocks_but_multiplications(shift_of(scenario, joint))


def beyond_clocks(scenario: Scenario, joint: int) -> int:
    """Return by how many clocks, at most, an interrupt of joint 1 to n in which something saturates is longer."""
    return interrupt_bounds(scenario, joint)[1] - most_clocks(scenario, joint)


def step_clocks(scenario: Scenario, joint: int) -> tuple[int, int]:
    """Return the least and most clocks of the control step alone, of joint 1 to n, in which nothing saturates."""
    around = INTERRUPT + _bounds(image.INTERRUPT, 0).least_clocks - _bounds(image.STEP, 0).least_clocks
    return least_clocks(scenario, joint) - around, most_clocks(scenario, joint) - around


def step_bounds(scenario: Scenario, joint: int) -> tuple[int, int]:
    """Return the least and most clocks of the control step alone, of joint 1 to n, over all of its paths."""
    found = _bounds(image.STEP, shift_of(scenario, joint))
    return found.least_clocks, found.most_clocks


def interrupt_bounds(scenario: Scenario, joint: int) -> tuple[int, int]:
    """Return the least and most clocks of an interrupt, acknowledgement included, of joint 1 to n over all paths."""
    found = _bounds(image.INTERRUPT, shift_of(scenario, joint))
    return INTERRUPT + found.least_clocks, INTERRUPT + found.most_clocks


@lru_cache(maxsize=64)
def _bounds(entry: int, shift: int) -> Bounds:
    return bounds(image.CODE, entry, joint_rounds(shift))


def shift_of(scenario: Scenario, joint: int) -> int:
    """Return the parameter `shift` of joint 1 to n."""
    return parameter_table(scenario, joint, load_arm())[SHIFT]
