"""The search for the first instant below zero."""

from math import cos, log, pi, ulp

import pytest

from plant.bracket import WIDTH_S, first_negative


@pytest.mark.parametrize(
    ("function", "end", "root"),
    [
        (lambda t: 1e-4 - t, 1e-3, 1e-4),
        (lambda t: cos(1e3 * t), 2e-3, pi / 2 * 1e-3),
        (lambda t: (3e-4 - t) ** 3, 1e-3, 3e-4),
        (lambda t: min(2e-4 - t, 1e3 * (5e-4 - t)), 1e-3, 2e-4),
        (lambda t: t * (7e-4 - t), 1e-3, 7e-4),  # sets off from zero
        (lambda t: 7.5 - t, 10.0, 7.5),  # the width is that of the numbers here
        (lambda t: -log(t / 6e-4) if t else 50.0, 1e-3, 6e-4),
    ],
)
def test_right_end_of_the_bracket_is_just_past_the_root(function, end, root):
    found = first_negative(function, end)
    assert function(found) <= 0.0
    assert abs(found - root) <= max(2 * WIDTH_S, 8 * ulp(end))


def test_few_evaluations_on_a_smooth_function():
    calls = []

    def function(t):
        calls.append(t)
        return 1e-2 - t - 40.0 * t * t

    first_negative(function, 2e-2)
    assert len(calls) <= 15


def test_function_positive_nowhere_gives_the_shortest_span():
    assert first_negative(lambda t: -t, 1.0) == 0.5**60
