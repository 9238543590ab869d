"""Every message there and back, and what becomes of bytes that are none."""

import json
import os
import socket
import struct
import threading
from contextlib import suppress
from functools import partial

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hil.wire import protocol
from hil.wire.hello import Change, Command, Hello, check
from hil.wire.identifier import BRS, ERROR, ESI, FD, FD_LENGTHS, OWN
from hil.wire.protocol import Closed, Connection, ProtocolError

pytestmark = pytest.mark.usefixtures("bounded")

times_ns = st.integers(-(1 << 62), 1 << 62)
identifiers = st.one_of(st.integers(0, 0x7FF), st.integers(0, 0x1FFFFFFF).map(lambda number: number | 0x80000000))
fd_flags = st.integers(0, 3).map(lambda flags: FD | (BRS if flags & 1 else 0) | (ESI if flags & 2 else 0))
fd_identifiers = st.builds(int.__or__, identifiers, fd_flags)
identifiers = identifiers | identifiers.map(lambda identifier: identifier | 0x40000000)
data = st.binary(max_size=8)
fd_data = st.sampled_from(FD_LENGTHS).flatmap(lambda length: st.binary(min_size=length, max_size=length))
contents = st.one_of(
    st.tuples(times_ns, identifiers, data),
    st.tuples(times_ns, fd_identifiers, fd_data),
    st.tuples(times_ns, identifiers.map(lambda identifier: identifier | OWN), data),
    st.tuples(times_ns, st.integers(0, 0x1FFFFFFF).map(lambda kind: kind | ERROR), data),
)
frames = st.lists(contents, max_size=20)
timers = st.one_of(st.none(), times_ns)
busy_ns = st.integers(0, 1 << 62)
kinds = st.integers(protocol.HELLO, protocol.STATUS)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=10,
)

DECODERS = {
    "HELLO": partial(check, Hello),
    "WELCOME": protocol.decode_json,
    "CONFIGURE": partial(check, Change),
    "CONTROL": partial(check, Command),
    "START": protocol.decode_time,
    "GRANT": protocol.decode_grant,
    "YIELD": protocol.decode_yield,
    "FRAMES": protocol.decode_frames,
}
decoders = pytest.mark.parametrize("decode", DECODERS.values(), ids=DECODERS)

BODIES = {
    "HELLO": protocol.encode_json({"name": "plant", "role": "timed"}),
    "WELCOME": protocol.encode_json({"bit_ns": 1000}),
    "CONFIGURE": protocol.encode_json({"set_filters": True, "filters": [{"can_id": 1, "can_mask": 0x7FF}]}),
    "CONTROL": protocol.encode_json({"command": "step", "step_ns": 1_000_000}),
    "START": protocol.encode_time(-200_000_000),
    "GRANT": protocol.encode_grant(65_000, [(1, 0x130, bytes(7))], (65_000, 0x101, bytes(4))),
    "YIELD": protocol.encode_yield((125_000, None, [(125_000, 0x121, bytes(6)), (0, 0x7FF, b"")])),
    "FRAMES": protocol.encode_frames([(1, 0x80000001, b"abc"), (2, 2 | FD | BRS, bytes(64)), (3, 2, b"")]),
}


# -- there and back --


@given(st.dictionaries(st.text(), json_values, max_size=5))
def test_json_returns(values):
    assert protocol.decode_json(protocol.encode_json(values)) == values


@given(times_ns)
def test_start_returns(now_ns):
    assert protocol.decode_time(protocol.encode_time(now_ns)) == now_ns


@given(times_ns, frames, st.one_of(st.none(), contents))
def test_grant_returns(now_ns, stored, cause):
    assert protocol.decode_grant(protocol.encode_grant(now_ns, stored, cause)) == (now_ns, stored, cause)


@given(busy_ns, timers, frames)
def test_yield_returns(busy_ns, timer_ns, sends):
    assert protocol.decode_yield(protocol.encode_yield((busy_ns, timer_ns, sends))) == (busy_ns, timer_ns, sends)


@given(frames)
def test_frames_return(frames):
    assert protocol.decode_frames(protocol.encode_frames(frames)) == frames


def test_timer_at_zero_is_not_no_timer():
    assert protocol.decode_yield(protocol.encode_yield((0, 0, [])))[1] == 0


def test_grant_is_laid_out_as_the_page_says():
    """now, whether a frame wakes, their number, then each frame with 64 bits of identifier; little-endian."""
    body = protocol.encode_grant(1, [(2, 3, b"\xaa")], (4, 0x80000005 | FD | BRS, b""))
    expected = "0100000000000000 01 020000000200000000000000 0300000000000000 01 aa0400000000000000 0500008003000000 00"
    assert body == bytes.fromhex(expected)


