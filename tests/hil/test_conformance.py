"""What any interface of python-can owes to its users, asked of `hil` and, as the yardstick, of `virtual`.

The same questions as python-can asks in its own back-to-back tests, and some more: frames of every kind, own frames,
filters, timestamps, coming and going. Notifiers, threads and periodic tasks: test_conformance_tasks.py.
"""

import itertools
import threading
import time

import can
import pytest

from tests.hil.frames import standard

pytestmark = pytest.mark.usefixtures("bounded")

GUARD_S = 10
"""How long what must come is waited for."""
SILENCE_S = 0.05
"""How long what must not come is waited for."""

CLASSIC = [
    can.Message(arbitration_id=0x100, is_extended_id=False, data=range(1, 9)),
    can.Message(arbitration_id=0x123456, is_extended_id=True, data=range(10, 18)),
    can.Message(arbitration_id=0x300, is_extended_id=False, data=[4, 5, 6]),
    can.Message(arbitration_id=0x300, is_extended_id=False),
    can.Message(arbitration_id=0, is_extended_id=False, data=bytes(8)),
    can.Message(arbitration_id=0x7FE, is_extended_id=False, data=b"\xff" * 8),
    can.Message(arbitration_id=0, is_extended_id=True, data=b"\x00"),
    can.Message(arbitration_id=0x1FFFFFFE, is_extended_id=True, data=b"\xff" * 7),
    can.Message(arbitration_id=0x123, is_extended_id=True),
    can.Message(arbitration_id=0x200, is_extended_id=False, is_remote_frame=True, dlc=4),
    can.Message(arbitration_id=0x200, is_extended_id=False, is_remote_frame=True),
    can.Message(arbitration_id=0x12345678, is_extended_id=True, is_remote_frame=True, dlc=8),
]
FD = [
    can.Message(arbitration_id=0x56789, is_fd=True, data=b"\xff" * 64),
    can.Message(arbitration_id=0x98765, is_fd=True, bitrate_switch=True, data=b"\xff" * 48),
    can.Message(arbitration_id=0x98765, is_fd=True, error_state_indicator=True, data=bytes(12)),
    can.Message(
        arbitration_id=0x100, is_extended_id=False, is_fd=True, bitrate_switch=True, error_state_indicator=True
    ),
    *[
        can.Message(arbitration_id=0x700, is_extended_id=False, is_fd=True, bitrate_switch=True, data=range(length))
        for length in (1, 7, 8, 12, 16, 20, 24, 32, 48, 64)
    ],
]


def describe(message):
    return f"{message.arbitration_id:X}-{message.dlc}" + "".join(
        word
        for word, is_so in {
            "-extended": message.is_extended_id,
            "-remote": message.is_remote_frame,
            "-fd": message.is_fd,
            "-brs": message.bitrate_switch,
            "-esi": message.error_state_indicator,
        }.items()
        if is_so
    )


def same(received, sent):
    """Whether a frame came as it was sent; when and where it came aside."""
    assert received is not None
    assert received is not sent
    return received.equals(sent, timestamp_delta=None, check_channel=False, check_direction=False)


def identifiers(bus, count):
    """What comes: this many frames, and what else there is."""
    heard = [bus.recv(GUARD_S) for _ in range(count)]
    return [message.arbitration_id for message in [*heard, *iter(lambda: bus.recv(SILENCE_S), None)]]


