"""Scenarios: what is accepted, what is refused, and what a refusal says."""

from pathlib import Path

import cantools
import pytest

import dbc
from dbc.compiler import load_arm
from firmware_py.joint_cpu import FAULTS, STATES
from hil import scenario_file
from hil.assemble import build_nodes, payloads
from hil.constants import STOP_REASONS, action_delays_ns, parameter_table, tail_ns, worst_case_ends_ns
from hil.errors import ScenarioError
from hil.exact_constants import rad_per_count
from hil.record import to_toml
from hil.scenario import Scenario
from plant.nominal import nominal_inertia
from plant.parameters import DEFAULT_ARM


def test_the_built_in_scenarios_are_those_of_the_paper_other_arms_contact_and_drift() -> None:
    assert scenario_file.builtin_names() == [
        "box",
        "direct-drive",
        "drift",
        "five-joints",
        "grasp",
        "linear-joint",
        "load-step",
        "one-joint",
        "paper-joint",
        "paper-task",
        "two-joints",
        "wall",
    ]


@pytest.mark.parametrize("name", scenario_file.builtin_names())
def test_a_resolved_scenario_reads_back_as_the_same(name: str) -> None:
    delays = [0.1 * n for n in range(1, scenario_file.load(name).joints + 1)]
    scenario = scenario_file.load(name, ["joint1.compute_s=0.0001", f"bus.action_delay_s={delays}"])
    assert scenario_file.build(scenario_file.parse(to_toml(scenario), "resolved")) == scenario


@pytest.mark.parametrize("name", scenario_file.builtin_names())
def test_a_scenario_survives_the_way_to_a_process(name: str) -> None:
    scenario = scenario_file.load(name)
    assert Scenario.model_validate_json(scenario.model_dump_json()) == scenario


def test_a_file_says_what_the_built_in_one_says(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(to_toml(scenario_file.load("paper-task")))
    assert scenario_file.load(str(path)) == scenario_file.load("paper-task")


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("joint.observer=false", False),
        ("joint.observer = false", False),
        ("joint.observer=true", True),
    ],
)
def test_set_takes_toml_values(setting: str, expected: bool) -> None:
    assert scenario_file.load("paper-joint", [setting.replace(" = ", "=")]).joint.observer is expected


