"""One text of a function and all that it uses, and what becomes of it as machine code."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from plant import linked_source as module_under_test
from plant.compiled import machine_code_of
from plant.linked_source import linked_source

FACTOR = 3
NOTHING = math.inf
TABLE = [1, 2]


def twice(x: float) -> float:
    return 2 * x


def made():
    called = twice  # by another name

    def six_times(x: SimpleNamespace) -> float:
        return FACTOR * called(x)

    return six_times


def falls(x: float) -> float:
    """Use a bit of everything."""
    return math_exp(-x) + float(np.rint(six(x))) + min(NOTHING, sum([twice(x) for _ in range(1)]))


def reads_a_table(x: int) -> int:
    return TABLE[x]


def uses_what_is_not_there(x: int) -> int:
    return nowhere(x)  # noqa: F821


six = made()
math_exp = math.exp


def run(text, name):
    namespace = {}
    exec(text, namespace)
    return namespace[name]


def test_the_text_alone_does_what_the_function_does():
    assert run(linked_source(six), "six_times")(7.0) == six(7.0) == 42.0


def test_what_is_called_by_another_name_keeps_it(monkeypatch):
    monkeypatch.setitem(globals(), "math_exp", twice)
    assert run(linked_source(falls), "falls")(0.25) == falls(0.25)


def test_a_change_of_a_number_is_another_text(monkeypatch):
    before = linked_source(six)
    monkeypatch.setitem(globals(), "FACTOR", 4)
    assert linked_source(six) != before


@pytest.mark.parametrize(
    ("function", "named"),
    [(reads_a_table, r"TABLE = \[1, 2\]"), (uses_what_is_not_there, "nowhere"), (falls, "math_exp")],
)
def test_what_no_text_can_hold_is_named(function, named):
    with pytest.raises(TypeError, match=named):
        linked_source(function)


def test_one_name_for_two_things_is_refused(monkeypatch):
    def twice(x):
        return x + x

    monkeypatch.setitem(globals(), "math_exp", twice)
    with pytest.raises(TypeError, match=r"twice: .* another name"):
        linked_source(falls)


exp = math.exp


def decay(x: float) -> float:
    return exp(x)


def test_exp_as_machine_code_have_the_bits_of_python():
    pytest.importorskip("numba", reason="NOT TESTED: machine code of the plant; pip install -e '.[fast]'")
    machine = machine_code_of(decay)
    assert machine is not None
    draw = np.random.default_rng(2)
    x = np.concatenate([draw.uniform(-reach, 0.0, 3000) for reach in (1e-6, 1.0, 700.0)]).tolist()
    assert [machine(each) for each in x] == [math.exp(each) for each in x]


def test_names_are_taken_from_what_the_code_loads():
    assert module_under_test._global_names(falls.__code__) >= {"math_exp", "np", "six", "twice", "NOTHING"}
