"""The joint in C against the joint in Python: every answer, byte for byte and in order; the step, row by row."""

import shutil
import subprocess
import sys
from collections import Counter
from functools import cache
from random import Random
from types import SimpleNamespace

import numpy as np
import pytest

from dbc.compiler import load_arm
from firmware_py.joint_cpu import FAULTS, SIGNALS, STATES, TABLE_CRC, make_step
from firmware_py.words import Words
from hil.assemble import build_nodes
from hil.drive import Direct
from hil.rig import Recorder, make_kernel, run_inline
from hil.scenario_file import load
from tests.examples.chance import OF_A_RUN, Life
from tests.examples.conftest import ROOT, SOURCES, compile_replay, run
from tests.examples.transcript import Recorded, play, same
from tests.firmware_py.test_step import make_rows

IN_C = "joint2.cpu=examples.joint_c.node:CJoint"
FUNCTIONAL = "bus.fidelity=functional"
RUNS = ("paper-joint", "paper-task", "load-step")
LIVES = 120
CYCLES = 1000
JOINT_SIGNALS = 6
"""Those of law.c: its counts are the bus's, so the last two of SIGNALS have nothing to count there."""


@pytest.fixture(scope="module")
def codec():
    return load_arm()


# -- runs --


@cache
def record(name, *settings):
    """Run a scenario inline; return all frames, and the joints with what they were told and answered."""
    scenario = load(name, settings)
    kernel = make_kernel(scenario)
    recorder = Recorder(kernel, load_arm())
    nodes = [Recorded(each) if each.name.startswith("joint") else each for each in build_nodes(scenario, compiled=True)]
    for each in nodes:
        kernel.join(Direct(each))
    kernel.start()
    while not kernel.stopped and kernel.next_ns is not None:
        kernel.run(kernel.now_ns + scenario.period_ns)
    joints = [each for each in nodes if each.name.startswith("joint")]
    end_ns, identifier, data, _ = recorder.log.frames[-1]
    for each in joints:
        if not each.finished:  # the kernel stops with this frame; on a bus, everybody hears it
            each.on_frame(identifier, data, end_ns)
    return recorder.log, joints


@pytest.mark.parametrize("settings", [(), (FUNCTIONAL,)], ids=["bits", "functional"])
@pytest.mark.parametrize("name", RUNS)
def test_a_run_with_joint_2_in_c_is_the_same_run(built, monkeypatch, name, settings):
    """The whole frame log: what joint 2 sends, when, and what all others make of it."""
    monkeypatch.setenv("HIL_JOINT_LIBRARY", str(built.library))
    log, joints = record(name, *settings)
    c = run_inline(load(name, (*settings, IN_C)))
    assert c.log.frames == log.frames
    assert c.log.sha256() == log.sha256()
    assert c.reports["joint2"] == joints[1].report()


def fault(kind, **values):
    """Return a scenario's faults as an override."""
    items = ", ".join(f"{key} = {value!r}" for key, value in {"kind": kind, **values}.items()).replace("'", '"')
    return f"wire.faults=[{{{items}}}]"


FAULTY = {
    "lost encoders": fault("receive overrun", node="joint2", from_s=0.0504, to_s=0.0515),
    "two lost encoders": fault("receive overrun", node="joint2", from_s=0.0504, to_s=0.0525),
    "silence": fault("cut off", node="joint2", from_s=0.05, to_s=0.06),
    "late references": fault("queue delay", node="dsp", from_s=0.05, to_s=0.0515, delay_us=700.0),
    "no references": fault("queue delay", node="dsp", from_s=0.05, to_s=0.06, delay_us=900.0),
    "an encoder twice": fault("bit error", identifier=0x102, occurrence=160, bit=-2, at=["dsp"]),
    "saturation": "joint.limit_A=0.5",
}


@pytest.mark.parametrize("name", [*RUNS, "one-joint", "five-joints"])
def test_every_joint_of_a_run_is_played_by_the_core(built, sanitized, name):
    for joint in record(name)[1]:
        same(joint, built.replay)
        same(joint, sanitized)


@pytest.mark.parametrize("name", FAULTY)
def test_a_disturbed_run_too(built, short_settings, name):
    _, joints = record("paper-joint", *short_settings[1::2], FAULTY[name])
    counters = [value for key, value in joints[1].report().items() if key not in ("saturations", "skipped_status")]
    assert any(counters) or any(joints[1].report()["saturations"].values())
    for joint in joints:
        same(joint, built.replay)


# -- by chance --


@pytest.fixture(scope="module")
def lives(codec):
    """Transcripts by seed."""
    lived = []
    for seed in range(LIVES):
        life = Life(Random(seed), codec)
        states = Counter()
        for _ in range(CYCLES):
            life.live(1)
            states[STATES[life.cpu.state]] += 1
            if states["fault"] > 20:
                break
        lived.append((life, states))
    return lived


