"""The joint CPU's source under MicroPython against the same in Python: runs by frame log, lives by chance, the step."""

import gc
import os
import re
import signal
import struct
import tempfile
import time
from pathlib import Path
from random import Random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dbc.compiler import load_arm
from dbc.crc import crc16
from examples.joint_micropython import board, process
from examples.joint_micropython.node import MicroPythonJoint
from examples.joint_micropython.on_board.codec import Message
from firmware_py.joint_cpu import CURRENT, ERROR, KB_DW, SIGNALS, D, make_step
from firmware_py.words import Words
from hil.bus_rig import run_on_bus
from hil.can_node import Place
from hil.errors import NodeError
from hil.processes import run_processes
from hil.rig import run_inline
from hil.scenario_file import load
from hil.word_format import words_of
from tests.conftest import SHORT
from tests.examples.chance import OF_A_RUN, Life
from tests.examples.test_joint_c import FAULTY, FUNCTIONAL, any_rows
from tests.examples.transcript import CALL
from tests.firmware_py.test_step import make_rows
from tests.lab.inside import rig
from tests.micropython import ROOT, needed, steps

CPU = "examples.joint_micropython.node:MicroPythonJoint"
LIVES, CYCLES = 30, 600
LIMIT_S = 60.0


@pytest.fixture(autouse=True)
def boards(monkeypatch, tmp_path):
    """The processes that play a board, by process id; behind each test there are none."""
    monkeypatch.setenv("HIL_MICROPYTHON", str(needed()))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def there():
        places = {path.name: place for path in Path("/proc").glob("[0-9]*") if (place := read_link(path / "cwd"))}
        return [int(pid) for pid, place in places.items() if place.startswith(f"{tmp_path}/hil-board-")]

    yield there
    gc.collect()
    wait_for(lambda: not there())


def read_link(path):
    """Return where a process is; nothing for one that has gone, or is somebody else's."""
    try:
        return os.readlink(path)
    except OSError:
        return ""


def wait_for(condition):
    deadline = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < deadline, "waited too long"
        time.sleep(0.01)


# -- runs --

RUNS = {
    "paper-joint": ("paper-joint", "joint2"),
    "all joints": ("paper-joint", "joint", *SHORT),
    "load-step": ("load-step", "joint3", FUNCTIONAL),
    "the second AccelRef": ("five-joints", "joint5", "duration_s=0.2"),
    "words of 12 bits": ("paper-joint", "joint", *SHORT, "joint.word.bits=12", "joint.word.round_d=convergent"),
    **{
        name: ("paper-joint", "joint2", *SHORT, FAULTY[name]) for name in ("two lost encoders", "silence", "saturation")
    },
}


@pytest.mark.parametrize("name", RUNS)
def test_a_run_with_a_joint_under_micropython_is_the_same_run(name):
    scenario, joint, *settings = RUNS[name]
    python = run_inline(load(scenario, settings))
    under = run_inline(load(scenario, (*settings, f"{joint}.cpu={CPU}")))
    assert under.log.frames == python.log.frames
    assert under.log.sha256() == python.log.sha256()
    assert under.reports == python.reports


def test_as_processes_it_is_the_same_run():
    python = run_inline(load("paper-joint", SHORT))
    under = run_processes(load("paper-joint", (*SHORT, f"joint2.cpu={CPU}")), "arm")
    assert under.log.sha256() == python.log.sha256()


def test_as_an_external_joint_it_changes_nothing(hil):
    """`hil node joint 2` beside a rig that waits for it, on a bus without shared time."""
    settings = (*SHORT, "clock.setup_cycles=60")
    words = [word for setting in (*settings, f"joint2.cpu={CPU}") for word in ("--set", setting)]
    hil.bus("street")
    joint = hil.start("node", "joint", "2", "-c", "street", "--clock", "sync", *words)
    outcome = run_on_bus(load("paper-joint", settings), Place("hil", "street", {}), ["joint2"], patience_s=LIMIT_S)
    _, complaint = joint.communicate(timeout=LIMIT_S)
    assert joint.returncode == 0, complaint
    assert rig.of(outcome) == rig.of(run_inline(load("paper-joint", (*settings, FUNCTIONAL))))