REFUSED = {
    "joint.obsever=false": r"unknown key joint.obsever: did you mean joint.observer\?",
    "observer=false": r"unknown key observer: did you mean joint.observer\?",
    "trajectory.time_ms=1000": r"unknown key trajectory.time_ms: did you mean trajectory.time_s\?",
    "clock.period_ms=1": r"unknown key clock.period_ms: did you mean clock.period_s\?",
    "joint.g_rad_s=-1": r"joint.g_rad_s = -1: Input should be greater than 0",
    "joint.g_rad_s=1000": r"joint.g_rad_s = 1000.0 with clock.period_s = 0.001: g T = 1.000 must stay below 1",
    "joint.g_rad_s=nan": r"joint.g_rad_s = nan: Input should be (greater than 0|less than or equal to 1000000)",
    "joint.g_rad_s=seven": r"joint.g_rad_s = 'seven': Input should be a valid number",
    "duration_s=0": r"duration_s = 0: Input should be greater than 0",
    "duration_s=1.0005": r"duration_s = 1.0005 is not a multiple of clock.period_s = 0.001",
    "clock.period_s=0.0007": r"duration_s = 1.5 is not a multiple of clock.period_s = 0.0007",
    "clock.period_s=0.0005": r"frames of one cycle need 965 us .* leaves 500 us: raise the bit rate or the period",
    "clock.period_s=0.00000000015": r"is not a whole number of nanoseconds",
    "clock.kind=sundial": r"clock.kind = 'sundial': Input should be 'virtual', 'sync' or 'wall'",
    "clock.pace=2": r"clock.pace = 2: Input should be less than or equal to 1",
    "bus.bitrate=333333": r"bus.bitrate = 333333: a bit lasts 3000.003 ns, which is no whole number; take 1000000",
    "bus.bitrate=500000": r"frames of one cycle need 1930 us",
    "bus.fidelity=exact": r"bus.fidelity = 'exact': Input should be 'bits' or 'functional'",
    "start_rad=[0.1, 0.2]": r"start_rad has 2 entries, but arm.lengths_m has 3: one a joint",
    "arm.lengths_m=[0.3, 0.2]": r"start_rad has 3 entries, but arm.lengths_m has 2: one a joint",
    "arm.lengths_m=[0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3]": r"arm.lengths_m has 7 entries: an arm has 1 to 6 joints",
    "torque=[{joint=4, amplitude_N_m=1.0, until_s=1.0}]": r"torque.joint = 4: the arm has joints 1 to 3",
    "torque=[{joint=1, amplitude_N_m=1.0, at_s=1.0, until_s=1.0}]": r"torque from 1.0 s until 1.0 s: it must begin",
    "torque=[{joint=1, amplitude_N_m=1.0, until_s=9.0}]": r"and end by duration_s = 1.5",
    "trajectory={kind='line', by_m=[1.0, 0.0], time_s=1.0}": r"at 0.220 s: q2 = 0.0413 rad: \|sin q2\| is below",
    "trajectory={kind='path', legs=[]}": r"trajectory.legs = \[\]: Tuple should have at least 1 item",
    "joint.inertia_kg_m2=[1.0]": r"joint.inertia_kg_m2 has 1 entries, but arm.lengths_m has 3",
    "joint.inertia_kg_m2=[100.0, 1.0, 1.0]": r"joint1: KB = \d+ does not fit its format Q15.0 \(1 to 32767\)",
    "joint.inertia_kg_m2=[1e-9, 1.0, 1.0]": r"joint1: K\w+ = 0 does not fit its format",
    "joint.limit_A=17": r"joint1: current limit = 34816 does not fit its format",
    "joint.compute_s=0.001": r"joint1: compute_s = 0.001 is not below clock.period_s = 0.001",
    "dsp.compute_s=0.002": r"dsp.compute_s = 0.002 is not below clock.period_s = 0.001",
    "dsp.space=task": r"dsp.space = 'task' needs a path in task space, but trajectory.kind = 'quintic'",
    "joint2.cpu=nothing": r"joint2.cpu = 'nothing': .*write python, i8086, or package.module:Class",
    "joint2.cpu=:": r"joint2.cpu = ':': ValueError: .*write python, i8086, or package.module:Class",
    "joint2.cpu=json:loads": r"joint2.cpu = 'json:loads': a node is a class with on_start, .*; it lacks on_start, ",
    "joint2.cpu=json:JSONDecoder": r"it lacks on_start, .*; a subclass of firmware_py.joint_cpu.JointCPU has them all",
    "joint2.cpu=no.such:Thing": r"joint2.cpu = 'no.such:Thing': ModuleNotFoundError: No module named 'no'",
    "dsp.compute_s=0.0009": r"frames of one cycle need 1517 us .* leaves 1000 us: raise .* or compute faster",
    "joint.compute_s=0.0006": r"frames of one cycle need .* leaves 1000 us",
    "drive.lag_s=1e-9": r"drive.lag_s = 1e-09: 0 \(none\), or 1e-05 s and more",
    "drive.dead_time_s=[0.1, 0.1]": r"drive.dead_time_s has 2 entries, but arm.lengths_m has 3: one a joint",
    "drive.dead_time_s=[0.0, 0.0, 1.5]": r"drive.dead_time_s.2 = 1.5: Input should be less than or equal to 1",
    "drive.dead_time_s=[0.0, 1e-10, 0.0]": r"drive.dead_time_s.1 = 1e-10: is not a whole number of nanoseconds",
    "drive.dead_time_jitter_s=[0.0, 0.0005, 0.000500001]": r"jitter_s.2 = 0.000500001 is beyond half of "
    r"clock.period_s = 0.001: a current could overtake the one before: lower it",
    "drive.dead_time_ms=[1]": r"unknown key drive.dead_time_ms: did you mean drive.dead_time_s\?",
    "start_rad=[1e9, 0.0, 0.0]": r"start_rad.0 = 1000000000.0: Input should be less than or equal to 100",
    "trajectory.time_s=1e-300": r"trajectory.time_s = 1e-300: Input should be greater than or equal to 0.001",
    "drive.ripple=[0.1, 1.0, 0.0]": r"drive.ripple.1 = 1.0: Input should be less than 1",
    "name=../x": r"name = '../x': String should match pattern",
    "trajectory=3": r"trajectory",
    "joint.observer": r"--set 'joint.observer': write path=value",
    "duration_s.x=1": r"--set 'duration_s.x=1': duration_s is a value, not a table",
    "load=[{mass_kg = 1.0, at_s = 1.0, until_s = 0.5}]": r"load from 1.0 s until 0.5 s: it must begin before it ends",
    "load=[{mass_kg = 1.0, at_s = 1.0, until_s = 9}]": r"end by duration_s = 1.5",
}


