"""`hil bus` without expected clients, through python-can: what a bus has that python-can's `virtual` has not.

Bit rates that must agree, acknowledgement, a transmit queue that ends, states, listening only, several channels.
"""

import errno
import re
import select
import time

import can
import pytest

from tests.hil.frames import standard

pytestmark = pytest.mark.usefixtures("bounded")

GUARD_S = 10
SILENCE_S = 0.1
QUEUE = 10
"""Frames that wait in a node's transmit queue; the next one finds no room."""


@pytest.fixture
def join():
    made = []

    def make(channel="arm", **kwargs):
        kwargs.setdefault("error_frames", "none")
        made.append(can.Bus(interface="hil", channel=channel, **kwargs))
        return made[-1]

    yield make
    for bus in made:
        bus.shutdown()


@pytest.fixture
def alone(hil, join):
    """A node with nobody else on its bus."""
    hil.bus("arm")
    return join()


def fill(bus):
    for number in range(QUEUE):
        bus.send(standard(0x100, number))


def wait_for_state(bus, state):
    """The node learns of its state from the bus, so some time later."""
    deadline = time.monotonic() + GUARD_S
    while bus.state != state:
        assert time.monotonic() < deadline, bus.state
        bus.recv(0.01)


def refusal(join, **kwargs):
    """The text of the refusal, digits only where there are numbers."""
    with pytest.raises(can.CanInitializationError) as caught:
        join(**kwargs)
    return re.sub(r"(?<=\d)[_, '](?=\d)", "", str(caught.value))


# -- bit rates --

TIMING_500K = can.BitTiming.from_sample_point(f_clock=80_000_000, bitrate=500_000, sample_point=80.0)
TIMING_FD = can.BitTimingFd.from_sample_point(
    f_clock=80_000_000, nom_bitrate=500_000, nom_sample_point=80.0, data_bitrate=2_000_000, data_sample_point=80.0
)
FD_OPTIONS = ("--bitrate", "500000", "--data-bitrate", "2000000")
FD_FRAME = can.Message(arbitration_id=0x123, is_fd=True, bitrate_switch=True, data=bytes(64))


@pytest.mark.parametrize("options", [{}, {"bitrate": 500_000}, {"timing": TIMING_500K}, {"fd": False}])
def test_client_of_the_bus_own_bit_rate_may_join(hil, join, options):
    hil.bus("arm", "--bitrate", "500000")
    first, second = join(**options), join()
    first.send(standard(0x123))
    assert second.recv(GUARD_S).arbitration_id == 0x123


@pytest.mark.parametrize("options", [{"bitrate": 500_000}, {"timing": TIMING_500K}])
def test_other_bit_rate_is_refused_with_both(hil, join, options):
    hil.bus("arm")
    text = refusal(join, **options)
    assert "500000" in text
    assert "1000000" in text


def test_other_data_bit_rate_is_refused_with_both(hil, join):
    hil.bus("arm", *FD_OPTIONS)
    text = refusal(join, fd=True, bitrate=500_000, data_bitrate=4_000_000)
    assert "2000000" in text
    assert "4000000" in text


@pytest.mark.parametrize("options", [{"fd": True}, {"timing": TIMING_FD}, {"fd": True, "data_bitrate": 2_000_000}])
def test_fd_on_a_classic_bus_is_refused_with_the_cure(hil, join, options):
    hil.bus("arm", "--bitrate", "500000")
    assert "--data-bitrate" in refusal(join, **options)


@pytest.mark.parametrize(
    "options", [{}, {"bitrate": 500_000, "data_bitrate": 2_000_000}, {"timing": TIMING_FD}, {"data_bitrate": 2_000_000}]
)
def test_fd_client_of_an_fd_bus_may_join(hil, join, options):
    hil.bus("arm", *FD_OPTIONS)
    first, second = join(fd=True, **options), join(fd=True)
    assert first.protocol == can.CanProtocol.CAN_FD
    first.send(FD_FRAME)
    heard = second.recv(GUARD_S)
    assert heard.equals(FD_FRAME, timestamp_delta=None, check_channel=False)


