"""A scenario's cycle bounded and measured: against the frame log, the budget, by hand, and at random."""

import json
import random
from typing import Any

import numpy as np
import pytest

from firmware_py.joint_cpu import JointCPU
from hil import constants, scenario_file
from hil.paper.frequency_response import action_instants
from hil.rig import run_inline
from hil.timing.response_time import Errors
from hil.timing.rig_analysis import Analysis
from hil.timing.rig_cycle import Rates, by_joints, cycle_of, lowest_bitrate
from hil.timing.study import Study, study
from hil.timing.timeline import run_with_timeline

DATA_BIT_NS = 250
SHORT = ("duration_s=0.1", "trajectory.time_s=0.1", "trajectory.by_rad=[0.05,-0.05,0.05]")


def loaded(name: str = "paper-joint", *settings: str):
    return scenario_file.load(name, settings)


@pytest.fixture(scope="module")
def paper_joint() -> Study:
    return study(loaded(), DATA_BIT_NS)


def rows(found: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {row["name"]: row for row in found["messages"]}


# -- bounds --


@pytest.mark.parametrize("name", ["paper-joint", "one-joint", "two-joints", "five-joints"])
def test_ends_are_those_of_the_budget(name: str) -> None:
    """hil/constants.py lays the longest frames of a cycle behind one another, to refuse what does not fit."""
    scenario = loaded(name)
    worst = Analysis(scenario, DATA_BIT_NS).worst
    assert worst is not None
    budget = constants.worst_case_ends_ns(scenario)
    del budget["State"]  # laid there at once behind the others, and in truth queued 160 us before the cycle's end
    assert {name: worst[name].end_ns for name in budget} == budget
    assert worst["State"].end_ns == scenario.period_ns - constants.tail_ns(scenario) + 132_000


def test_every_frame_of_the_paper_s_rig_meets_its_deadline(paper_joint: Study) -> None:
    found = paper_joint.found
    assert found["meets_deadlines"]
    assert found["utilisation"] == pytest.approx((65 + 3 * 95 + 3 * 115 + 2 * 135) / 1000)
    for row in found["messages"]:
        assert row["response_max_s"] <= row["response_bound_actual_s"] <= row["response_bound_s"] <= row["deadline_s"]
        assert row["response_bound_fd_s"] < row["response_bound_s"]
        assert row["bits_max"] <= row["bits_worst"]
    shares = [row["max_to_bound_actual"] for row in found["messages"]]
    assert np.median(shares) >= 0.95
    assert min(shares) > 0.85  # Current_3 and AccelRef: all that may come first never comes at its longest at once


def test_messages_of_the_run_are_there_and_no_others(paper_joint: Study) -> None:
    status = [f"{kind}_{n}" for kind in ("State", "Heartbeat") for n in (0, 1, 2, 3, 7)]
    cyclic = ["Sync", *(f"Encoder_{n}" for n in (1, 2, 3)), *(f"Current_{n}" for n in (1, 2, 3)), "AccelRef"]
    assert [row["name"] for row in paper_joint.found["messages"]] == [*cyclic, *status]
    counts = {row["name"]: row["response"]["count"] for row in paper_joint.found["messages"]}
    assert {counts[name] for name in cyclic} == {1500}
    assert {counts[name] for name in status} == {150}
    assert {row["period_s"] for row in paper_joint.found["messages"]} == {0.001, 0.01}


def test_a_first_frame_waits_for_nothing_and_a_second_for_the_first(paper_joint: Study) -> None:
    """Sync 58 to 60 bits and intermission; Encoder_1, queued with it, ends one frame later."""
    assert paper_joint.timeline is not None
    frames = [f for f in paper_joint.timeline.between(0, 10**9) if f.identifier in (0x080, 0x101)]
    for sync, encoder in zip(frames[::2], frames[1::2], strict=True):
        assert (sync.identifier, encoder.identifier) == (0x080, 0x101)
        assert sync.queued_ns == sync.starts_ns == encoder.queued_ns
        assert encoder.starts_ns == sync.ends_ns + 3000


@pytest.mark.parametrize("name", ["paper-joint", "five-joints"])
def test_no_node_has_more_frames_waiting_than_said(name: str) -> None:
    """Frames of a node that wait or are on the bus at once, counted from the timeline."""
    found = study(loaded(name, "duration_s=0.2"), DATA_BIT_NS)
    assert found.timeline is not None
    most = {}
    for node in ("plant", "dsp", "joint1"):
        own = [frame for frame in found.timeline.frames if frame.sender == node and frame.queued_ns >= 0]
        edges = sorted([(f.queued_ns, 1) for f in own] + [(f.ends_ns, -1) for f in own])
        most[node] = max(np.cumsum([step for _, step in edges]))
    queues = {each["node"]: each for each in found.found["queues"]}
    assert most["plant"] == loaded(name).joints
    assert all(most[node] <= queues[node]["frames_at_most"] for node in most)
    assert all(each["holds"] and each["depth"] == 10 for each in queues.values())


# -- bit rates and joints --


def test_a_cycle_holds_at_the_lowest_bit_rate_and_not_a_nanosecond_above() -> None:
    cycle = cycle_of(loaded())
    lowest = lowest_bitrate(cycle)
    assert lowest == 965_251
    bit_ns = round(10**9 / lowest)
    assert cycle.fits(Rates(bit_ns))
    assert not cycle.fits(Rates(bit_ns + 1))


def test_where_the_rig_fails_by_joints() -> None:
    """Three joints fill a cycle of 1 ms; CAN FD bears all six. With each joint it takes more."""
    found = by_joints(cycle_of(loaded()), DATA_BIT_NS)
    assert [row["joints"] for row in found] == [1, 2, 3, 4, 5, 6]
    assert [row["lowest_bitrate"] is None for row in found] == [False] * 3 + [True] * 3
    for kind in ("lowest_bitrate", "lowest_bitrate_fd"):
        rates = [row[kind] for row in found if row[kind] is not None]
        assert rates == sorted(rates)
    assert found[5]["lowest_bitrate_fd"] < 10**6


def test_errors_take_their_time() -> None:
    worst = Analysis(loaded("one-joint"), DATA_BIT_NS, Errors(1, 10**8)).worst
    plain = Analysis(loaded("one-joint"), DATA_BIT_NS).worst
    assert worst is None  # State, queued 160 us before the cycle's end, has no room for a repetition
    assert plain is not None
    slow = loaded("one-joint", "clock.period_s=0.002", "joint.g_rad_s=350")
    assert Analysis(slow, DATA_BIT_NS, Errors(1, 10**8)).late == "State"


# -- chains --


def test_chains_are_those_of_the_frame_log(paper_joint: Study) -> None:
    """The frame log of a plain run has the ends of all frames; parts add up to them, cycle by cycle, to the ns."""
    instants = action_instants(run_inline(loaded()))
    samples = np.arange(1500) * 1e-3
    for n, chain in enumerate(paper_joint.chains[:3]):
        assert chain.lasts_ns == pytest.approx((instants[:, n] - samples) * 1e9, abs=1e-3)
    for n, chain in enumerate(paper_joint.chains[3:]):
        assert chain.lasts_ns == pytest.approx((instants[1:, n] - samples[:-1]) * 1e9, abs=1e-3)


def test_chains_stay_within_their_bounds(paper_joint: Study) -> None:
    for chain in paper_joint.found["chains"]:
        assert chain["measured"]["max_s"] <= chain["bound_s"] <= chain["deadline_s"]
        assert chain["misses"] == {"bus": 0, "computing": 0, "drive": 0, "host": 0}
        assert chain["jitter_s"] == pytest.approx(chain["measured"]["max_s"] - chain["measured"]["min_s"])
        assert sum(part["mean_s"] for part in chain["parts"]) <= chain["measured"]["max_s"]
    computes = [part["max_s"] for chain in paper_joint.found["chains"][:3] for part in chain["parts"][2:3]]
    assert computes == [125e-6] * 3


def test_a_drive_s_dead_time_is_the_last_part() -> None:
    """As mean_delays has it of the frame log; the bound holds the whole jitter."""
    settings = ("drive.dead_time_s=[1e-4,0.0,2e-4]", "drive.dead_time_jitter_s=[0.0,0.0,1e-4]")
    scenario = loaded("paper-joint", *SHORT, *settings)
    chains = study(scenario, DATA_BIT_NS).chains
    instants = action_instants(run_inline(scenario)) - np.arange(100)[:, None] * 1e-3
    for n in range(3):
        assert chains[n].lasts_ns == pytest.approx(instants[:, n] * 1e9, abs=1e-3)
        assert chains[n].parts[-1].name == f"drive {n + 1}: dead time"
        assert chains[3 + n].parts[-1].name == f"drive {n + 1}: dead time"
    assert [chain.bound_ns for chain in chains[:3]] == [562_000, 577_000, 992_000]


class Slow(JointCPU):
    """A CPU that takes 900 us in every hundredth cycle, whatever it was declared with."""

    def on_frame(self, identifier, data, now_ns):
        busy_ns, timer_ns, sends = super().on_frame(identifier, data, now_ns)
        late_ns = 900_000 if data[2] % 100 == 50 else 0
        return max(busy_ns, late_ns), timer_ns, [(max(delay, late_ns), i, d) for delay, i, d in sends]


def test_misses_by_cause() -> None:
    slow = study(loaded("paper-joint", *SHORT, f"joint2.cpu={__name__}:Slow"), DATA_BIT_NS)
    assert slow.found["chains"][1]["misses"] == {"bus": 0, "computing": 1, "drive": 0, "host": 0}
    assert slow.found["chains"][0]["misses"] == {"bus": 0, "computing": 0, "drive": 0, "host": 0}
    lost = 'wire.faults=[{kind="cut off", node="joint3", from_s=0.0502, to_s=0.0509}]'
    bus = study(loaded("paper-joint", *SHORT, lost), DATA_BIT_NS)
    assert bus.found["chains"][2]["misses"]["bus"] >= 1
    assert bus.found["chains"][2]["misses"]["computing"] == 0


def test_a_dead_time_that_takes_a_current_beyond_its_deadline_is_the_drive_s(hil: Any) -> None:
    """Joint 1's currents come 0.40 to 0.42 ms behind their samples."""
    late = "drive.dead_time_s=[0.0007,0.0,0.0]"
    found = study(loaded("paper-joint", *SHORT, late), DATA_BIT_NS).found
    assert found["chains"][0]["misses"] == {"bus": 0, "computing": 0, "drive": 100, "host": 0}
    assert sum(found["chains"][1]["misses"].values()) == 0
    words = [word for setting in (*SHORT, late) for word in ("--set", setting)]
    run = hil.run("timing", "paper-joint", "--bus", *words)
    assert run.returncode == 6
    assert run.stderr.endswith("hil: deadlines missed: joint1: sample to action, joint1: sample, DSP, action\n")


def test_cycles_that_never_were_are_not_missed() -> None:
    """Joint 2 is cut off for good in cycle 50; three silent periods later the plant stops the run."""
    cut = 'wire.faults=[{kind="cut off", node="joint2", from_s=0.0504}]'
    found = study(loaded("paper-joint", *SHORT, cut), DATA_BIT_NS).found
    assert 53 <= found["cycles"] <= 55
    assert [sum(chain["misses"].values()) for chain in found["chains"][:3]] == [0, found["cycles"] - 50, 0]
    assert found["chains"][1]["misses"]["bus"] == found["cycles"] - 50


def test_what_is_beyond_its_bound_is_said(hil: Any) -> None:
    words = [word for setting in SHORT for word in ("--set", setting)]
    noise = 'wire.faults=[{kind="bit error rate", rate=1e-4}]'
    run = hil.run("timing", "paper-joint", "--bus", *words, "--set", noise)
    assert "bounds are those of an undisturbed bus: see --burst" in run.stdout
    assert "beyond their bounds" not in hil.run("timing", "paper-joint", "--bus", *words).stdout


def test_where_one_frame_may_be_late_nothing_is_said_of_the_others() -> None:
    found = study(loaded("paper-joint", "bus.bitrate=800000"), DATA_BIT_NS).found
    verdicts = {row["name"].partition("_")[0]: row["meets_deadline"] for row in found["messages"]}
    assert (found["late"], found["meets_deadlines"]) == ("State", False)
    assert verdicts == {**dict.fromkeys(("Sync", "Encoder", "Current", "AccelRef")), "State": False, "Heartbeat": False}
    assert all(queue["holds"] is None for queue in found["queues"])


# -- at random --


@pytest.mark.parametrize("seed", range(12))
def test_no_scenario_goes_beyond_its_bounds(seed: int) -> None:
    """Any number of joints, bit rates, periods, computing times: what runs stays within, frame by frame."""
    drawn = random.Random(seed)
    base = drawn.choice(["one-joint", "two-joints", "paper-joint", "five-joints"])
    joints = loaded(base).joints
    period_s = drawn.choice([0.002, 0.004])
    settings = [
        "joint.g_rad_s=100",
        f"clock.period_s={period_s}",
        f"duration_s={50 * period_s}",
        f"bus.bitrate={drawn.choice([500_000, 800_000, 1_000_000])}",
        f"dsp.compute_s={drawn.randint(0, 400)}e-6",
        *(f"joint{n}.compute_s={drawn.randint(0, 400)}e-6" for n in range(1, joints + 1)),
    ]
    scenario = loaded(base, *settings)
    worst = Analysis(scenario, DATA_BIT_NS).worst
    if worst is None:
        return
    found = study(scenario, DATA_BIT_NS).found
    for row in found["messages"]:
        assert row["response_max_s"] <= row["response_bound_actual_s"] <= row["response_bound_s"]
    for chain in found["chains"]:
        assert chain["measured"]["max_s"] <= chain["bound_s"]


def test_a_timeline_changes_nothing() -> None:
    scenario = loaded("paper-joint", *SHORT)
    outcome, timeline = run_with_timeline(scenario)
    assert outcome.log.sha256() == run_inline(scenario).log.sha256()
    ended = [(f.ends_ns, f.identifier, f.data, f.sender) for f in timeline.frames if f.ends_ns >= 0]
    assert ended == outcome.log.frames


# -- the command --


def test_the_command_says_it_all_as_json(hil: Any) -> None:
    run = hil.run("timing", "one-joint", "--json", "--set", "duration_s=1.0")
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout)
    assert rows(found)["Current_1"]["response_bound_s"] == pytest.approx(115e-6)
    assert {"name", "identifier", "period_s", "deadline_s", "bits_worst", "response_bound_s", "response_max_s"} <= (
        found["messages"][0].keys()
    )


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        ((), 2, "name a scenario, for example paper-joint, or a database with --dbc"),
        (("paper-joint", "--dbc", "x.dbc"), 2, "one of both"),
        (("paper-joint", "--bitrate", "500000"), 2, "--bitrate does not go with a scenario, which has its own"),
        (("paper-joint", "--pace", "0.5"), 2, "--pace does not go with the rig's own bus: name another with --channel"),
        (("paper-joint", "--error-interval", "5"), 2, "--error-interval does not go with no errors"),
        (("paper-joint", "--set", "clock.kind=nonsense"), 3, "clock.kind"),
        (("paper-joint", "--set", "joint1.compute_s=0.00045"), 3, "not run: the frames of one cycle need"),
        (("--dbc", "x.dbc", "--out", "there"), 2, "--out does not go with --dbc"),
        (("paper-jont",), 3, "no scenario 'paper-jont'"),
        (("paper-joint", "--set", "bus.fidelity=functional"), 3, "frames take no time"),
        (("paper-joint", "--set", "bus.bitrate=800000"), 6, "State may not end within clock.period_s = 0.001"),
        (("paper-joint", "--data-bitrate", "3000000"), 2, "--data-bitrate 3000000: a bit lasts"),
        (("paper-joint", "-i", "socketcan"), 2, "needs --channel"),
    ],
)
def test_what_cannot_be_is_said(hil: Any, words: tuple[str, ...], code: int, says: str) -> None:
    run = hil.run("timing", *words)
    assert run.returncode == code
    assert says in " ".join(run.stderr.replace("│", " ").split())
    assert "Traceback" not in run.stderr