def test_message_is_length_kind_body():
    assert protocol.message(protocol.GRANT, b"abc") == b"\x04\x00\x00\x00" + bytes([protocol.GRANT]) + b"abc"


# -- bytes that are no message --


@decoders
@settings(max_examples=300)
@given(body=st.binary(max_size=80))
@example(body=b"")
@example(body=b"\xff" * 11)
@example(body=b"\xff" * 18)
@example(body=b"[" * 100_000)
@example(body=b"1" * 5000)
@example(body=b'"\xff"')
@example(body=b"\xef\xbb\xbf{}")
@example(body=b"\x00\x00\x00\x00\x00\x00\x00\x00\x01\x00\x00\x00\x00")
def test_random_bytes_decode_or_raise_protocol_error(decode, body):
    with suppress(ProtocolError):
        decode(body)


CUTS = [(name, cut) for name, body in BODIES.items() for cut in range(len(body))]


@pytest.mark.parametrize(("name", "cut"), CUTS)
def test_body_cut_short_is_refused(name, cut):
    with pytest.raises(ProtocolError):
        DECODERS[name](BODIES[name][:cut])


@pytest.mark.parametrize("name", ["START", "GRANT", "YIELD", "FRAMES"])
def test_body_with_bytes_behind_is_refused(name):
    with pytest.raises(ProtocolError):
        DECODERS[name](BODIES[name] + b"\x00")


def test_grant_by_a_frame_that_it_does_not_bring_is_refused():
    with pytest.raises(ProtocolError):
        protocol.decode_grant(struct.pack("<qBI", 0, 1, 0))


NO_FRAMES = {
    "nine bytes": (0x100, 9),
    "identifier of 12 bits": (0x800, 0),
    "nine bytes of CAN FD": (0x100 | FD, 9),
    "65 bytes of CAN FD": (0x100 | FD, 65),
    "identifier of 12 bits in CAN FD": (0x800 | FD, 0),
    "remote frame of CAN FD": (0x100 | FD | 0x40000000, 0),
    "fast data phase without CAN FD": (0x100 | BRS, 0),
    "passive sender without CAN FD": (0x100 | ESI, 0),
    "nine bytes in an error frame": (0x4 | ERROR, 9),
    "a flag above all": (0x100 | OWN << 1, 0),
}


@pytest.mark.parametrize("name", NO_FRAMES)
def test_what_is_no_frame_is_refused_wherever_it_comes(name):
    identifier, length = NO_FRAMES[name]
    frame = (0, identifier, bytes(length))
    for decode, body in (
        (protocol.decode_frames, protocol.encode_frames([frame])),
        (protocol.decode_grant, protocol.encode_grant(0, [], frame)),
        (protocol.decode_yield, protocol.encode_yield((0, None, [frame]))),
    ):
        with pytest.raises(ProtocolError, match=f"identifier {identifier:#x} with {length} bytes"):
            decode(body)


@pytest.mark.parametrize(
    "reaction",
    [(-1, None, []), ((1 << 62) + 1, None, []), (0, (1 << 62) + 1, []), (0, None, [((1 << 62) + 1, 1, b"")])],
)
def test_instant_later_than_anything_and_time_that_runs_backwards_are_refused(reaction):
    with pytest.raises(ProtocolError, match="ns"):
        protocol.decode_yield(protocol.encode_yield(reaction))


@pytest.mark.parametrize("value", [[], "name", 1, None])
def test_json_that_is_no_object_is_refused(value):
    with pytest.raises(ProtocolError):
        protocol.decode_json(json.dumps(value).encode())


# -- the stream --


@pytest.fixture
def ends():
    """The raw near end of a stream and a Connection at the far one."""
    near, far = socket.socketpair()
    connection = Connection(far)
    yield near, connection
    near.close()
    connection.close()


STREAM = protocol.message(protocol.GRANT, BODIES["GRANT"]) + protocol.message(protocol.LEAVE, b"")


@pytest.mark.parametrize("cut", range(1, len(STREAM)))
def test_message_split_anywhere_is_put_together(ends, cut):
    near, connection = ends
    received = []
    for part in (STREAM[:cut], STREAM[cut:]):
        near.sendall(part)
        connection.fill()
        while (message := connection.next_message()) is not None:
            received.append(message)
    assert received == [(protocol.GRANT, BODIES["GRANT"]), (protocol.LEAVE, b"")]