@pytest.mark.parametrize("setting", REFUSED)
def test_what_cannot_run_is_refused_with_the_thing_the_value_and_the_limit(setting: str) -> None:
    with pytest.raises(ScenarioError, match=REFUSED[setting]):
        build_nodes(scenario_file.load("paper-joint", [setting]))


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("trajectory.radius_m=0.5", r"trajectory at \d\.\d+ s: tip \(.*\) puts the wrist .* m from the base; .*reach"),
        ("start_rad=[0.4, 0.03, -0.5]", r"trajectory at 0.000 s: q2 = 0.0300 rad: \|sin q2\| is below 0.05"),
    ],
)
def test_a_path_out_of_reach_or_through_a_singular_point_is_refused(setting: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        build_nodes(scenario_file.load("paper-task", [setting]))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = ", "not a TOML file"),
        ('name = "x"', "duration_s is missing: set it in the file or with --set duration_s=..."),
        ('name = "x"\nname = "y"', "not a TOML file"),
    ],
)
def test_a_broken_file_is_refused_by_name(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "broken.toml"
    path.write_text(text)
    with pytest.raises(ScenarioError, match=message):
        scenario_file.load(str(path))


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="No such file"):
        scenario_file.load(str(tmp_path / "absent.toml"))
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match="not a text file"):
        scenario_file.load(str(tmp_path / "binary.toml"))
    with pytest.raises(
        ScenarioError, match=r"no scenario 'paper': built in are .*load-step, .*paper-joint, paper-task"
    ):
        scenario_file.load("paper")


def test_the_constants_are_those_of_the_design() -> None:
    scenario, codec = scenario_file.load("paper-joint"), load_arm()
    assert [parameter_table(scenario, n, codec)[:2] for n in (1, 2, 3)] == [(22938, 1478), (22938, 984), (22938, 457)]
    assert [parameter_table(scenario, n, codec)[3:] for n in (1, 2, 3)] == [(13, 16384), (14, 16384), (15, 16384)]
    off = scenario_file.load("paper-joint", ["joint.observer=false"])
    assert parameter_table(off, 1, codec)[:2] == (0, 0)
    assert rad_per_count(scenario) == pytest.approx(codec.scale("Encoder_1", "Position"), rel=1e-12)


def test_the_budget_is_that_of_the_design() -> None:
    """Ends of the Current frames by the worst case 462, 577, 692 us; State is queued 160 us before the end."""
    scenario = scenario_file.load("paper-joint", ["bus.fidelity=functional"])
    assert action_delays_ns(scenario) == (462_000, 577_000, 692_000)
    assert worst_case_ends_ns(scenario)["AccelRef"] == 827_000
    assert tail_ns(scenario) == 160_000
    assert action_delays_ns(scenario_file.load("paper-joint")) == (0, 0, 0)


def test_the_default_nominal_inertia_is_the_least_over_the_workspace() -> None:
    """Found by the plant over its workspace, to the digits that the scenario gives."""
    assert scenario_file.load("paper-joint").joint.inertia_kg_m2 == pytest.approx(
        nominal_inertia(DEFAULT_ARM), rel=1e-3
    )


def test_the_default_arm_is_the_plant_s() -> None:
    arm = scenario_file.load("paper-joint").arm
    assert (arm.lengths_m, arm.masses_kg) == (DEFAULT_ARM.length_m, DEFAULT_ARM.mass_kg)
    assert arm.rotor_inertia_kg_m2 == DEFAULT_ARM.rotor_inertia_kgm2


def test_nodes_come_in_node_order() -> None:
    scenario = scenario_file.load("paper-joint")
    assert [node.name for node in build_nodes(scenario)] == scenario.node_names
    assert scenario.node_names == ["plant", "dsp", "joint1", "joint2", "joint3"]


def test_the_stop_reasons_and_states_are_those_of_the_database() -> None:
    database = cantools.database.load_file(Path(dbc.__path__[0]) / "arm.dbc")

    def table(message: str, signal: str) -> dict[int, str]:
        choices = database.get_message_by_name(message).get_signal_by_name(signal).choices
        return {key: str(value) for key, value in choices.items()}

    assert table("Stop", "Reason") == STOP_REASONS
    assert table("State_1", "State") == dict(enumerate(STATES))
    faults = table("State_1", "Fault")
    assert {key: faults[key] for key in range(len(FAULTS))} == dict(enumerate(FAULTS))


def test_loads_at_the_same_time_add_up_whatever_their_order() -> None:
    loads = [(1.0, 0.5, 0.6), (2.0, 0.2, 0.5), (0.5, 0.1, 1.0)]
    tables = ", ".join(f"{{mass_kg={mass}, at_s={at}, until_s={until}}}" for mass, at, until in loads)
    scenario = scenario_file.load("paper-joint", [f"load=[{tables}]"])
    assert payloads(scenario) == [
        (0.5, 100_000_000),
        (2.5, 200_000_000),
        (1.5, 500_000_000),
        (0.5, 600_000_000),
        (0.0, 1_000_000_000),
    ]


def test_an_action_delay_beyond_the_period_is_refused() -> None:
    with pytest.raises(ScenarioError, match="a current would act 1100 us after its cycle's start"):
        build_nodes(
            scenario_file.load("paper-joint", ["bus.fidelity=functional", "bus.action_delay_s=[0.0, 0.0, 0.0011]"])
        )