def test_chance_leads_everywhere(lives, codec):
    """What the comparison below would not see without it."""
    states = sum((states for _, states in lives), Counter())
    assert all(states[name] > 200 for name in STATES), states
    assert {life.cpu.fault for life, _ in lives} >= {FAULTS.index(name) for name in FAULTS[1:3]}
    for counter in ("crc_errors", "strikes", "missed_encoders", "repeated_encoders", "skipped_status"):
        assert sum(life.cpu.report()[counter] for life, _ in lives) > 30, counter
    saturations = [sum(life.cpu.words.saturations[n] for life, _ in lives) for n in range(len(SIGNALS))]
    assert [n for n, count in enumerate(saturations) if count > 30] == [2, 3, 4, 5]
    frames = Counter(codec.by_identifier[each].name.split("_")[0] for life, _ in lives for each, _ in life.joint.sent)
    assert min(frames[name] for name in ("Stop", "Current", "Acknowledge", "State", "Heartbeat")) > 100, frames


def test_every_answer_of_a_life_by_chance_is_the_same(built, lives):
    for seed, (life, _) in enumerate(lives):
        try:
            same(life.joint, built.replay)
        except AssertionError as error:
            error.add_note(f"seed {seed}")
            raise


def test_sanitizers_find_nothing(sanitized, lives):
    for life, _ in lives[::3]:
        same(life.joint, sanitized)


# -- the step --


def any_rows(count=100_000):
    """Rows over the whole range of every argument, constants that no scenario gives included."""
    rng = np.random.default_rng(20260101)

    def word(low=-0x8000):
        edges = rng.choice([low, low + 1, -1, 0, 1, 0x7FFE, 0x7FFF], count)
        return np.where(rng.random(count) < 0.3, edges, rng.integers(low, 0x8000, count))

    d = (word() << 16) + (word() & 0xFFFF)
    counts = word() & 0xFFFF, word() & 0xFFFF
    return (*counts, word(), d, word(), word(), word(), word(), rng.integers(0, 40, count), word(-0x7FFF))


@pytest.mark.parametrize("rows", [make_rows(OF_A_RUN), any_rows()], ids=["as in a run", "anything"])
def test_the_step_row_by_row(built, sanitized, rows):
    words = Words(16, len(SIGNALS))
    step = make_step(Words)
    truth = np.array([step(words, *row) for row in np.stack(rows).T.tolist()])
    table = np.stack(rows).T.astype(np.int32).tobytes()
    for program in (built.replay, sanitized):
        run = subprocess.run([str(program), "rows"], input=table, capture_output=True, timeout=120, check=False)
        assert run.returncode == 0, run.stderr.decode()
        results = np.frombuffer(run.stdout[: -4 * JOINT_SIGNALS], dtype=np.int32).reshape(-1, 4)
        assert len(results) == len(truth) >= 100_000
        wrong = np.flatnonzero((results != truth).any(axis=1))
        assert wrong.size == 0, f"{[int(c[wrong[0]]) for c in rows]}: {truth[wrong[0]]} in Python, {results[wrong[0]]}"
        assert (
            np.frombuffer(run.stdout[-4 * JOINT_SIGNALS :], dtype=np.uint32).tolist()
            == words.saturations[:JOINT_SIGNALS]
        )


# -- the tests, tested --

MUTATIONS = {
    "CRC-8 without the identifier": ("frames.c", "crc8_register(0xFF, identifier, 2)", "0xFF"),
    "CRC-16 of high bytes first": ("frames.c", "n % 2 ? value >> 8", "n % 2 == 0 ? value >> 8"),
    "State in every turn": ("frames.c", "turn % 2 == 0", "true"),
    "division toward zero": ("frames.c", "- (x % y < 0)", ""),
    "saturations of i alone": ("frames.c", "(uint16_t)saturations", "(uint16_t)joint->law.saturations[4]"),
    "Heartbeat counts nothing": ("frames.c", "joint->cycles++;", ""),
    "acknowledges what was asked": ("frames.c", "parameter->index < JOINT_PARAMETERS", "false"),
    "any database": ("joint.c", "parameter->version != VERSION", "false"),
    "the version asked for": ("frames.c", "answer.version = VERSION", "answer.version = parameter->version"),
    "any table": ("joint.c", "!usable(joint->law.table)", "false"),
    "parameters in run": ("joint.c", "joint->state == INIT || joint->state == READY", "joint->state != FAULT"),
    "ready with an old reference": (
        "joint.c",
        "joint->reference.full = false;\n        joint->strikes_in_a_row = 0;",
        "joint->strikes_in_a_row = 0;",
    ),
    "left out in silence": ("joint.c", "queue_stop(out);\n    }\n    joint->cycle", "}\n    joint->cycle"),
    "any reference": ("joint.c", "reference.cycle != (uint8_t)(cycle - 1)", "false"),
    "strikes for ever": ("joint.c", "joint->strikes_in_a_row = 0;\n        return true;", "return true;"),
    "the last fault": ("joint.c", "if (joint->state != FAULT)\n        joint->fault = fault;", "joint->fault = fault;"),
    "repeated frames answered": ("joint.c", "joint->state == RUN && encoder->cycle == joint->cycle", "false"),
    "no Stop in fault": ("joint.c", "joint->finished = true;\n        queue_stop(out);", "joint->finished = true;"),
    "Stop clears the fault": ("joint.c", "if (joint->state != FAULT) {\n        joint->state = INIT;", "{\n"),
    "a bump into run": ("joint.c", "joint->law.d = 0;", ""),
    "the timer one period late": ("joint.c", "now_ns + MISSES_TO_FAULT", "now_ns + (MISSES_TO_FAULT + 1)"),
    "half a difference rounds": ("law.c", "law->count_prev) >> 1", "law->count_prev) / 2"),
    "the shift floors": ("law.c", "((x >> (shift - 1)) + 1) >> 1", "x >> (shift > 31 ? 31 : shift)"),
}