def test_message_byte_by_byte_is_put_together(ends):
    near, connection = ends
    for byte in STREAM[:-1]:
        near.sendall(bytes([byte]))
        connection.fill()
    assert connection.next_message() == (protocol.GRANT, BODIES["GRANT"])
    assert connection.next_message() is None
    near.sendall(STREAM[-1:])
    assert connection.receive() == (protocol.LEAVE, b"")


@settings(deadline=None, max_examples=50)
@given(st.lists(st.tuples(kinds, st.binary(max_size=200)), min_size=1, max_size=10), st.data())
def test_messages_in_random_parts_are_put_together(messages, draw):
    stream = b"".join(protocol.message(kind, body) for kind, body in messages)
    near, far = socket.socketpair()
    connection, received = Connection(far), []
    with near, far:
        while stream:
            part = draw.draw(st.integers(1, len(stream)))
            near.sendall(stream[:part])
            stream = stream[part:]
            connection.fill()
            while (message := connection.next_message()) is not None:
                received.append(message)
    assert received == messages


def test_send_and_receive_of_the_longest_message(ends):
    near, connection = ends
    body = bytes(range(256)) * (protocol.LONGEST_MESSAGE // 256 - 1)
    writer = threading.Thread(target=Connection(near).send, args=(protocol.FRAMES, body))
    writer.start()
    assert connection.receive() == (protocol.FRAMES, body)
    writer.join()


@pytest.mark.parametrize("length", [0, protocol.LONGEST_MESSAGE + 1, 0xFFFFFFFF])
def test_length_outside_of_the_limit_is_refused_before_the_body_comes(ends, length):
    near, connection = ends
    near.sendall(struct.pack("<IB", length, protocol.GRANT))
    with pytest.raises(ProtocolError, match=str(length)):
        connection.receive()


@pytest.mark.parametrize("length", [1, protocol.LONGEST_MESSAGE])
def test_length_at_the_limit_is_taken(ends, length):
    near, connection = ends
    near.sendall(struct.pack("<IB", length, protocol.GRANT))
    connection.fill()
    message = connection.next_message()
    assert message == ((protocol.GRANT, b"") if length == 1 else None)


@pytest.mark.parametrize("sent", [b"", STREAM[:4], STREAM[:10]])
def test_end_of_stream_is_closed_even_inside_a_message(ends, sent):
    near, connection = ends
    near.sendall(sent)
    near.close()
    with pytest.raises(Closed):
        connection.receive()


def test_welcome_brings_a_file(ends):
    """The message behind it stays in the stream, whole."""
    near, connection = ends
    reading, writing = os.pipe()
    Connection(near).send_with_file(protocol.WELCOME, b"{}", reading)
    near.sendall(STREAM)
    os.close(reading)
    kind, body, descriptor = connection.receive_with_file()
    os.write(writing, b"here")
    assert (kind, body, os.read(descriptor, 4)) == (protocol.WELCOME, b"{}", b"here")
    assert connection.receive() == (protocol.GRANT, BODIES["GRANT"])
    os.close(descriptor)
    os.close(writing)


def test_message_without_a_file_has_none(ends):
    near, connection = ends
    near.sendall(STREAM)
    assert connection.receive_with_file() == (protocol.GRANT, BODIES["GRANT"], None)
    assert connection.receive() == (protocol.LEAVE, b"")


@pytest.mark.parametrize("sent", [b"", STREAM[:3], STREAM[:10]])
def test_end_of_stream_instead_of_a_file_is_closed(ends, sent):
    near, connection = ends
    near.sendall(sent)
    near.close()
    with pytest.raises(Closed):
        connection.receive_with_file()


@pytest.mark.parametrize("length", [0, 1001, 0xFFFFFFFF])
def test_connection_may_be_held_to_shorter_messages(ends, length):
    near, connection = ends
    connection.longest = 1000
    near.sendall(struct.pack("<IB", length, protocol.HELLO))
    with pytest.raises(ProtocolError, match="1 to 1000 are allowed"):
        connection.receive()


def test_send_to_nobody_is_closed(ends):
    near, connection = ends
    near.close()
    with pytest.raises(Closed):
        connection.send(protocol.LEAVE, b"")


@settings(max_examples=200, deadline=None)
@given(st.binary(min_size=1, max_size=60))
def test_random_stream_yields_messages_or_protocol_error(stream):
    near, far = socket.socketpair()
    connection = Connection(far)
    with near, far:
        near.sendall(stream)
        connection.fill()
        with suppress(ProtocolError):
            while connection.next_message() is not None:
                pass