def test_fd_frame_of_a_client_without_fd_is_refused(hil, join):
    hil.bus("arm", *FD_OPTIONS)
    first, second = join(), join(fd=True)
    with pytest.raises(can.CanOperationError, match="FD"):
        first.send(FD_FRAME)
    first.send(standard(0x124))
    assert second.recv(GUARD_S).arbitration_id == 0x124


def test_options_of_other_interfaces_do_no_harm(hil, join):
    """A program that is written for one adapter opens the bus with its keywords."""
    hil.bus("arm")
    join(single_handle=True, app_name="tool", serial=1234, local_loopback=True, rx_queue_size=100, unique_hardware_id=0)


# -- acknowledgement and the transmit queue --


def test_node_alone_is_not_acknowledged_and_its_queue_fills(alone):
    fill(alone)
    with pytest.raises(can.CanOperationError) as caught:
        alone.send(standard(0x100, QUEUE))
    assert caught.value.error_code == errno.ENOBUFS
    assert alone.recv(SILENCE_S) is None


def test_frames_wait_for_somebody_to_acknowledge_them(alone, join):
    fill(alone)
    late = join()
    assert [late.recv(GUARD_S).data[0] for _ in range(QUEUE)] == list(range(QUEUE))
    alone.send(standard(0x101), timeout=GUARD_S)
    assert late.recv(GUARD_S).arbitration_id == 0x101
    assert late.recv(SILENCE_S) is None


def test_own_frame_comes_back_when_it_is_acknowledged(hil, join):
    hil.bus("arm")
    own = join(receive_own_messages=True)
    own.send(standard(0x100))
    assert own.recv(SILENCE_S) is None
    late = join()
    assert own.recv(GUARD_S).timestamp == late.recv(GUARD_S).timestamp


def test_flushed_frames_are_never_sent(alone, join):
    fill(alone)
    alone.flush_tx_buffer()
    alone.send(standard(0x101))
    late = join()
    assert late.recv(GUARD_S).arbitration_id == 0x101
    assert late.recv(SILENCE_S) is None


def send_when_there_is_room(bus, message):
    """Send, and try again as long as the queue is full, as on a real adapter."""
    while True:
        try:
            bus.send(message)
        except can.CanOperationError as error:
            if error.error_code != errno.ENOBUFS:
                raise
            time.sleep(0.001)
        else:
            return


def test_burst_is_sent_by_and_by(hil, join):
    """Each frame that was accepted comes, once and in order."""
    hil.bus("arm")
    sender, receiver = join(), join()
    for number in range(100):
        send_when_there_is_room(sender, standard(0x100, number))
    assert [receiver.recv(GUARD_S).data[0] for _ in range(100)] == list(range(100))


# -- states --


def test_what_happened_is_told_by_error_frames_unless_declined(hil, join):
    """Nobody acknowledges: told once, then warning and error-passive as they come; classes as in linux/can/error.h."""
    hil.bus("arm")
    alone = join(error_frames="all")
    alone.send(standard(0x100))
    heard = [alone.recv(GUARD_S) for _ in range(3)]
    assert all(message.is_error_frame and message.dlc == 8 for message in heard)
    no_ack, bus_error, controller, counters = 0x20, 0x80, 0x04, 0x200
    assert [message.arbitration_id for message in heard] == [
        no_ack | bus_error | counters,
        controller | counters,
        controller | counters,
    ]
    transmit_warning, transmit_passive = 0x08, 0x20
    assert [message.data[1] for message in heard] == [0, transmit_warning, transmit_passive]
    assert [message.data[6] for message in heard] == [8, 96, 128]
    assert alone.recv(SILENCE_S) is None


