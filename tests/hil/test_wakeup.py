"""The short way of a wake-up's messages is the long way's: the same bytes, the same values, or no answer at all."""

import struct
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hil.wire import protocol, wakeup
from hil.wire.identifier import ERROR, EXTENDED, FD, REMOTE
from hil.wire.protocol import FAR_NS, GRANT, LEAVE, NO_TIMER, PREFIX_BYTES, YIELD, ProtocolError

times = st.integers(-(1 << 63), FAR_NS)
usual = st.tuples(times, st.integers(0, 0x7FF), st.binary(max_size=8))
unusual = st.tuples(
    st.integers(-(1 << 63), (1 << 63) - 1),
    st.sampled_from([0x800, 5 | EXTENDED, 5 | REMOTE, 5 | FD, 0x20 | ERROR]),
    st.binary(max_size=64),
)
reactions = st.tuples(
    st.integers(0, FAR_NS), st.none() | st.integers(NO_TIMER + 1, FAR_NS), st.lists(usual | unusual, max_size=3)
)


def long_way(decode: Any, wanted: int, data: bytes) -> Any:
    """Decode as protocol.py does; ProtocolError for what is not one whole message of this kind."""
    length, kind = struct.unpack_from("<IB", data)
    if kind != wanted or length != len(data) - PREFIX_BYTES + 1:
        raise ProtocolError
    return decode(data[PREFIX_BYTES:])


@given(times, st.lists(usual | unusual, max_size=3), st.none() | usual | unusual)
def test_a_grant_has_the_bytes_of_the_long_way(now_ns: int, stored: Any, cause: Any) -> None:
    body = protocol.encode_grant(now_ns, stored, cause)
    assert wakeup.encode_grant(now_ns, stored, cause) == protocol.message(GRANT, body)


@given(reactions)
def test_a_yield_has_the_bytes_of_the_long_way(reaction: Any) -> None:
    assert wakeup.encode_yield(reaction) == protocol.message(YIELD, protocol.encode_yield(reaction))


@given(times, st.lists(usual, max_size=3), st.none() | usual)
def test_usual_frames_are_granted_the_short_way(now_ns: int, stored: Any, cause: Any) -> None:
    assert wakeup.decode_grant(wakeup.encode_grant(now_ns, stored, cause)) == (now_ns, stored, cause)


@given(st.integers(0, FAR_NS), st.none() | st.integers(NO_TIMER + 1, FAR_NS), st.lists(usual, max_size=1))
def test_one_usual_frame_is_yielded_the_short_way(busy_ns: int, timer_ns: Any, sends: Any) -> None:
    assert wakeup.decode_yield(wakeup.encode_yield((busy_ns, timer_ns, sends))) == (busy_ns, timer_ns, sends)


GRANTED = wakeup.encode_grant(1, [(2, 3, b"\xaa")], (4, 5, bytes(8)))
YIELDED = wakeup.encode_yield((1, 2, [(3, 4, bytes(8))]))


@pytest.mark.parametrize(
    ("short", "decode", "kind", "whole"),
    [
        (wakeup.decode_grant, protocol.decode_grant, GRANT, GRANTED),
        (wakeup.decode_yield, protocol.decode_yield, YIELD, YIELDED),
    ],
    ids=["GRANT", "YIELD"],
)
def test_what_the_short_way_takes_the_long_way_takes_too_and_for_the_same(
    short: Any, decode: Any, kind: int, whole: bytes
) -> None:
    """Every byte of a message changed in every way that matters, every length cut, more behind."""
    changed = [
        whole[:at] + bytes([whole[at] ^ flip]) + whole[at + 1 :] for at in range(len(whole)) for flip in (1, 8, 64, 128)
    ]
    cut = [whole[:length] for length in range(len(whole))]
    for data in [*changed, *cut, whole, whole + b"\0", whole + whole]:
        found = short(data)
        assert found is None or found == long_way(decode, kind, data)
    assert short(whole) is not None


@given(reactions, times, st.lists(usual | unusual, max_size=3), st.none() | usual | unusual)
@example((0, None, [(0, 0x800, b"")]), 0, [(0, 0x800, b"")], None)
@example((0, None, [(FAR_NS + 1, 1, b"")]), 0, [(FAR_NS + 1, 1, b"")], None)
@example((0, None, [(0, 1, bytes(9))]), 0, [(0, 1, bytes(9))], None)
def test_what_is_unusual_is_left_to_the_long_way(reaction: Any, now_ns: int, stored: Any, cause: Any) -> None:
    for short, decode, kind, data in (
        (wakeup.decode_yield, protocol.decode_yield, YIELD, wakeup.encode_yield(reaction)),
        (wakeup.decode_grant, protocol.decode_grant, GRANT, wakeup.encode_grant(now_ns, stored, cause)),
    ):
        found = short(data)
        assert found is None or found == long_way(decode, kind, data)


@pytest.mark.parametrize("data", [b"", protocol.message(LEAVE, protocol.encode_yield((0, None, [])))])
def test_other_messages_are_left_to_the_long_way(data: bytes) -> None:
    assert wakeup.decode_grant(data) is None
    assert wakeup.decode_yield(data) is None
