"""Turns a DBC file into the codec of its messages, and refuses what the codec could only approximate.

Supported: classic CAN, 11-bit identifiers, little-endian integers of 8, 16 or 32 bits that fill their message without
gaps, no offset. This is the only module that imports cantools, which takes some 15 us to encode one frame.
"""

from functools import cache
from importlib.resources import as_file, files
from math import isfinite
from pathlib import Path
from typing import NamedTuple

from cantools.database import load_file
from cantools.database.can import Database, Message, Signal
from cantools.database.conversion import BaseConversion
from cantools.database.errors import UnsupportedDatabaseFormatError

from dbc.codec import CRC_SIGNAL, Codec, CodecError, MessageCodec

_FORMATS = {(8, False): "B", (8, True): "b", (16, False): "H", (16, True): "h", (32, False): "I", (32, True): "i"}
LONGEST_DATA = 8
LARGEST_VERSION = 255
JOINTS = 6
"""Of the largest arm."""
CYCLES = ("GenMsgCycleTime", "GenMsgCycleTimeFast", "GenMsgCycleTimeActive")
MINIMUM_DISTANCE = "GenMsgDelayTime"
"""The least time between two of a message, ms. Ref: Vector, CAPL functions, ChkStart_MsgRelOccurrenceViolation;
Beckhoff, TF6650 (it becomes the inhibit time of CANopen)."""
BY_EVENT = ("event", "spontan", "trigger")
"""In the name of a GenMsgSendType: it comes by event, perhaps beside its cycle."""


@cache
def load_arm() -> Codec:
    """Return the codec of the shipped arm.dbc: one for the whole process, read once."""
    with as_file(files("dbc") / "arm.dbc") as path:
        return compile_dbc(path)


def compile_dbc(path: str | Path) -> Codec:
    """Return the codec of a DBC file; raise CodecError for what is not supported."""
    database = _load(path)
    _refuse_duplicates(database.messages)
    return Codec([_compile_message(message) for message in database.messages], _version(database.version or ""))


class Description(NamedTuple):
    """What a database says of a message beside its layout.

    cycle_ms: 0 where it comes by event, or nothing is said. distance_ms: how soon two may follow each other, at the
    least, so far as the database says; else 0.
    """

    name: str
    identifier: int
    extended: bool
    fd: bool
    length: int
    senders: frozenset[str]
    receivers: frozenset[str]
    cycle_ms: float
    distance_ms: float


def describe(path: str | Path) -> list[Description]:
    """Return every message of a DBC file, by identifier; raise CodecError for what is no DBC."""
    return [_describe(message) for message in sorted(_load(path).messages, key=lambda each: each.frame_id)]


def _load(path: str | Path) -> Database:
    # Not strict: what is used is checked here, where the message can name the cure.
    try:
        database = load_file(path, database_format="dbc", strict=False)
    except (UnsupportedDatabaseFormatError, UnicodeDecodeError) as error:
        raise CodecError(f"{path} is no readable database: {error}") from error
    assert isinstance(database, Database)
    return database


def describe_arm(joints: int) -> list[Description]:
    """Return every message of an arm of so many joints, by identifier; nodes are named as in arm.dbc, in capitals."""
    with as_file(files("dbc") / "arm.dbc") as path:
        return [each for each in describe(path) if _is_of(each.name, joints)]


def _describe(message: Message) -> Description:
    return Description(
        message.name,
        message.frame_id,
        message.is_extended_frame,
        message.is_fd,
        message.length,
        frozenset(message.senders),
        frozenset(message.receivers),
        _number(message, CYCLES[0]),
        _distance_ms(message),
    )


def _distance_ms(message: Message) -> float:
    """Return the shortest of its cycles; GenMsgDelayTime where it has none, or comes by event beside it."""
    found = [_number(message, name) for name in CYCLES]
    if not any(found) or any(word in (message.send_type or "").lower() for word in BY_EVENT):
        found.append(_number(message, MINIMUM_DISTANCE))
    return min((each for each in found if each), default=0)


def _number(message: Message, name: str) -> float:
    """Return an attribute of a message, or its default; 0 where it is missing or no number above 0."""
    assert message.dbc is not None  # it was read from a DBC file
    definition = message.dbc.attribute_definitions.get(name)
    attribute = message.dbc.attributes.get(name)
    value = attribute.value if attribute is not None else definition and definition.default_value
    return value if isinstance(value, int | float) and isfinite(value) and value > 0 else 0


