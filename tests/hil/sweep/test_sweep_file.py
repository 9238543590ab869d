"""Sweep files: what they may say, what is refused with its reason, and that the written one is the same sweep."""

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil import scenario_file
from hil.errors import ScenarioError
from hil.record import toml_value
from hil.sweep import sweep_file
from hil.sweep.paths import Base, is_whole
from hil.sweep.run import plan
from hil.sweep.sampling import points

ONE = '[[sweep]]\nname = "a"\nmethod = "grid"\n[sweep.vary]\n'
PAPER = 'scenario = "paper-joint"\n'


@pytest.fixture
def load(tmp_path):
    def read(text, *settings):
        path = tmp_path / "a.toml"
        path.write_text(text)
        return sweep_file.load(str(path), settings)

    return read


def scenario_of(file, number=0):
    found = plan(file)
    point = found.points[number]
    return found.bases[point.sweep].scenario(point.values)


def test_what_is_set_and_varied_comes_into_the_scenario(load):
    text = (
        PAPER + 'set = ["joint.observer=false", "duration_s=0.5"]\n' + ONE + "drive.limit_A = [7.0]\n"
        '"load" = [[{mass_kg = 1.0, at_s = 0.0, until_s = 0.5}]]\n[sweep.set]\njoint.clock_hz = 5e6\n'
    )
    expected = scenario_file.load(
        "paper-joint",
        [
            "joint.observer=false",
            "duration_s=0.5",
            "joint.clock_hz=5e6",
            "drive.limit_A=7.0",
            "load=[{mass_kg=1.0, at_s=0.0, until_s=0.5}]",
            "bus.fidelity=functional",
        ],
    )
    assert scenario_of(load(text)) == expected


def test_a_table_and_a_list_set_the_same(load):
    vary = ONE + '"joint.g_rad_s" = [1]\n'
    table = load(PAPER + '[set]\njoint.observer = false\n"dsp.k1_1_s" = 80.0\n' + vary)
    assert table == load(PAPER + 'set = ["joint.observer=false", "dsp.k1_1_s=80.0"]\n' + vary)
    assert table == load(PAPER + ONE + "joint.g_rad_s = [1]\n", "joint.observer=false", "dsp.k1_1_s=80.0")


def test_runs_are_functional_unless_the_sweep_sets_bits(load):
    vary = ONE + "joint.g_rad_s = [100]\n"
    assert scenario_of(load(PAPER + vary)).bus.fidelity == "functional"
    assert scenario_of(load(PAPER + '[set]\nbus.fidelity = "bits"\n' + vary)).bus.fidelity == "bits"
    assert scenario_of(load("[scenario]\n" + PLAIN + vary)).bus.fidelity == "functional"


PLAIN = 'name = "p"\nduration_s = 0.1\ntrajectory = {kind = "quintic", by_rad = [0.1, 0.1, 0.1], time_s = 0.1}\n'


def test_a_scenario_of_ones_own_lies_beside_the_sweep(load, tmp_path):
    (tmp_path / "mine.toml").write_text(PLAIN)
    assert scenario_of(load('scenario = "mine.toml"\n' + ONE + "joint.g_rad_s = [100]\n")).name == "p"


def test_a_factor_multiplies_every_entry_of_the_base(load):
    text = PAPER + ONE + '"joint.inertia_kg_m2 *" = [1.1]\n"joint.clocks *" = [0.3333]\n"drive.limit_A *" = [0.5]\n'
    scenario, plain = scenario_of(load(text)), scenario_file.load("paper-joint")
    assert scenario.joint.inertia_kg_m2 == tuple(value * 1.1 for value in plain.joint.inertia_kg_m2)
    assert (scenario.joint.clocks, scenario.drive.limit_A) == (333, 4.0)