# -- by chance --


def replay(life):
    """Return what a joint under MicroPython answers to what this life's joint was told, and says at the end of it."""
    cpu, frame = life.cpu, life.accel_ref.name
    words, times_ns = Words(16, len(SIGNALS)), (cpu.period_ns, cpu.compute_ns)
    node = MicroPythonJoint(life.number, words, life.codec, crc16, cpu.status, (frame, life.place), *times_ns)
    reactions = [node.on_start(0)]
    for each in life.joint.calls[1:]:
        kind, length, _, _, identifier, now_ns, data, _, _ = CALL.unpack(each)
        if chr(kind) == "s":
            node.store(identifier, data[:length], now_ns)
        elif chr(kind) == "f":
            reactions.append(node.on_frame(identifier, data[:length], now_ns))
        else:
            reactions.append(node.on_timer(now_ns))
    return reactions, node.finished, node.report()


@pytest.mark.parametrize("seeds", [range(k, LIVES, 4) for k in range(4)], ids=str)
def test_every_answer_of_a_life_by_chance_is_the_same(seeds):
    """Chance leads everywhere: tests/examples/test_joint_c.py says so of these lives."""
    for seed in seeds:
        life = Life(Random(seed), load_arm())
        life.live(CYCLES)
        reactions, finished, report = replay(life)
        assert reactions == [(0, None, []), *life.joint.reactions], f"seed {seed}"
        assert (finished, report) == (life.cpu.finished, life.cpu.report()), f"seed {seed}"


# -- the step --


def test_the_step_row_by_row():
    """As in a run, and over the whole range: a tenth of what the 8086's test takes (tests/hil/i8086)."""
    rows = np.concatenate([np.stack(each).T[::20] for each in (make_rows(OF_A_RUN), any_rows())])
    assert len(rows) >= 10_000
    words = Words(16, len(SIGNALS))
    step = make_step(Words)
    results, saturations = steps(rows)
    before = np.zeros(len(SIGNALS), int)
    for at, row in enumerate(rows.tolist()):
        assert results[at].tolist() == list(step(words, *row)), row
        assert (before + saturations[at]).tolist() == words.saturations, row
        before += saturations[at]
    assert before[[KB_DW, D, CURRENT, ERROR]].min() > 100


# -- what may go wrong --


def test_without_the_program_it_is_said_how_to_get_it(hil, tmp_path, monkeypatch):
    monkeypatch.setenv("HIL_MICROPYTHON", str(tmp_path / "none"))
    ended = hil.run("run", "--set", f"joint2.cpu={CPU}")
    assert ended.returncode == 5
    assert "none is not there: install MicroPython's unix port" in " ".join(ended.stderr.split())
    assert "Traceback" not in ended.stderr
    monkeypatch.setenv("HIL_MICROPYTHON", "")
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(NodeError, match=r"micropython is not there: .* HIL_MICROPYTHON=/path/to/micropython"):
        process.program()


FAULTY_PROGRAMS = {
    "echo hello; exec sleep 100": "joint2: MicroPython said b'hello\\n' where an answer was due",
    "sleep 100; true": "joint2: MicroPython has not answered for 0.3 s",
    "echo no memory >&2; exit 3": "joint2: MicroPython has ended (exit code 3): no memory",
    "exec 0<&- 1>&-; sleep 100": "joint2: MicroPython has ended (it closed its stdout): it said nothing",
    "printf '\\204'; exit 4": "joint2: MicroPython has ended (exit code 4): it said nothing",
}


@pytest.mark.parametrize("text", FAULTY_PROGRAMS)
def test_a_program_that_does_not_answer_ends_the_run_with_the_reason(monkeypatch, tmp_path, text):
    script = tmp_path / "micropython"
    script.write_text(f"#!/bin/sh\n{text}\n")
    script.chmod(0o755)
    monkeypatch.setenv("HIL_MICROPYTHON", str(script))
    monkeypatch.setattr(process, "PATIENCE_S", 0.3)
    monkeypatch.setattr(process, "END_S", 0.3)
    with pytest.raises(NodeError, match=re.escape(FAULTY_PROGRAMS[text])):
        run_inline(load("paper-joint", (*SHORT, f"joint2.cpu={CPU}")), compiled=False)