def arm_dbc(joints: int, rad_per_count: float) -> str:
    """Return arm.dbc for an arm of so many joints, whose encoders count in steps of rad_per_count."""
    with as_file(files("dbc") / "arm.dbc") as path:
        database = load_file(path, database_format="dbc")
    assert isinstance(database, Database)
    absent = {f"JOINT{n}" for n in range(joints + 1, JOINTS + 1)}
    database.nodes[:] = [node for node in database.nodes if node.name not in absent]
    database.messages[:] = [message for message in database.messages if _is_of(message.name, joints)]
    for message in database.messages:
        message.senders[:] = [sender for sender in message.senders if sender not in absent]
        for signal in message.signals:
            signal.receivers[:] = [receiver for receiver in signal.receivers if receiver not in absent]
            if signal.name == "Position":
                top = ((1 << signal.length) - 1) * rad_per_count
                signal.conversion, signal.maximum = BaseConversion.factory(scale=rad_per_count), top
    database.refresh()
    return database.as_dbc_string()


def _is_of(name: str, joints: int) -> bool:
    """Return whether an arm of so many joints has this message: by the number at the end of its name, if it has one."""
    number = name.rpartition("_")[2]
    if name == "AccelRef_2":
        return joints > JOINTS // 2
    return not number.isdigit() or not joints < int(number) <= JOINTS


def _version(text: str) -> int:
    """Return what VERSION says, 0 for nothing; a frame carries it in a byte."""
    if text and not (text.isascii() and text.isdigit() and int(text) <= LARGEST_VERSION):
        raise CodecError(f'VERSION "{text}": write a number up to {LARGEST_VERSION}, or nothing')
    return int(text or 0)


def _refuse_duplicates(messages: list[Message]) -> None:
    names: set[str] = set()
    identifiers: dict[int, str] = {}
    for message in messages:
        if message.name in names:
            raise CodecError(f"message {message.name} is defined twice: rename one")
        names.add(message.name)
        other = identifiers.setdefault(message.frame_id, message.name)
        if other != message.name:
            raise CodecError(
                f"messages {other} and {message.name} share identifier {message.frame_id:#x}: renumber one"
            )


def _compile_message(message: Message) -> MessageCodec:
    _check_message(message)
    signals = sorted(message.signals, key=lambda signal: signal.start)
    _check_layout(message, signals)
    protected = bool(signals) and signals[-1].name == CRC_SIGNAL
    carried = signals[:-1] if protected else signals
    layout = [(signal.name, _FORMATS[signal.length, signal.is_signed], float(signal.scale)) for signal in carried]
    return MessageCodec(message.name, message.frame_id, layout, protected)


def _check_message(message: Message) -> None:
    """Refuse a message that is no classic CAN frame, or whose signals the codec cannot carry."""
    if message.is_extended_frame:
        raise CodecError(
            f"message {message.name}: identifier {message.frame_id:#x} has 29 bits: give it one up to 0x7ff"
        )
    if message.is_fd or message.length > LONGEST_DATA:
        raise CodecError(f"message {message.name}: {message.length} bytes or CAN FD, the limit is 8: split it")
    for signal in message.signals:
        refusal = _refusal(signal)
        if refusal:
            raise CodecError(f"message {message.name}, signal {signal.name}: {refusal}")


def _refusal(signal: Signal) -> str:
    """Return why a signal cannot be carried and what to do about it, or nothing."""
    if signal.is_multiplexer or signal.multiplexer_ids:
        return "multiplexed: give each variant a message of its own"
    if signal.is_float or not isinstance(signal.scale, int | float):
        return "floating point: use a scaled integer"
    if signal.byte_order != "little_endian":
        return "big-endian: write @1 for little-endian"
    if (signal.length, signal.is_signed) not in _FORMATS:
        return f"{signal.length} bits: use 8, 16 or 32"
    if signal.start % 8:
        return f"begins at bit {signal.start}, inside a byte: move it to a multiple of 8"
    if signal.offset:
        return f"offset {signal.offset:g}: use a signed signal with offset 0"
    return ""


def _check_layout(message: Message, signals: list[Signal]) -> None:
    """Refuse gaps, overlaps and a CRC that is not the last byte; signals come in the order of their bits."""
    end = 0
    for signal in signals:
        if signal.start != end:
            fault = "the gap must be filled" if signal.start > end else "it overlaps the one before, move it"
            raise CodecError(
                f"message {message.name}, signal {signal.name}: begins at bit {signal.start}, not {end}: {fault}"
            )
        end += signal.length
        if signal.name == CRC_SIGNAL and (signal is not signals[-1] or signal.length != 8 or signal.is_signed):
            raise CodecError(
                f"message {message.name}, signal {signal.name}: must be the last byte, unsigned: move it there"
            )
    length = 8 * message.length
    if end != length:
        last = signals[-1].name if signals else "(none)"
        cure = f"set the length to {end // 8} bytes" if end > length else "fill the rest or shorten the message"
        raise CodecError(f"message {message.name}, signal {last}: ends at bit {end} of {length}: {cure}")