def test_node_alone_becomes_error_passive_and_recovers(alone, join):
    """Each attempt without an acknowledgement costs 8 of transmit error counter, up to 128."""
    assert alone.state == can.BusState.ACTIVE
    alone.send(standard(0x100))
    wait_for_state(alone, can.BusState.PASSIVE)
    late = join()
    assert late.recv(GUARD_S).arbitration_id == 0x100
    wait_for_state(alone, can.BusState.ACTIVE)
    assert late.state == can.BusState.ACTIVE


@pytest.mark.parametrize("how", ["listen_only", "state"])
def test_who_only_listens_hears_but_does_not_acknowledge(alone, join, how):
    listener = join(listen_only=how == "listen_only")
    if how == "state":
        listener.state = can.BusState.PASSIVE
    assert listener.state == can.BusState.PASSIVE
    fill(alone)
    with pytest.raises(can.CanOperationError):
        alone.send(standard(0x100, QUEUE))
    assert {listener.recv(GUARD_S).data[0] for _ in range(5)} == {0}  # again and again, since nobody acknowledges it
    other = join()
    assert [other.recv(GUARD_S).data[0] for _ in range(QUEUE)] == list(range(QUEUE))
    heard = [0]
    while heard[-1] < QUEUE - 1:
        heard.append(listener.recv(GUARD_S).data[0])
    assert sorted(set(heard)) == list(range(QUEUE))
    assert heard == sorted(heard)


def test_who_stops_listening_only_acknowledges(alone, join):
    listener = join(listen_only=True)
    alone.send(standard(0x100))
    assert [listener.recv(GUARD_S).arbitration_id for _ in range(5)] == [0x100] * 5  # again and again
    listener.state = can.BusState.ACTIVE
    assert listener.state == can.BusState.ACTIVE
    alone.send(standard(0x101), timeout=GUARD_S)
    wait_for_state(alone, can.BusState.ACTIVE)
    while (heard := listener.recv(GUARD_S)).arbitration_id == 0x100:
        pass
    assert heard.arbitration_id == 0x101
    assert listener.recv(SILENCE_S) is None


# -- the descriptor, the channels --


def test_descriptor_is_readable_when_there_is_a_frame(hil, join):
    hil.bus("arm")
    sender, receiver = join(), join()
    assert select.select([receiver], [], [], SILENCE_S)[0] == []
    sender.send(standard(0x123))
    assert select.select([receiver], [], [], GUARD_S)[0] == [receiver]
    assert receiver.recv(0).arbitration_id == 0x123
    assert select.select([receiver], [], [], SILENCE_S)[0] == []


def test_one_server_has_several_channels_and_one_time(hil, join):
    hil.bus("arm leg")
    assert list(can.detect_available_configs("hil")) == [
        {"interface": "hil", "channel": "arm"},
        {"interface": "hil", "channel": "leg"},
    ]
    times = []
    for channel in ("arm", "leg", "arm", "leg"):
        sender, receiver = join(channel), join(channel)
        sender.send(standard(0x123))
        heard = receiver.recv(GUARD_S)
        assert heard.channel == channel
        times.append(heard.timestamp)
        sender.shutdown()
        receiver.shutdown()
    assert times == sorted(set(times))


def test_channels_do_not_hear_each_other(hil, join):
    hil.bus("arm leg")
    arm, other, leg = join("arm"), join("arm"), join("leg")
    arm.send(standard(0x123))
    assert other.recv(GUARD_S).arbitration_id == 0x123
    assert leg.recv(SILENCE_S) is None


def test_time_of_an_open_bus_begins_with_it(hil, join):
    """And goes no faster than the wall's while no client is timed."""
    began = time.monotonic()
    hil.bus("arm")
    sender, receiver = join(), join()
    sender.send(standard(0x123))
    stamp = receiver.recv(GUARD_S).timestamp
    assert 0 < stamp <= time.monotonic() - began
