"""Every message there and back, and what becomes of bytes that are none."""

import json
import socket
import struct
import threading
from contextlib import suppress

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hil.wire import protocol
from hil.wire.protocol import Closed, Connection, ProtocolError

pytestmark = pytest.mark.usefixtures("bounded")

times_ns = st.integers(-(1 << 62), 1 << 62)
identifiers = st.one_of(st.integers(0, 0x7FF), st.integers(0, 0x1FFFFFFF).map(lambda number: number | 0x80000000))
identifiers = identifiers | identifiers.map(lambda identifier: identifier | 0x40000000)
data = st.binary(max_size=8)
frames = st.lists(st.tuples(times_ns, identifiers, data), max_size=20)
timers = st.one_of(st.none(), times_ns)
kinds = st.integers(protocol.HELLO, protocol.END)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=10,
)

DECODERS = {
    "HELLO": protocol.decode_json,
    "START": protocol.decode_time,
    "GRANT": protocol.decode_grant,
    "YIELD": protocol.decode_yield,
    "FRAMES": protocol.decode_frames,
}
decoders = pytest.mark.parametrize("decode", DECODERS.values(), ids=DECODERS)

BODIES = {
    "HELLO": protocol.encode_json({"name": "plant", "timed": True}),
    "START": protocol.encode_time(-200_000_000),
    "GRANT": protocol.encode_grant(65_000, [(1, 0x130, bytes(7))], (65_000, 0x101, bytes(4))),
    "YIELD": protocol.encode_yield((125_000, None, [(125_000, 0x121, bytes(6)), (0, 0x7FF, b"")])),
    "FRAMES": protocol.encode_frames([(1, 0x80000001, b"abc"), (2, 2, b"")]),
}


# -- there and back --


@given(st.dictionaries(st.text(), json_values, max_size=5))
def test_json_returns(values):
    assert protocol.decode_json(protocol.encode_json(values)) == values


@given(times_ns)
def test_start_returns(now_ns):
    assert protocol.decode_time(protocol.encode_time(now_ns)) == now_ns


@given(times_ns, frames, st.one_of(st.none(), st.tuples(times_ns, identifiers, data)))
def test_grant_returns(now_ns, stored, cause):
    assert protocol.decode_grant(protocol.encode_grant(now_ns, stored, cause)) == (now_ns, stored, cause)


@given(times_ns, timers, frames)
def test_yield_returns(busy_ns, timer_ns, sends):
    assert protocol.decode_yield(protocol.encode_yield((busy_ns, timer_ns, sends))) == (busy_ns, timer_ns, sends)


@given(frames)
def test_frames_return(frames):
    assert protocol.decode_frames(protocol.encode_frames(frames)) == frames


def test_timer_at_zero_is_not_no_timer():
    assert protocol.decode_yield(protocol.encode_yield((0, 0, [])))[1] == 0


def test_grant_is_laid_out_as_the_page_says():
    """now, whether a frame wakes, their number, then each frame; little-endian."""
    body = protocol.encode_grant(1, [(2, 3, b"\xaa")], (4, 0x80000005, b""))
    expected = "0100000000000000 01 02000000" + "0200000000000000 03000000 01 aa" + "0400000000000000 05000080 00"
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