def test_one_entry_of_a_tuple_is_varied_by_its_number(load):
    text = PAPER + ONE + '"arm.coulomb_N_m.1" = [3.5]\n"arm.coulomb_N_m.0 *" = [0.5]\n'
    assert scenario_of(load(text)).arm.coulomb_N_m == (2.0, 3.5, 0.4)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (ONE + "joint.g_rad_s = [1]", "scenario is missing"),
        ('scenario = "paper"\n' + ONE + "joint.g_rad_s = [1]", "no scenario"),
        (PAPER, "sweep is missing"),
        (PAPER + "sweep = 3", "sweep = 3"),
        (PAPER + "colour = 3\n" + ONE + "joint.g_rad_s = [1]", "unknown key colour"),
        (PAPER + "seed = -1\n" + ONE + "joint.g_rad_s = [1]", "seed = -1"),
        (PAPER + "set = 3\n" + ONE + "joint.g_rad_s = [1]", "set = 3: write a table, or a list of path=value"),
        (PAPER + 'set = ["joint"]\n' + ONE + "joint.g_rad_s = [1]", "write path=value"),
        (PAPER + ONE, "sweep.0.vary"),
        (PAPER + ONE + "joint.g_rad_s = 3", "sweep.0.vary.joint.g_rad_s"),
        (PAPER + ONE + "joint.g_rad_s = []", "at least 1 item"),
        (PAPER + ONE + "joint.g_rad_s = {from = 1, too = 2, steps = 3}", "unknown key sweep.0.vary.joint.g_rad_s.too"),
        (PAPER + ONE + "joint.g_rad_s = {from = 1, to = 2}", "needs steps"),
        (PAPER + ONE + "joint.g_rad_s = {from = 1, to = 2, steps = 1}", "greater than or equal to 2"),
        (PAPER + ONE + "joint.g_rad_s = {from = 0, to = 2, steps = 3, log = true}", "both must be above 0"),
        (PAPER + ONE + "joint.g_rad_s = {from = 0, to = inf, steps = 3}", "finite number"),
        (PAPER + ONE + "joint.g_rad_s = {normal = [1, 2]}", "normal is of random methods"),
        (PAPER + ONE + "joint.g_rad_s = [1, 1979-05-27]", "1979-05-27 is no value of a scenario's"),
        (PAPER + ONE + f"joint.g_rad_s = [{10**30}]", "is no value of a scenario's"),
        (PAPER + ONE + "joint.g_rad_s = [nan]", "nan is no value of a scenario's"),
        (PAPER + 2 * (ONE + "joint.g_rad_s = [1]\n"), "two sweeps are named 'a'"),
        (PAPER + ONE.replace("grid", "gird") + "joint.g_rad_s = [1]", "sweep.0.method = 'gird'"),
        (PAPER + ONE.replace("grid", "monte-carlo") + "joint.g_rad_s = [1]", "needs samples"),
        (PAPER + ONE.replace("[sweep.vary]", "samples = 3\n[sweep.vary]") + "joint.g_rad_s = [1]", "takes no samples"),
        (PAPER + "a = " + 2000 * "[" + 2000 * "]", "brackets in brackets"),
        ("scenario =", "not a TOML file"),
    ],
)
def test_a_file_that_says_nothing_sensible_is_refused_with_its_reason(load, text, said):
    with pytest.raises(ScenarioError) as caught:
        points(load(text))
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("vary", "said"),
    [
        ("joint.g_rad_s = [-1, -2]", "refuses all 2 points; point 0, {'joint.g_rad_s': -1}: scenario: joint.g_rad_s"),
        ('"joint.observer *" = [1]', "the scenario has True there, and only numbers can be multiplied"),
        ('"load.0.mass_kg *" = [1]', "the scenario has None there"),
        ('"joint.g_rad_s *" = ["a"]', "'a' is no factor"),
        ('"arm.coulomb_N_m.3" = [1]', "arm.coulomb_N_m.3 is no entry"),
        ('"clock.kind" = ["sync"]', "a sweep runs in virtual time"),
        ('"joint.word.kb_fraction" = [8]', "does not fit its format"),
    ],
)
def test_a_sweep_none_of_whose_points_can_run_is_refused_before_it_begins(load, vary, said):
    with pytest.raises(ScenarioError) as caught:
        plan(load(PAPER + ONE + vary))
    assert said in str(caught.value)
    assert str(caught.value).startswith("sweep a: ")


def test_no_such_file_names_the_built_in_ones():
    with pytest.raises(ScenarioError, match=r"no sweep 'quantization': built in are .*quantisation"):
        sweep_file.load("quantization")


@pytest.mark.parametrize("name", scenario_file.builtin_names("sweep"))
def test_the_built_in_sweeps_can_run(name):
    assert plan(sweep_file.load(name)).points


@pytest.mark.parametrize("name", scenario_file.builtin_names("sweep"))
def test_the_written_file_is_the_same_sweep(name, load):
    first = sweep_file.load(name, ["load=[{mass_kg=1.0, at_s=0.0, until_s=0.5}]", 'bus.fidelity="bits"'])
    again = load(sweep_file.to_toml(first))
    assert again == first
    assert [point.values for point in points(again)] == [point.values for point in points(first)]


@given(
    st.recursive(
        st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
        max_leaves=6,
    )
)
def test_a_value_in_a_line_of_toml_reads_back(value):
    assert tomllib.loads(f"value = {toml_value(value)}") == {"value": value}


@pytest.mark.parametrize(
    ("path", "whole"),
    [
        ("encoder.counts_per_turn", True),
        ("joint1.clocks", True),
        ("drive.ripple_order", True),
        ("drive.ripple_order.0", True),
        ("joint.word.bits", True),
        ("joint.g_rad_s", False),
        ("joint.observer", False),
        ("joint.inertia_kg_m2", False),
        ("encoder.counts_per_turn *", False),
    ],
)
def test_which_paths_take_whole_numbers_only(path, whole):
    assert is_whole(path) is whole


def test_a_point_with_another_number_of_joints_is_refused():
    values = scenario_file.parse(scenario_file.read("one-joint"), "one-joint")
    base = Base.of(values | {"clock": {"kind": "virtual"}})
    five = scenario_file.load("two-joints").model_dump(mode="json")
    with pytest.raises(ScenarioError, match=r"an arm of 2 joints in a sweep of one of 1"):
        base.scenario({key: five[key] for key in ("arm", "drive", "brake", "joint", "start_rad", "trajectory")})
