"""Periodic sending in virtual time: the bus itself sends, so that no period is off by a nanosecond."""

from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import can
import pytest

from tests.hil.frames import standard

pytestmark = pytest.mark.usefixtures("bounded")

GUARD_S = 15
PERIOD_NS = 10_000_000
PERIOD_S = 0.01
OLD, NEW, OTHER = 2, 3, 4
"""Data with which frames of identifier 123 are equally long, stuff bits included: so ends are a period apart."""


def ns(message):
    return round(message.timestamp * 1e9)


@pytest.fixture
def play(hil):
    """Run a timed sender, and return what a timed listener heard for a virtual second."""
    hil.bus("arm", "--expect", "sender,listener")

    def listen(bus):
        with bus:
            heard, until = [], 1.0
            while (message := bus.recv(timeout=until)) is not None:
                heard.append(message)
                until = max(0.0, 1.0 - message.timestamp)
            return heard

    def run(script, **options):
        sender = can.Bus(interface="hil", channel="arm", name="sender", timed=True, **options)
        listener = can.Bus(interface="hil", channel="arm", name="listener", timed=True)
        with ThreadPoolExecutor() as pool:
            hearing = pool.submit(listen, listener)
            with sender:
                script(sender)
            return hearing.result(GUARD_S)

    return run


def periods(messages):
    times = [ns(message) for message in messages]
    return [later - earlier for earlier, later in pairwise(times)]


def test_period_is_exact(play):
    """Frame k is queued at k periods; the bus is idle, so all take the same time to their end."""

    def script(bus):
        bus.send_periodic(standard(0x123, 7), PERIOD_S)
        assert bus.recv(timeout=0.995) is None

    heard = play(script)
    assert len(heard) == 100
    assert periods(heard) == [PERIOD_NS] * 99
    assert ns(heard[0]) < PERIOD_NS // 10


@pytest.mark.parametrize("period_ns", [1_000_000, 1_234_567, 333_333_333])
def test_period_is_a_number_of_nanoseconds(play, period_ns):
    heard = play(lambda bus: (bus.send_periodic(standard(0x123), period_ns * 1e-9), bus.recv(timeout=0.9)))
    assert set(periods(heard)) == {period_ns}


def test_stop_is_at_an_instant(play):
    def script(bus):
        task = bus.send_periodic(standard(0x123), PERIOD_S)
        bus.recv(timeout=0.035)
        task.stop()
        bus.recv(timeout=0.5)

    assert len(play(script)) == 4


def test_data_changes_at_an_instant_and_the_period_stays(play):
    def script(bus):
        task = bus.send_periodic(standard(0x123, OLD), PERIOD_S)
        bus.recv(timeout=0.035)
        task.modify_data(standard(0x123, NEW))
        bus.recv(timeout=0.03)
        task.stop()

    heard = play(script)
    assert [message.data[0] for message in heard] == [OLD] * 4 + [NEW] * 3
    assert set(periods(heard)) == {PERIOD_NS}


def test_messages_take_turns_one_a_period(play):
    def script(bus):
        bus.send_periodic([standard(0x123, number) for number in (OLD, NEW, OTHER)], PERIOD_S)
        bus.recv(timeout=0.085)

    heard = play(script)
    assert [message.data[0] for message in heard] == [OLD, NEW, OTHER] * 3
    assert set(periods(heard)) == {PERIOD_NS}


def test_duration_ends_it(play):
    heard = play(lambda bus: (bus.send_periodic(standard(0x123), PERIOD_S, 0.1), bus.recv(timeout=0.9)))
    assert len(heard) == 10


def test_task_ends_with_its_bus(play):
    def script(bus):
        bus.send_periodic(standard(0x123), PERIOD_S)
        bus.recv(timeout=0.055)

    assert len(play(script)) == 6


@pytest.mark.parametrize(("fifo", "order"), [(True, [0x200, 0x100]), (False, [0x100, 0x200])])
def test_two_tasks_meet_in_the_transmit_queue(play, fifo, order):
    """Queued at one instant: first-in-first-out, or by priority whichever task is the elder."""

    def script(bus):
        bus.send_periodic(standard(0x200), PERIOD_S)
        bus.send_periodic(standard(0x100), PERIOD_S)
        bus.recv(timeout=0.095)

    heard = play(script, fifo=fifo)
    assert [message.arbitration_id for message in heard] == order * 10
    assert periods(heard[::2]) == periods(heard[1::2]) == [PERIOD_NS] * 9


def test_own_periodic_frames_come_back_at_their_end(hil):
    hil.bus("arm", "--expect", "own,other")

    def attend(bus):
        with bus:
            return [bus.recv(timeout=1.0) for _ in range(5)]

    own = can.Bus(interface="hil", channel="arm", name="own", timed=True, receive_own_messages=True)
    other = can.Bus(interface="hil", channel="arm", name="other", timed=True)
    own.send_periodic(standard(0x123), PERIOD_S)
    with ThreadPoolExecutor() as pool:
        mine, theirs = pool.map(attend, (own, other))
    assert [ns(message) for message in mine] == [ns(message) for message in theirs]
    assert {message.is_rx for message in mine} == {False}
    assert {message.is_rx for message in theirs} == {True}
