"""The codec against cantools and a CRC of its own, over every message of arm.dbc."""

import json
from importlib.resources import files
from itertools import permutations

import cantools.database
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.codec import Codec, CodecError
from dbc.compiler import load_arm

DATABASE = cantools.database.load_file(str(files("dbc") / "arm.dbc"), strict=True)
CODEC = load_arm()
PROTECTED = [message for message in DATABASE.messages if message.signals[-1].name == "Crc"]

each_message = pytest.mark.parametrize("message", DATABASE.messages, ids=lambda message: message.name)
each_protected = pytest.mark.parametrize("message", PROTECTED, ids=lambda message: message.name)


def carried(message):
    """The signals that the codec takes: all but the CRC."""
    return [signal for signal in message.signals if signal.name != "Crc"]


def raw_range(signal):
    low = -(1 << signal.length - 1) if signal.is_signed else 0
    return low, low + (1 << signal.length) - 1


def raw_values(message):
    return st.tuples(*(st.integers(*raw_range(signal)) for signal in carried(message)))


def bitwise_crc8(data):
    """SAE J1850 from its definition, most significant bit first."""
    register = 0xFF
    for bit in (byte >> shift & 1 for byte in data for shift in range(7, -1, -1)):
        carry = register >> 7 ^ bit
        register = register << 1 & 0xFF
        if carry:
            register ^= 0x1D
    return register ^ 0xFF


def cantools_data(message, values):
    """The frame as cantools packs it, with the CRC of this module."""
    named = {signal.name: value for signal, value in zip(carried(message), values, strict=True)}
    if message not in PROTECTED:
        return message.encode(named, scaling=False)
    payload = message.encode(named | {"Crc": 0}, scaling=False)[:-1]
    return payload + bytes([bitwise_crc8(message.frame_id.to_bytes(2, "big") + payload)])


@each_message
def test_attributes_are_those_of_the_database(message):
    codec = CODEC[message.name]
    assert (codec.name, codec.identifier, codec.length) == (message.name, message.frame_id, message.length)
    assert codec.signals == tuple(signal.name for signal in carried(message))
    assert CODEC.by_identifier[message.frame_id] is codec


@each_message
@settings(deadline=None)
@given(data=st.data())
def test_pack_equals_cantools_and_unpack_inverts(message, data):
    values = data.draw(raw_values(message))
    codec = CODEC[message.name]
    packed = codec.pack(*values)
    assert packed == cantools_data(message, values)
    assert codec.unpack(packed) == values


@each_message
def test_extremes_survive(message):
    for values in zip(*(raw_range(signal) for signal in carried(message)), strict=True):
        codec = CODEC[message.name]
        assert codec.unpack(codec.pack(*values)) == values


def test_golden_frame():
    assert (
        CODEC["Current_1"].pack(-2, 0x0102, 7).hex(" ")
        == "fe ff 02 01 07 " + f"{bitwise_crc8(bytes.fromhex('0121feff020107')):02x}"
    )


@each_protected
@settings(deadline=None, max_examples=20)
@given(data=st.data())
def test_every_single_flipped_bit_is_detected(message, data):
    codec = CODEC[message.name]
    packed = codec.pack(*data.draw(raw_values(message)))
    for bit in range(8 * len(packed)):
        flipped = bytearray(packed)
        flipped[bit // 8] ^= 1 << bit % 8
        assert codec.unpack(bytes(flipped)) is None, f"bit {bit}"


SAME_LENGTH = [(one, other) for one, other in permutations(PROTECTED, 2) if one.length == other.length]


@settings(deadline=None, max_examples=20)
@given(data=st.data())
def test_frame_under_the_identifier_of_another_message_is_detected(data):
    for one, other in SAME_LENGTH:
        packed = CODEC[one.name].pack(*data.draw(raw_values(one)))
        assert CODEC[other.name].unpack(packed) is None, f"{one.name} read as {other.name}"


@each_message
def test_wrong_length_is_none(message):
    codec = CODEC[message.name]
    packed = codec.pack(*(0 for _ in codec.signals))
    assert codec.unpack(packed[:-1]) is None
    assert codec.unpack(packed + b"\0") is None
    assert codec.unpack(b"") is None


OFFSETS = [
    (0, True),
    (1, True),
    (2, True),
    (-1, False),
    (-2, False),
    (-256, False),
    (-(1 << 32), False),
    (-(1 << 64), False),
]


@each_message
@pytest.mark.parametrize(("inside", "accepted"), OFFSETS)
def test_boundaries_of_every_signal(message, inside, accepted):
    codec = CODEC[message.name]
    for place, signal in enumerate(carried(message)):
        low, high = raw_range(signal)
        for value in (low + inside, high - inside):
            values = [0] * len(codec.signals)
            values[place] = value
            if accepted:
                assert codec.unpack(codec.pack(*values)) == tuple(values)
            else:
                with pytest.raises(
                    CodecError, match=rf"{message.name}\.{signal.name}: raw value {value} is outside {low}\.\.{high}"
                ):
                    codec.pack(*values)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ((1, 2), r"Current_1 takes 3 values \(Reference, Estimate, Cycle\), got 2"),
        ((1, 2, 3, 4), r"Current_1 takes 3 values \(Reference, Estimate, Cycle\), got 4"),
        ((0.5, 2, 3), r"Current_1\.Reference: 0\.5 is not a raw integer"),
        ((1, 2, "3"), r"Current_1\.Cycle: '3' is not a raw integer"),
    ],
)
def test_wrong_values_are_refused_by_name(values, reason):
    with pytest.raises(CodecError, match=reason):
        CODEC["Current_1"].pack(*values)


@pytest.mark.parametrize(
    ("name", "nearest"), [("Encoder1", "Encoder_1"), ("current_2", "Current_2"), ("Accel", "AccelRef"), ("x", "")]
)
def test_unknown_name_is_refused_with_the_nearest(name, nearest):
    with pytest.raises(CodecError, match=f"no message '{name}' in the database: did you mean .*{nearest}"):
        CODEC[name]


def test_asking_for_a_name_is_no_error():
    assert "Encoder_1" in CODEC
    assert "Encoder_9" not in CODEC
    assert CODEC.get("Encoder_9") is None


# -- handed over --


@each_message
def test_a_codec_that_is_handed_over_is_the_same(message):
    """To a process that reads no database: each boundary is packed as here, the CRC with it; the factors to the bit."""
    ours, theirs = CODEC[message.name], Codec.of_table(*json.loads(json.dumps(CODEC.table())))[message.name]
    assert (theirs.identifier, theirs.length, theirs.signals) == (ours.identifier, ours.length, ours.signals)
    for values in zip(*(raw_range(signal) for signal in carried(message)), strict=True):
        assert theirs.pack(*values) == ours.pack(*values)
        assert theirs.unpack(ours.pack(*values)) == values
    for signal in carried(message):
        assert theirs.factor(signal.name) == signal.scale


def test_a_codec_that_is_handed_over_has_the_version_and_the_order():
    theirs = Codec.of_table(*json.loads(json.dumps(CODEC.table())))
    assert theirs.version == CODEC.version > 0
    assert [*theirs] == [*CODEC] == [message.name for message in DATABASE.messages]
