"""The program in C as joint 2, over vcan0 and two cards where there are such, and over a socket pair in their place."""

import os
import socket
import struct
import subprocess
from contextlib import contextmanager, nullcontext

import pytest

from dbc.compiler import load_arm
from tests.examples.conftest import HERE, STRICT, run
from tests.examples.test_joint_c import FUNCTIONAL, record
from tests.examples.transcript import CALL
from tests.lab.inside.kernel import alone

FRAME = struct.Struct("=IB3x8s")
"""struct can_frame."""

CURRENT_2, ENCODER_2, ACCEL_REF, STOP = 0x122, 0x102, 0x130, 0x010
EXACTLY = 0x7FF | 1 << 31 | 1 << 30
SHORT = ("duration_s=0.2", "trajectory.time_s=0.15", "trajectory.by_rad=[0.05, -0.05, 0.05]")


@pytest.fixture(scope="module")
def fake(built):
    library = built.folder / "fake_can.so"
    run("cc", *STRICT, "-shared", "-fPIC", "-o", library, HERE / "fake_can.c")
    return library


class Program:
    """The program, and the other end of its socket."""

    def __init__(self, process, end):
        self.process, self.end = process, end
        self.sent = []

    def send(self, identifier, data):
        self.end.send(FRAME.pack(identifier, len(data), data))

    def receive(self):
        identifier, length, data = FRAME.unpack(self.end.recv(FRAME.size))
        self.sent.append((identifier, data[:length]))
        return identifier

    def answer(self):
        """Wait for a Current: State and Heartbeat of the cycle before come first."""
        while self.receive() != CURRENT_2:
            pass

    def finish(self):
        """Return its exit code and what it printed; take what it still sent."""
        text = self.process.communicate(timeout=10)
        self.end.settimeout(0.2)
        try:
            while True:
                self.receive()
        except (TimeoutError, struct.error):  # no more; the other end is closed
            return self.process.returncode, "".join(text)


def interfaces(kind):
    """Return (ours, the program's); skip where there is no such interface. HIL_LAB_CARDS: two cards on one bus."""
    ours, theirs = ("vcan0", "vcan0") if kind == "vcan0" else (os.environ.get("HIL_LAB_CARDS", "") + ",").split(",")[:2]
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as probe:
            probe.bind((ours,))
    except OSError as error:
        pytest.skip(f"no {kind} here: {error}")
    return ours, theirs


def can_socket(kind, fake, filters):
    """Return our end, the program's interface, what its environment must say, and what it inherits."""
    if kind != "in its place":
        ours, theirs = interfaces(kind)
        end = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        end.bind((ours,))
        return end, theirs, {}, None
    end, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    environment = {"LD_PRELOAD": str(fake), "FAKE_CAN_FD": str(other.fileno()), "FAKE_CAN_FILTERS": str(filters)}
    return end, "vcan0", environment, other


@pytest.fixture(params=["in its place", "vcan0", "cards"])
def program(built, fake, tmp_path, request):
    """A context: the program with these arguments, on a CAN socket of this kind."""
    with nullcontext() if request.param == "in its place" else alone():
        yield starter(built, fake, tmp_path, request)


