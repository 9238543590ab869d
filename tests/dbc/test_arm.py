"""arm.dbc: complete, strictly loadable, and of the size that the timing of a cycle is built on."""

import math
from importlib.resources import files

import cantools.database
import pytest

from dbc.codec import CodecError
from dbc.compiler import load_arm
from hil.wire.bits import INTERMISSION_BITS, worst_case_bits

DATABASE = cantools.database.load_file(str(files("dbc") / "arm.dbc"), strict=True)
CODEC = load_arm()
JOINTS = range(1, 7)
NODES = {"PLANT", "DSP", *(f"JOINT{n}" for n in JOINTS)}
SIGNALS = [(message, signal) for message in DATABASE.messages for signal in message.signals]
SIGNAL_NAMES = [f"{message.name}.{signal.name}" for message, signal in SIGNALS]

each_message = pytest.mark.parametrize("message", DATABASE.messages, ids=lambda message: message.name)
each_signal = pytest.mark.parametrize(("message", "signal"), SIGNALS, ids=SIGNAL_NAMES)


def cycle_ms(joint):
    """One ms for up to three joints; with more the frames of a cycle need two, with six joints up to 1.87."""
    return 1 if joint <= 3 else 2


def status_ms(joint):
    """Each of N nodes has every Nth cycle, State and Heartbeat by turns: 5 nodes at 1 ms, or 6 at 2 ms and more."""
    return 10 if joint <= 3 else 24


# name -> identifier, bytes, worst bits with intermission, cycle time in ms, sender
FRAMES = {
    "Stop": (0x010, 1, 65, 0, "DSP"),
    "Sync": (0x080, 1, 65, 1, "DSP"),
    "AccelRef": (0x130, 8, 135, 1, "DSP"),
    "AccelRef_2": (0x131, 8, 135, 2, "DSP"),
    **{f"Encoder_{n}": (0x100 + n, 4, 95, cycle_ms(n), "PLANT") for n in JOINTS},
    **{f"Current_{n}": (0x120 + n, 6, 115, cycle_ms(n), f"JOINT{n}") for n in JOINTS},
    **{f"Parameter_{n}": (0x300 + n, 5, 105, 0, "DSP") for n in JOINTS},
    **{f"Acknowledge_{n}": (0x310 + n, 7, 125, 0, f"JOINT{n}") for n in JOINTS},
    **{f"State_{n}": (0x400 + n, 8, 135, status_ms(n), f"JOINT{n}") for n in JOINTS},
    **{f"Heartbeat_{n}": (0x480 + n, 8, 135, status_ms(n), f"JOINT{n}") for n in JOINTS},
    "State_0": (0x400, 8, 135, 10, "PLANT"),
    "Heartbeat_0": (0x480, 8, 135, 10, "PLANT"),
    "State_7": (0x407, 8, 135, 10, "DSP"),
    "Heartbeat_7": (0x487, 8, 135, 10, "DSP"),
}


def test_frames_are_those_of_the_design_and_no_others():
    assert {message.name for message in DATABASE.messages} == set(FRAMES)


@each_message
def test_frame_is_that_of_the_design(message):
    worst_bits = worst_case_bits(message.length) + INTERMISSION_BITS
    found = (message.frame_id, message.length, worst_bits, message.cycle_time or 0, message.senders[0])
    assert found == FRAMES[message.name]
    assert message.send_type == ("Cyclic" if message.cycle_time else "Event")


def test_frames_of_one_cycle_leave_room_for_one_state():
    every_ms = [message for message in DATABASE.messages if message.cycle_time == 1]
    assert sum(worst_case_bits(message.length) + INTERMISSION_BITS for message in every_ms) == 830


def test_anybody_may_stop():
    stop = DATABASE.get_message_by_name("Stop")
    assert set(stop.senders) == NODES == set(stop.receivers)


def test_every_node_is_described():
    assert {node.name for node in DATABASE.nodes} == NODES
    assert all(node.comment for node in DATABASE.nodes)


@each_message
def test_message_is_described(message):
    assert message.comment
    assert message.senders
    assert set(message.senders) <= NODES
    assert message.dbc.attributes["GenMsgCycleTime"].value == (message.cycle_time or 0)


@each_signal
def test_signal_is_described(message, signal):
    assert signal.comment
    assert signal.unit
    assert signal.receivers
    assert set(signal.receivers) <= NODES
    assert signal.receivers == message.signals[0].receivers


@pytest.mark.parametrize("signal", [signal for _, signal in SIGNALS], ids=SIGNAL_NAMES)
def test_range_is_the_full_raw_range_in_physical_units(signal):
    low = -(1 << signal.length - 1) if signal.is_signed else 0
    assert (signal.minimum, signal.maximum) == (low * signal.scale, (low + (1 << signal.length) - 1) * signal.scale)


@each_message
def test_all_but_stop_and_sync_are_protected(message):
    if message.name not in ("Stop", "Sync"):
        assert message.signals[-1].name == "Crc"


@pytest.mark.parametrize(
    ("message", "signal", "choices"),
    [
        ("Stop", "Reason", 9),
        ("Parameter_1", "Index", 6),
        ("Acknowledge_3", "Index", 6),
        ("State_0", "State", 4),
        ("State_7", "Fault", 9),
        ("Heartbeat_2", "State", 4),
    ],
)
def test_codes_have_names(message, signal, choices):
    named = DATABASE.get_message_by_name(message).get_signal_by_name(signal).choices
    assert sorted(named) == list(range(choices))


@pytest.mark.parametrize(
    ("message", "signal", "factor"),
    [
        ("Encoder_2", "Position", 2 * math.pi / 819200),
        ("Current_1", "Reference", 1 / 2048),
        ("Current_3", "Estimate", 1 / 2048),
        ("AccelRef", "Joint3", 1 / 128),
        ("Sync", "Cycle", 1.0),
    ],
)
def test_scale_is_what_a_count_means(message, signal, factor):
    assert CODEC.scale(message, signal) == factor


def test_unknown_signal_is_refused_with_those_there_are():
    with pytest.raises(CodecError, match=r"Current_1 has no signal 'Crc': it has Reference, Estimate, Cycle"):
        CODEC.scale("Current_1", "Crc")


def test_version_is_said_to_generators_of_code_too():
    """cantools generate_c_source does not write VERSION, but names of values."""
    assert CODEC.version == int(DATABASE.version) > 0
    for n in JOINTS:
        choices = DATABASE.get_message_by_name(f"Parameter_{n}").get_signal_by_name("Version").choices
        assert choices == {CODEC.version: "this_database"}
