"""The search for a limit: against trying every step."""

from hypothesis import given
from hypothesis import strategies as st

from hil.timing.search import Largest, largest

LOW, HIGH = 2.0, 5.0
inside = st.floats(LOW, HIGH)


@given(st.integers(1, 300), st.floats(LOW - 1, HIGH + 1), st.floats(LOW - 1, HIGH + 1))
def test_it_finds_what_trying_every_step_finds_wherever_it_begins(steps: int, limit: float, begin: float) -> None:
    values = [LOW + k * (HIGH - LOW) / steps for k in range(steps + 1)]
    good = [value for value in values if value <= limit]
    expected = Largest(good[-1] if good else None, beyond=len(good) == len(values))
    assert largest(lambda value: value <= limit, LOW, HIGH, steps, begin) == expected


@given(inside, inside, inside)
def test_from_a_value_that_holds_it_finds_the_upper_end_of_an_interval(one: float, other: float, begin: float) -> None:
    lower, begin, upper = sorted((one, begin, other))
    steps = 256
    step = (HIGH - LOW) / steps
    found = largest(lambda value: lower - step <= value <= upper, LOW, HIGH, steps, begin)
    assert found.value is not None
    assert upper - step < found.value <= upper


def test_a_good_place_to_begin_saves_runs() -> None:
    def tried(begin: float) -> int:
        values = []

        def holds(value: float) -> bool:
            values.append(value)
            return value < 0.3

        largest(holds, 0.0, 1.0, 256, begin)
        return len(values)

    assert (tried(0.29), tried(0.0)) == (4, 12)
