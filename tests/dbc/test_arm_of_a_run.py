"""The database of one run: the messages of its joints, and what one count of its encoders means."""

import math

import cantools.database
import pytest

from dbc.compiler import arm_dbc, compile_dbc, load_arm


def loaded(joints, rad_per_count, tmp_path):
    path = tmp_path / "arm.dbc"
    path.write_text(arm_dbc(joints, rad_per_count))
    return cantools.database.load_file(path, strict=True), compile_dbc(path)


@pytest.mark.parametrize("joints", range(1, 7))
def test_it_has_the_messages_and_nodes_of_its_joints_and_no_others(joints, tmp_path):
    database, codec = loaded(joints, 1e-5, tmp_path)
    numbers = {"0", "7", *map(str, range(1, joints + 1))}
    whole = load_arm()
    expected = {name for name in whole if "_" not in name or name.rpartition("_")[2] in numbers} - {"AccelRef_2"}
    assert codec.keys() == expected | ({"AccelRef_2"} if joints > 3 else set())
    nodes = {"PLANT", "DSP", *(f"JOINT{n}" for n in range(1, joints + 1))}
    assert {node.name for node in database.nodes} == nodes
    for message in database.messages:
        assert set(message.senders) | message.receivers <= nodes
        assert codec[message.name].identifier == whole[message.name].identifier
        assert codec[message.name].signals == whole[message.name].signals


def test_position_has_the_factor_and_the_range_of_the_encoder(tmp_path):
    database, codec = loaded(3, 2 * math.pi / 65_536, tmp_path)
    signal = database.get_message_by_name("Encoder_2").get_signal_by_name("Position")
    assert signal.scale == codec.scale("Encoder_2", "Position") == 2 * math.pi / 65_536
    assert (signal.minimum, signal.maximum) == (0, pytest.approx(2 * math.pi * 65_535 / 65_536))
    assert codec.scale("Current_2", "Reference") == 1 / 2048


def test_what_it_says_of_signals_is_what_arm_dbc_says(tmp_path):
    database, _ = loaded(2, 1e-5, tmp_path)
    message = database.get_message_by_name("State_2")
    assert message.comment.startswith("State, fault and counters of joint 2.")
    assert message.signals[0].choices == {0: "init", 1: "ready", 2: "run", 3: "fault"}
    assert message.cycle_time == 10