class TestBackToBack:
    # -- frames of every kind --

    def there_and_back(self, first, second, message):
        first.send(message)
        assert same(second.recv(GUARD_S), message)
        answer = can.Message.__copy__(message)
        answer.arbitration_id += 1
        second.send(answer)
        assert same(first.recv(GUARD_S), answer)
        assert first.recv(0) is None
        assert second.recv(0) is None

    @pytest.mark.parametrize("message", CLASSIC, ids=describe)
    def test_classic_frame_there_and_back(self, pair, message):
        self.there_and_back(*pair, message)

    @pytest.mark.parametrize("message", [*FD, CLASSIC[0], CLASSIC[9]], ids=describe)
    def test_frame_there_and_back_with_fd(self, backend, message):
        self.there_and_back(*backend.pair(fd=True), message)

    def test_nothing_is_heard_of_a_silent_bus(self, pair):
        assert [bus.recv(timeout) for bus in pair for timeout in (0, SILENCE_S)] == [None] * 4

    def test_everybody_else_hears_a_frame_once(self, backend):
        sender, *others = [backend.open() for _ in range(4)]
        sender.send(standard(0x123, 1))
        assert [identifiers(bus, 1) for bus in others] == [[0x123]] * 3
        assert sender.recv(0) is None

    def test_frames_come_in_the_order_they_were_sent(self, pair):
        first, second = pair
        for number in range(60):
            first.send(standard(0x123, number), timeout=GUARD_S)
        assert [second.recv(GUARD_S).data[0] for _ in range(60)] == list(range(60))

    def test_frame_tells_its_channel_and_direction(self, pair):
        first, second = pair
        first.send(can.Message(arbitration_id=0x123, is_rx=False, channel="elsewhere"))
        heard = second.recv(GUARD_S)
        assert heard.is_rx
        assert not heard.is_error_frame
        assert heard.channel == "classic"

    def test_message_stays_its_senders(self, pair):
        """Neither does sending change it, nor does changing it change what was sent."""
        first, second = pair
        message = can.Message(arbitration_id=0x123, timestamp=121.5, data=[1, 2])
        first.send(message)
        assert (message.timestamp, message.channel, message.is_rx) == (121.5, None, True)
        message.data[0] = 9
        assert second.recv(GUARD_S).data == b"\x01\x02"

    # -- own frames --

    def test_own_frames_stay_away(self, pair):
        first, second = pair
        first.send(standard(0x123))
        assert second.recv(GUARD_S) is not None
        assert first.recv(0) is None

    def test_own_frames_come_back_on_request(self, backend):
        """As sent by oneself here, as received there, and at one and the same time."""
        own, other = backend.open(receive_own_messages=True), backend.open()
        own.send(standard(0x123, 1, 2))
        mine, theirs = own.recv(GUARD_S), other.recv(GUARD_S)
        assert same(mine, theirs)
        assert (mine.is_rx, theirs.is_rx) == (False, True)
        assert mine.timestamp == theirs.timestamp
        other.send(standard(0x124))
        assert own.recv(GUARD_S).is_rx
        assert other.recv(0) is None

    def test_everybody_has_a_message_of_their_own(self, backend):
        own, second, third = backend.open(receive_own_messages=True), backend.open(), backend.open()
        own.send(standard(0x300, 2, 1, 3))
        mine, his, hers = (bus.recv(GUARD_S) for bus in (own, second, third))
        his.data[0] = 4
        assert (mine.data, his.data, hers.data) == (b"\x02\x01\x03", b"\x04\x01\x03", b"\x02\x01\x03")

    # -- timestamps --

    def test_timestamps_tell_the_time_between_frames(self, pair):
        first, second = pair
        first.send(standard(0x123))
        before = second.recv(GUARD_S)
        time.sleep(0.3)
        first.send(standard(0x123))
        passed_s = second.recv(GUARD_S).timestamp - before.timestamp
        assert 0.2 <= passed_s <= 3

    def test_timestamps_never_go_back_whoever_sends(self, backend):
        first, second, listener = backend.open(), backend.open(), backend.open()
        for _ in range(10):
            first.send(standard(0x100), timeout=GUARD_S)
            second.send(standard(0x200), timeout=GUARD_S)
        times = [listener.recv(GUARD_S).timestamp for _ in range(20)]
        assert times == sorted(times)
        assert times[0] > 0

    def test_timestamps_resolve_less_than_a_second(self, pair):
        first, second = pair
        times = []
        for _ in range(3):
            first.send(standard(0x123))
            times.append(second.recv(GUARD_S).timestamp)
            time.sleep(0.01)
        assert len({stamp % 1 for stamp in times}) == 3

    # -- filters --

    FRAMES = (
        standard(0x100),
        standard(0x101),
        standard(0x200),
        can.Message(arbitration_id=0x100, is_extended_id=True),
        can.Message(arbitration_id=0x10100, is_extended_id=True),
    )
    FILTERS = (
        (None, [0, 1, 2, 3, 4]),
        ([], [0, 1, 2, 3, 4]),
        ([{"can_id": 0x100, "can_mask": 0x7FF}], [0, 3, 4]),
        ([{"can_id": 0x100, "can_mask": 0x7FF, "extended": False}], [0]),
        ([{"can_id": 0x100, "can_mask": 0x1FFFFFFF, "extended": True}], [3]),
        ([{"can_id": 0x100, "can_mask": 0x7FE, "extended": False}], [0, 1]),
        ([{"can_id": 0x101, "can_mask": 0x7FF}, {"can_id": 0x200, "can_mask": 0x7FF, "extended": False}], [1, 2]),
        ([{"can_id": 0x7FF, "can_mask": 0x7FF}], []),
    )

    @pytest.mark.parametrize(("filters", "passed"), FILTERS)
    @pytest.mark.parametrize("when", ["opened", "set", "assigned"])
    def test_filters_let_through_what_matches(self, backend, filters, passed, when):
        sender = backend.open()
        receiver = backend.open(can_filters=filters if when == "opened" else [{"can_id": 0x7FF, "can_mask": 0x7FF}])
        if when == "set":
            receiver.set_filters(filters)
        elif when == "assigned":
            receiver.filters = filters
        assert (receiver.filters or None) == (filters or None)
        for message in self.FRAMES:
            sender.send(message)
        assert sorted(identifiers(receiver, len(passed))) == sorted(self.FRAMES[k].arbitration_id for k in passed)

    def test_filters_are_taken_off(self, pair):
        sender, receiver = pair
        receiver.set_filters([{"can_id": 0x200, "can_mask": 0x7FF}])
        receiver.set_filters()
        sender.send(standard(0x100))
        assert identifiers(receiver, 1) == [0x100]

    # -- waiting --

    def test_recv_without_a_timeout_waits_for_a_frame(self, pair):
        first, second = pair
        sending = threading.Timer(0.1, first.send, [standard(0x123)])
        sending.start()
        assert second.recv().arbitration_id == 0x123
        sending.join()

    def test_frames_wait_for_who_comes_late_to_recv(self, backend):
        """Once the third has heard the last one, they lie there for the second to take."""
        first, second, third = backend.open(), backend.open(), backend.open()
        for number in range(5):
            first.send(standard(0x123, number))
        for _ in range(5):
            assert third.recv(GUARD_S)
        assert [second.recv(0).data[0] for _ in range(5)] == list(range(5))

    def test_bus_is_iterated_over(self, pair):
        first, second = pair
        for number in range(5):
            first.send(standard(0x123, number))
        assert [message.data[0] for message in itertools.islice(second, 5)] == list(range(5))

    def test_descriptor_if_there_is_one_is_a_descriptor(self, pair):
        try:
            assert pair[0].fileno() > 0
        except NotImplementedError:
            assert isinstance(pair[0], can.interfaces.virtual.VirtualBus)

    # -- coming and going --

    def test_bus_tells_its_channel_and_state(self, pair):
        assert all("classic" in bus.channel_info and str(bus) == bus.channel_info for bus in pair)
        assert [bus.state for bus in pair] == [can.BusState.ACTIVE] * 2
        assert pair[0].protocol == can.CanProtocol.CAN_20

    def test_shutdown_twice_is_once(self, pair):
        for bus in (*pair, *pair):
            bus.shutdown()

    def test_bus_is_a_context(self, backend):
        other = backend.open()
        with backend.open() as bus:
            bus.send(standard(0x123))
            assert other.recv(GUARD_S).arbitration_id == 0x123
        with pytest.raises(can.CanOperationError):
            bus.send(standard(0x123))

    def test_bus_that_was_shut_down_does_nothing(self, pair):
        pair[0].shutdown()
        with pytest.raises(can.CanOperationError):
            pair[0].send(standard(0x123))
        with pytest.raises(can.CanOperationError):
            pair[0].recv(SILENCE_S)

    def test_who_leaves_is_not_missed_and_may_come_again(self, backend):
        first, second, third = backend.open(), backend.open(), backend.open()
        second.shutdown()
        first.send(standard(0x100))
        assert third.recv(GUARD_S).arbitration_id == 0x100
        again = backend.open()
        first.send(standard(0x101))
        assert identifiers(again, 1) == [0x101]

    def test_last_words_are_heard(self, pair):
        first, second = pair
        for number in range(5):
            first.send(standard(0x123, number))
        first.shutdown()
        assert [second.recv(GUARD_S).data[0] for _ in range(5)] == list(range(5))