@pytest.mark.parametrize("name", MUTATIONS)
def test_a_wrong_joint_is_found(built, lives, tmp_path, name):
    file, right, wrong = MUTATIONS[name]
    sources = tmp_path / "joint_c"
    shutil.copytree(SOURCES, sources, ignore=shutil.ignore_patterns("build", "__pycache__"))
    text = (sources / file).read_text()
    assert text.count(right) == 1
    (sources / file).write_text(text.replace(right, wrong))
    mutant = compile_replay(tmp_path / "mutant", built.folder, sources, ("-O1", "-Wno-unused"), [built.arm_object])
    found = (play(mutant, life.joint.calls)[0] != life.joint.reactions for life, _ in lives)
    assert any(found)


# -- what it refuses --


def set_up(life):
    """Give a joint its whole table."""
    life.seldom = lambda _probability: False
    for _ in range(TABLE_CRC + 1):
        life.cycle += 1
        life.parameter_frame()
        life.encoder_frame()


@pytest.mark.parametrize("values", [(3, -1), (4, -0x8000)], ids=["a shift to the left", "a limit beyond a word"])
def test_a_table_that_nobody_can_compute_with_is_a_fault(built, codec, values):
    life = Life(Random(1), codec)
    index, value = values
    life.table = tuple(value if at == index else each for at, each in enumerate(OF_A_RUN[0]))
    set_up(life)
    assert (STATES[life.cpu.state], FAULTS[life.cpu.fault]) == ("fault", "parameters")
    assert codec["Stop"].identifier in [identifier for _, identifier, _ in life.joint.reactions[-1][2]]
    same(life.joint, built.replay)


@pytest.mark.parametrize("version", [0, 2, 255])
def test_parameters_of_another_database_are_refused_by_both(built, codec, version):
    life = Life(Random(1), codec)
    pack = codec["Parameter_" + str(life.number)].pack
    life.parameter = SimpleNamespace(
        identifier=life.parameter.identifier, pack=lambda index, value, _own: pack(index, value, version)
    )
    set_up(life)
    answers = [data for identifier, data in life.joint.sent if codec.by_identifier[identifier].name.startswith("Ack")]
    assert len(answers) == TABLE_CRC + 1
    assert {data[3] for data in answers} == {codec.version}
    assert (STATES[life.cpu.state], FAULTS[life.cpu.fault], life.cpu.table) == ("init", "parameters", [0] * 5)
    same(life.joint, built.replay)


def test_board_made_from_another_database_ends_the_set_up(hil, tmp_path):
    """Built by its Makefile from a database that has gone on; joint 2 in the rig's process."""
    if shutil.which("cc") is None or shutil.which("make") is None:
        pytest.skip("NO C COMPILER: `cc` and `make` are not installed, so the joint in C is NOT TESTED")
    text = (ROOT / "dbc" / "arm.dbc").read_text()
    newer = tmp_path / "arm.dbc"
    newer.write_text(text.replace('VERSION "1"', 'VERSION "2"').replace('Version 1 "this', 'Version 2 "this'))
    cantools = f"CANTOOLS={sys.executable} -m cantools"
    run("make", "-C", SOURCES, f"BUILD={tmp_path / 'newer'}", cantools, f"DBC={newer}")
    ended = hil.run(
        *("run", "--inline", "--json", "--set", IN_C),
        env={"HIL_JOINT_LIBRARY": str(tmp_path / "newer" / "libjoint.so"), "PYTHONPATH": str(ROOT)},
    )
    assert ended.returncode == 6
    assert (
        "dsp: set-up failed (joint2 was made from version 2 of arm.dbc, the DSP from version 1: rebuild the board's "
        "code from dbc/arm.dbc)" in ended.stderr
    )


def test_a_library_that_is_not_there_says_how_to_make_it(monkeypatch, tmp_path):
    monkeypatch.setenv("HIL_JOINT_LIBRARY", str(tmp_path / "none.so"))
    with pytest.raises(Exception, match=r"none\.so is not there: make -C .*joint_c"):
        run_inline(load("paper-joint", (IN_C,)), compiled=False)


def test_the_core_needs_no_clock_no_heap_and_no_socket(built):
    """What the library takes from outside."""
    undefined = subprocess.run(["nm", "-D", "--undefined-only", str(built.library)], capture_output=True, text=True)
    names = {line.split()[-1].split("@")[0] for line in undefined.stdout.splitlines()}
    assert {each for each in names if not each.startswith("_")} <= {"memcpy", "memset"}