def test_what_is_no_program_is_named(monkeypatch, tmp_path):
    script = tmp_path / "micropython"
    script.write_bytes(b"\x7fELF")
    script.chmod(0o755)
    monkeypatch.setenv("HIL_MICROPYTHON", str(script))
    with pytest.raises(NodeError, match=f"joint2: {script} cannot be started: Exec format error"):
        run_inline(load("paper-joint", (*SHORT, f"joint2.cpu={CPU}")), compiled=False)


@pytest.mark.parametrize("mode", [run_inline, lambda *words: run_processes(words[0], "arm", words[1])])
def test_a_board_that_is_killed_in_the_middle_ends_the_run(boards, mode):
    def kill(share):
        if share >= 0.5:
            for pid in boards():
                os.kill(pid, signal.SIGKILL)

    with pytest.raises(NodeError, match=r"joint2: MicroPython has ended \(exit code -9\): it said nothing"):
        mode(load("paper-joint", (*SHORT, f"joint2.cpu={CPU}")), kill)


def test_a_board_ends_with_a_rig_that_is_killed(hil, boards):
    rig = hil.start("run", "--inline", "--set", "duration_s=1000", "--set", f"joint2.cpu={CPU}")
    wait_for(boards)
    rig.kill()
    rig.wait()
    wait_for(lambda: not boards())


# -- what lies on a board --


def test_sources_on_a_board_are_ours_to_the_byte(tmp_path):
    board.lay_out(tmp_path / "board", board.joint_of(load("paper-joint"), 1))
    for name in ("firmware_py/joint_cpu.py", "firmware_py/words.py", "dbc/crc.py", "dbc/status.py"):
        assert (tmp_path / "board" / name).read_bytes() == (ROOT / name).read_bytes()


@pytest.mark.parametrize("name", ["Stop", "Encoder_2", "AccelRef", "Acknowledge_2", "Heartbeat_2"])
@given(data=st.data())
def test_its_codec_is_the_benchs(name, data):
    """Frames that are sound, and any bytes."""
    theirs = load_arm()[name]
    ours = Message(theirs.identifier, theirs.formats, theirs.protected)
    sizes = {code: 8 * struct.calcsize(code) for code in theirs.formats}
    low = {code: -(1 << sizes[code] - 1) if code.islower() else 0 for code in sizes}
    values = [data.draw(st.integers(low[code], low[code] + (1 << sizes[code]) - 1)) for code in theirs.formats]
    frame = theirs.pack(*values)
    assert ours.pack(*values) == frame
    for each in (frame, frame[:-1], frame + b"\0", data.draw(st.binary(max_size=8))):
        assert ours.unpack(each) == theirs.unpack(each)


FORMATS = (
    (),
    ("joint.word.bits=12", "joint.word.round_d=convergent"),
    ("joint.word.bits=24", "joint.word.kb_fraction=fit"),
    ("joint.word.overflow=wrap", "joint.word.d_fraction=9"),
)


@pytest.mark.parametrize("settings", FORMATS, ids=str)
def test_words_are_made_again_from_their_formats(settings):
    words = words_of(load("paper-joint", settings), load_arm())
    assert vars(Words(*board.formats(words))) == vars(words)


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (["DIR", "--joint", "4"], 3, "no node 'joint4': this scenario has"),
        (["DIR", "--scenario", "no-such"], 3, "no-such"),
        (["DIR", "--scenario", "drift"], 3, "joint2 of drift is not the joint CPU as it stands"),
        (["/proc/none"], 7, "/proc/none cannot be written: No such file or directory"),
        ([], 2, "DIR"),
    ],
)
def test_wrong_words_are_refused(tmp_path, capfd, words, code, text):
    arguments = [str(tmp_path / "board") if word == "DIR" else word for word in words]
    try:
        ended = board.main(arguments)
    except SystemExit as leaving:
        ended = leaving.code
    assert (ended, text in capfd.readouterr().err) == (code, True)
    assert not (tmp_path / "board").exists()
