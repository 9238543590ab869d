"""What lies on a board as joint 2 on SocketCAN, under MicroPython: over a socket pair in its place, and over vcan0."""

import shlex
import shutil
import struct
import subprocess
from contextlib import nullcontext
from types import SimpleNamespace

import pytest

from dbc.compiler import load_arm
from examples.joint_micropython import board
from hil.scenario_file import load
from tests.examples.conftest import HERE, STRICT, run
from tests.examples.test_joint_c import FUNCTIONAL, record
from tests.examples.test_joint_socketcan import (
    ACCEL_REF,
    ENCODER_2,
    EXACTLY,
    SHORT,
    STOP,
    other_way,
    play,
    since_the_first_reference,
    starter,
    tell,
    told,
)
from tests.lab.inside.kernel import alone
from tests.micropython import needed


@pytest.fixture(scope="module")
def fake(tmp_path_factory):
    if shutil.which("cc") is None:
        pytest.skip("NO C COMPILER: `cc` is not installed, so a board under MicroPython is NOT TESTED on SocketCAN")
    library = tmp_path_factory.mktemp("fake") / "fake_can.so"
    run("cc", *STRICT, "-shared", "-fPIC", "-o", library, HERE / "fake_can.c")
    return library


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    """A program that plays joint 2 at the interface that is its first word."""
    folder = tmp_path_factory.mktemp("board")
    board.lay_out(folder, board.joint_of(load("paper-joint"), 2))
    path = folder / "joint2"
    path.write_text(f'#!/bin/sh\ncd {shlex.quote(str(folder))}\nexec {shlex.quote(str(needed()))} main.py "$1"\n')
    path.chmod(0o755)
    return path


@pytest.fixture(params=["in its place", "vcan0"])
def joint2(script, fake, tmp_path, request):
    """A context: the board, on a CAN socket of this kind."""
    with nullcontext() if request.param == "in its place" else alone():
        yield starter(SimpleNamespace(program=script), fake, tmp_path, request)


@pytest.mark.parametrize("settings", [(), (*SHORT, "clock.setup_cycles=256")], ids=["whole", "a longer set-up"])
def test_a_run_is_answered_like_the_python_joint(joint2, settings):
    _, (_, python, _) = record("paper-joint", FUNCTIONAL, *settings)
    with joint2() as program:
        play(program, python)
        code, text = program.finish()
    assert program.sent == python.sent
    assert code == 0, text
    assert "joint2: the run is over" in text


def test_from_the_first_reference_on_the_cycle_is_known(joint2):
    _, (_, python, _) = record("paper-joint", FUNCTIONAL, *SHORT, "clock.setup_cycles=300")
    with joint2() as program:
        play(program, python)
        program.finish()
    assert since_the_first_reference(program.sent) == since_the_first_reference(python.sent)


@pytest.mark.parametrize(("first", "second"), [(ACCEL_REF, ENCODER_2), (ENCODER_2, ACCEL_REF)])
def test_encoder_is_answered_with_the_reference_of_the_cycle_before(joint2, first, second):
    _, (_, python, _) = record("paper-joint", FUNCTIONAL, *SHORT)
    frames = other_way(told(python), first, second)
    assert frames != told(python)
    with joint2() as program:
        tell(program, frames)
        code, text = program.finish()
    assert program.sent == python.sent
    assert code == 0, text


def test_what_was_asked_twice_before_the_run_counts_once_and_a_stop_before_all_of_it_not_at_all(joint2):
    _, (_, python, _) = record("paper-joint", FUNCTIONAL, *SHORT)
    frames = told(python)
    first = next(at for at, (identifier, _) in enumerate(frames) if identifier == ACCEL_REF)
    again = [frame for frame in frames[:first] for _ in range(1 + (frame[0] == ENCODER_2))]
    with joint2() as program:
        tell(program, [(STOP, bytes([1])), *again, *frames[first:]])
        code, text = program.finish()
    assert len(program.sent) > len(python.sent)
    assert since_the_first_reference(program.sent) == since_the_first_reference(python.sent)
    assert code == 0, text


def test_a_damaged_frame_is_not_answered_and_a_fault_is_the_end(joint2):
    """Encoder and AccelRef with a wrong byte; then three cycles without Encoder."""
    _, (_, python, _) = record("paper-joint", FUNCTIONAL, *SHORT)
    frames = told(python)
    start = next(at for at, (identifier, _) in enumerate(frames) if identifier == ACCEL_REF) + 12
    damaged = [(identifier, bytes([data[0] ^ 1]) + data[1:]) for identifier, data in frames[start : start + 2]]
    with joint2() as program:
        tell(program, frames[:start])
        before = len(program.sent)
        for frame in (*damaged, *frames[start + 8 : start + 10]):
            program.send(*frame)
        code, text = program.finish()
    assert (STOP, bytes([2])) in program.sent[before:]
    assert code == 6, text
    assert "'fault': 'encoder lost'" in text
    assert "'crc_errors': 1" in text


def test_it_asks_for_its_four_identifiers_and_no_more(joint2, tmp_path):
    with joint2():
        pass
    if not (tmp_path / "filters").exists():
        pytest.skip("the kernel's filters cannot be read back")
    filters = set(struct.iter_unpack("=II", (tmp_path / "filters").read_bytes()))
    codec = load_arm()
    wanted = [codec[name].identifier for name in ("Stop", "Encoder_2", "AccelRef", "Parameter_2")]
    assert filters == {(identifier, EXACTLY) for identifier in wanted}


def test_an_interface_that_is_not_there_is_named(script, fake, tmp_path, monkeypatch):
    for name, value in {"LD_PRELOAD": fake, "FAKE_CAN_FD": 9, "FAKE_CAN_FILTERS": tmp_path / "filters"}.items():
        monkeypatch.setenv(name, str(value))
    done = subprocess.run([script, "can7"], capture_output=True, text=True, check=False)
    assert done.returncode == 4
    assert done.stderr == "joint2: can7 is not there: `ip -br link` lists the interfaces\n"
