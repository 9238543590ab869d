"""Table 1, counted: 3 and 6 a joint in every step of a run; 134 n and 111 n beside 132 n and 111 n - 4."""

from random import Random

import pytest

from firmware_py.dsp.inverse_dynamics import ArmModel, joint_torques
from firmware_py.words import InstrumentedWords
from hil import scenario_file
from hil.paper.newton_euler import WORD_BITS
from hil.paper.table1 import (
    AS_READ,
    LARGEST_ARM,
    Number,
    newton_euler_ledger,
    observer_steps,
    planar_operations,
    table_1,
)
from hil.rig import run_inline

ARMS = range(1, LARGEST_ARM + 1)


@pytest.mark.parametrize("name", ["paper-joint", "one-joint", "five-joints"])
def test_every_step_of_every_joint_costs_3_and_6(name):
    scenario = scenario_file.load(name)
    assert observer_steps(name) == {(3, 6): scenario.joints * scenario.cycles}


def test_a_counted_run_is_the_run(short):
    """On the words that count, the same frames at the same instants."""
    joint = short.joint.model_copy(update={"cpu": "hil.paper.table1:CountedJoint"})
    counted = short.model_copy(update={"joint": joint})
    assert run_inline(counted, compiled=False).log.sha256() == run_inline(short, compiled=False).log.sha256()


@pytest.mark.parametrize("n", ARMS)
def test_newton_euler_costs_134_n_and_111_n(n):
    assert newton_euler_ledger(n).total == (134 * n, 111 * n)


@pytest.mark.parametrize("n", ARMS)
def test_by_line_only_the_two_products_of_z_differ_from_the_papers_total(n):
    read = {name: (m * n, a * n) for name, (m, a) in AS_READ.items()}
    assert sum(m for m, _ in read.values()) == 132 * n
    assert sum(a for _, a in read.values()) == 111 * n
    lines = newton_euler_ledger(n).lines
    assert lines.keys() == read.keys()
    assert {name for name in lines if lines[name] != read[name]} == {"w'"}
    assert lines["w'"] == (11 * n, 9 * n)


@pytest.mark.parametrize("n", ARMS)
def test_the_planar_arms_dynamics_cost_less(n):
    assert planar_operations(n) == (25 * n + 2, 19 * n)


def test_counted_numbers_compute_what_floats_do():
    draw = Random(1)
    columns = [tuple(draw.uniform(0.1, 2.0) for _ in range(3)) for _ in range(7)]
    words = InstrumentedWords(WORD_BITS)
    plain, counted = (
        joint_torques(ArmModel(*arm, (2.0, 2.0, 2.0), 9.8, 0.5), *motion, (1.0, -1.0, 0.0))
        for arm, motion in (
            (columns[:4], columns[4:]),
            (
                [tuple(Number(x, words) for x in column) for column in columns[:4]],
                [tuple(Number(x, words) for x in column) for column in columns[4:]],
            ),
        )
    )
    # a quotient is counted as the product with the reciprocal
    assert [float(x) for x in counted] == pytest.approx(plain, rel=1e-14)


def test_the_table_sets_them_side_by_side():
    rows = list(table_1((3, 6)))
    assert [row.joints for row in rows] == list(ARMS)
    for row in rows:
        n = row.joints
        assert row.observer == row.observer_paper == (3 * n, 6 * n)
        assert row.newton_euler_paper == (132 * n, 111 * n - 4)
        assert row.newton_euler == (134 * n, 111 * n)
        assert row.explained
        assert row.planar == (25 * n + 2, 19 * n)