def starter(built, fake, tmp_path, request):
    @contextmanager
    def start(*arguments):
        end, interface, environment, other = can_socket(request.param, fake, tmp_path / "filters")
        end.settimeout(10)
        process = subprocess.Popen(
            [str(built.program), interface, *arguments],
            env=os.environ | environment,
            pass_fds=() if other is None else (other.fileno(),),
            text=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        if other is not None:
            other.close()
        with end, process:
            try:
                assert "waits for the set-up" in process.stdout.readline()
                yield Program(process, end)
            finally:
                process.kill()

    return start


def play(program, joint):
    """Tell the program what the joint was told, frame by frame, each answered before the next."""
    for call in joint.calls:
        kind, length, _, _, identifier, _, data, _, _ = CALL.unpack(call)
        if chr(kind) in "sf":
            program.send(identifier, data[:length])
        if chr(kind) == "f":
            program.answer()


@pytest.mark.parametrize("name", ["paper-joint", "paper-task"])
def test_a_whole_run_is_answered_like_the_python_joint(program, name):
    """In the order of frames, which is all that `sync` has; set-up, State and Heartbeat included."""
    _, (_, joint, _) = record(name, FUNCTIONAL)
    with program("2") as joint2:
        play(joint2, joint)
        code, text = joint2.finish()
    assert joint2.sent == joint.sent
    assert len(joint.sent) >= 2000
    assert code == 0, text
    assert "joint2: the run is over; fault 0, 1700 cycles, 0 strikes" in text


def since_the_first_reference(sent):
    """Return the frames of the last 200 cycles and the Current that answers Stop."""
    currents = [at for at, (identifier, _) in enumerate(sent) if identifier == CURRENT_2]
    return sent[currents[-201] :]


@pytest.mark.parametrize("setup_cycles", [60, 256, 300, 1000])
def test_the_cycle_is_known_from_the_first_reference_on(program, setup_cycles):
    """Encoder counts modulo 256: in a longer set-up nobody can say whose turn it is, from cycle 0 on anybody can."""
    _, (_, joint, _) = record("paper-joint", FUNCTIONAL, *SHORT, f"clock.setup_cycles={setup_cycles}")
    with program("2") as joint2:
        play(joint2, joint)
        joint2.finish()
    assert since_the_first_reference(joint2.sent) == since_the_first_reference(joint.sent)
    if setup_cycles <= 256:
        assert joint2.sent == joint.sent


def told(joint):
    """Return what the joint was told, as (identifier, data)."""
    calls = [CALL.unpack(call) for call in joint.calls]
    return [(call[4], call[6][: call[1]]) for call in calls if chr(call[0]) in "sf"]


def tell(program, frames):
    """Send frames, and at most two Encoders before there is an answer."""
    asked = 0
    for identifier, data in frames:
        program.send(identifier, data)
        asked += identifier == ENCODER_2
        if asked > 2:
            program.answer()
            asked -= 1


def other_way(frames, first, second):
    """Return the frames with each second that comes right behind a first before it; the very first pair stays."""
    frames, pairs = list(frames), 0
    for at in range(len(frames) - 1):
        if (frames[at][0], frames[at + 1][0]) == (first, second):
            pairs += 1
            if pairs > 1:
                frames[at : at + 2] = frames[at + 1], frames[at]
    return frames


@pytest.mark.parametrize(("first", "second"), [(ACCEL_REF, ENCODER_2), (ENCODER_2, ACCEL_REF)])
def test_encoder_is_answered_with_the_reference_of_the_cycle_before(program, first, second):
    """Whichever comes first: Encoder k before AccelRef k - 1, or behind AccelRef k."""
    _, (_, joint, _) = record("paper-joint", FUNCTIONAL, *SHORT)
    frames = other_way(told(joint), first, second)
    assert frames != told(joint)
    with program("2") as joint2:
        tell(joint2, frames)
        code, text = joint2.finish()
    assert joint2.sent == joint.sent
    assert code == 0, text


def test_what_was_asked_twice_before_the_run_counts_once_and_a_stop_before_all_of_it_not_at_all(program):
    """As the rig asks again while somebody is not there yet, and stops whoever a run before has left."""
    _, (_, joint, _) = record("paper-joint", FUNCTIONAL, *SHORT)
    first = next(at for at, (identifier, _) in enumerate(told(joint)) if identifier == ACCEL_REF)
    again = [frame for frame in told(joint)[:first] for _ in range(1 + (frame[0] == ENCODER_2))]
    with program("2") as joint2:
        tell(joint2, [(STOP, bytes([1])), *again, *told(joint)[first:]])
        code, text = joint2.finish()
    assert len(joint2.sent) > len(joint.sent)
    assert since_the_first_reference(joint2.sent) == since_the_first_reference(joint.sent)
    assert code == 0, text


def test_it_asks_for_its_four_identifiers_and_no_more(program, tmp_path):
    with program("4", "-j", "6"):
        pass
    if not (tmp_path / "filters").exists():
        pytest.skip("the kernel's filters cannot be read back")
    filters = list(struct.iter_unpack("=II", (tmp_path / "filters").read_bytes()))
    codec = load_arm()
    wanted = [codec[name].identifier for name in ("Stop", "Encoder_4", "AccelRef_2", "Parameter_4")]
    assert filters == [(identifier, EXACTLY) for identifier in wanted]


def test_silence_is_a_fault_by_the_wall_clock_and_not_without(program):
    _, (_, joint, _) = record("paper-joint", FUNCTIONAL, *SHORT)
    calls = [call for call in joint.calls if CALL.unpack(call)[5] <= 5_000_000]
    joint = type("", (), {"calls": calls})
    with program("2", "-w", "-p", "300000") as joint2:
        play(joint2, joint)
        joint2.sent.clear()
        code, text = joint2.finish()
        assert [identifier for identifier, _ in joint2.sent][-2:] == [CURRENT_2, STOP]
        assert joint2.sent[-2][1][:5] == bytes([0, 0, 0, 0, 5])
        assert joint2.sent[-1][1] == bytes([2])
        assert (code, "fault 1" in text) == (6, True)
    with program("2") as joint2:
        play(joint2, joint)
        with pytest.raises(subprocess.TimeoutExpired):
            joint2.process.wait(0.5)


@pytest.mark.parametrize(
    "arguments", [(), ("vcan0",), ("vcan0", "4"), ("vcan0", "0"), ("vcan0", "2", "-j", "7"), ("-x",)]
)
def test_wrong_arguments_show_the_usage(built, arguments):
    done = subprocess.run([built.program, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "usage" in done.stderr or "invalid option" in done.stderr


def test_an_interface_that_is_not_there_is_named(built, fake, tmp_path):
    env = os.environ | {"LD_PRELOAD": str(fake), "FAKE_CAN_FD": "9", "FAKE_CAN_FILTERS": str(tmp_path / "filters")}
    done = subprocess.run([built.program, "can7", "2"], env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 4
    assert done.stderr == "joint: can7: No such device; `ip -br link` lists the interfaces\n"
