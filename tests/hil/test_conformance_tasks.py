"""What any interface of python-can owes to its users, the part with threads: notifiers, event loops, ThreadSafeBus,
periodic tasks. Asked of `hil` and, as the yardstick, of `virtual`, like test_conformance.py."""

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor

import can
import pytest

from tests.hil.frames import standard

pytestmark = pytest.mark.usefixtures("bounded")

GUARD_S = 10
SILENCE_S = 0.05
"""How long what must not come is waited for: five periods of a task."""
PERIOD_S = 0.01


def first_bytes(bus, count):
    return [bus.recv(GUARD_S).data[0] for _ in range(count)]


def rest(bus):
    """All that has come and still comes, until the bus is silent; the bound on a test is for the bus that never is."""
    return list(iter(lambda: bus.recv(SILENCE_S), None))


class TestNotifier:
    def test_every_listener_gets_every_frame(self, pair):
        sender, receiver = pair
        readers, seen, done = [can.BufferedReader(), can.BufferedReader()], [], threading.Event()

        def count(message):
            seen.append(message)
            if len(seen) == 50:
                done.set()

        with can.Notifier(receiver, [*readers, count], timeout=0.05):
            for number in range(50):
                sender.send(standard(0x123, number), timeout=GUARD_S)
            assert [r.get_message(GUARD_S).data[0] for _ in range(50) for r in readers] == [k // 2 for k in range(100)]
            assert done.wait(GUARD_S)
        assert [message.data[0] for message in seen] == list(range(50))

    def test_one_notifier_for_two_buses(self, backend):
        first, second, sender = backend.open(), backend.open(), backend.open()
        reader = can.BufferedReader()
        with can.Notifier([first, second], [reader], timeout=0.05):
            sender.send(standard(0x123))
            assert [reader.get_message(GUARD_S).arbitration_id for _ in range(2)] == [0x123] * 2

    def test_listener_answers_from_its_thread(self, pair):
        asker, answerer = pair

        def answer(message):
            answerer.send(standard(0x200, message.data[0] + 1))

        with can.Notifier(answerer, [answer], timeout=0.05):
            number = 0
            for _ in range(20):
                asker.send(standard(0x100, number))
                number = asker.recv(GUARD_S).data[0]
        assert number == 20

    def test_bus_outlives_its_notifier(self, pair):
        sender, receiver = pair
        can.Notifier(receiver, [], timeout=0.01).stop()
        sender.send(standard(0x123))
        assert receiver.recv(GUARD_S).arbitration_id == 0x123

    def test_burst_reaches_an_event_loop(self, pair):
        """All frames, though many lie in the bus when its descriptor becomes readable."""
        sender, receiver = pair
        heard = []

        async def listen():
            loop = asyncio.get_running_loop()
            full = loop.create_future()

            def take(message):
                heard.append(message.data[0])
                if len(heard) == 100:
                    full.set_result(None)

            notifier = can.Notifier(receiver, [take], timeout=0.05, loop=loop)
            try:
                for number in range(100):
                    sender.send(standard(0x123, number), timeout=GUARD_S)
                await asyncio.wait_for(full, GUARD_S)
            finally:
                notifier.stop()

        asyncio.run(listen())
        assert heard == list(range(100))

    def test_coroutines_and_readers_of_an_event_loop(self, pair):
        sender, receiver = pair

        async def listen():
            reader, seen = can.AsyncBufferedReader(), asyncio.Queue()

            async def put(message):
                await seen.put(message)

            with can.Notifier(receiver, [reader, put], timeout=0.05, loop=asyncio.get_running_loop()):
                for number in range(3):
                    sender.send(standard(0x123, number))
                    for coming in (reader.get_message(), seen.get()):
                        assert (await asyncio.wait_for(coming, GUARD_S)).data[0] == number

        asyncio.run(listen())


class TestThreads:
    WORKERS, EACH = 16, 25

    def test_many_threads_share_two_buses(self, backend):
        sender, receiver = backend.pair(kind=can.ThreadSafeBus)
        message = can.Message(arbitration_id=0x123, is_extended_id=True, data=[254, 255, 1, 2])

        def send(_):
            for _ in range(self.EACH):
                sender.send(message, timeout=GUARD_S)

        def receive(_):
            return [receiver.recv(GUARD_S) for _ in range(self.EACH)]

        with ThreadPoolExecutor(2 * self.WORKERS) as pool:
            sending = pool.map(send, range(self.WORKERS))
            heard = [message for part in pool.map(receive, range(self.WORKERS)) for message in part]
            list(sending)
        assert len(heard) == self.WORKERS * self.EACH
        assert all(each.equals(message, timestamp_delta=None, check_channel=False) for each in heard)
        assert rest(receiver) == []

    def test_filters_hold_for_all_threads(self, backend):
        sender, receiver = backend.pair(kind=can.ThreadSafeBus)
        receiver.set_filters([{"can_id": 0x123, "can_mask": 0xFF, "extended": True}])

        def send(_):
            for identifier in (0x02, 0x123) * 10:
                sender.send(can.Message(arbitration_id=identifier, data=[1]), timeout=GUARD_S)

        def receive(_):
            return [receiver.recv(GUARD_S).arbitration_id for _ in range(10)]

        with ThreadPoolExecutor(16) as pool:
            sending = pool.map(send, range(8))
            assert list(pool.map(receive, range(8))) == [[0x123] * 10] * 8
            list(sending)
        assert rest(receiver) == []

    def test_one_thread_waits_while_another_sends(self, pair):
        """Both ways at once on plain buses, a thread for each direction of each."""

        def send(bus, identifier):
            for number in range(50):
                bus.send(standard(identifier, number), timeout=GUARD_S)

        with ThreadPoolExecutor(4) as pool:
            sending = [pool.submit(send, bus, 0x100 + k) for k, bus in enumerate(pair)]
            hearing = [pool.submit(first_bytes, bus, 50) for bus in pair]
            assert [future.result(GUARD_S) for future in hearing] == [list(range(50))] * 2
            assert [future.result(GUARD_S) for future in sending] == [None] * 2

    def test_thread_safe_bus_is_a_bus(self, backend):
        with backend.open(kind=can.ThreadSafeBus) as bus:
            assert bus.state == can.BusState.ACTIVE
            assert bus.recv(0) is None
            bus.filters = [{"can_id": 1, "can_mask": 1}]
            assert bus.filters


class TestPeriodicTasks:
    def test_frame_comes_again_and_again_until_stopped(self, pair):
        sender, receiver = pair
        task = sender.send_periodic(standard(0x123, 7), PERIOD_S)
        assert first_bytes(receiver, 10) == [7] * 10
        task.stop()
        assert len(rest(receiver)) < 50

    @pytest.mark.parametrize(("duration_s", "period_s"), [(0.01, 0.003), (0.1, 0.011), (0.2, 0.08)])
    def test_duration_is_not_exceeded(self, pair, duration_s, period_s):
        """Exactly so in virtual time (test_open_bus.py); a thread's last frame may be late."""
        sender, receiver = pair
        sender.send_periodic(standard(0x123), period_s, duration_s)
        heard = [receiver.recv(GUARD_S), receiver.recv(GUARD_S), *iter(lambda: receiver.recv(period_s + 0.2), None)]
        assert len(heard) <= duration_s / period_s + 1
        assert heard[-1].timestamp - heard[0].timestamp <= duration_s + 0.25

    def test_several_messages_take_turns(self, pair):
        sender, receiver = pair
        task = sender.send_periodic([standard(0x123, number) for number in range(3)], PERIOD_S)
        assert first_bytes(receiver, 9) == [0, 1, 2] * 3
        task.stop()

    def test_data_is_modified_on_the_way(self, pair):
        sender, receiver = pair
        task = sender.send_periodic(standard(0x123, 1), PERIOD_S)
        assert first_bytes(receiver, 3) == [1] * 3
        task.modify_data(standard(0x123, 2))
        heard = first_bytes(receiver, 10)
        assert heard == sorted(heard)
        assert heard[-5:] == [2] * 5
        task.stop()

    def test_impossible_modifications_are_refused(self, pair):
        sender, receiver = pair
        task = sender.send_periodic(standard(0x123, 1), PERIOD_S)
        assert first_bytes(receiver, 1) == [1]
        with pytest.raises(ValueError, match="arbitration ID"):
            task.modify_data(standard(0x124, 1))
        with pytest.raises(ValueError, match="number of"):
            task.modify_data([standard(0x123, 1), standard(0x123, 2)])
        task.stop()

    @pytest.mark.parametrize("messages", [[], "frame", [standard(0x100), standard(0x101)]])
    def test_impossible_messages_are_refused(self, pair, messages):
        with pytest.raises((ValueError, AttributeError)):
            pair[0].send_periodic(messages, PERIOD_S)

    def test_task_is_started_later_and_again(self, pair):
        sender, receiver = pair
        task = sender.send_periodic(standard(0x123, 7), PERIOD_S, autostart=False)
        assert receiver.recv(SILENCE_S) is None
        for _ in range(2):
            task.start()
            assert first_bytes(receiver, 3) == [7] * 3
            task.stop()
            rest(receiver)

    def test_message_is_made_anew_each_time(self, pair):
        sender, receiver = pair

        def count(message):
            message.data[0] += 1

        task = sender.send_periodic(standard(0x123, 0), PERIOD_S, modifier_callback=count)
        assert first_bytes(receiver, 5) == [1, 2, 3, 4, 5]
        task.stop()

    def test_all_tasks_are_stopped_at_once(self, pair):
        sender, receiver = pair
        for identifier in (0x100, 0x101, 0x102):
            sender.send_periodic(standard(identifier), PERIOD_S)
        heard = set()
        while len(heard) < 3:
            heard.add(receiver.recv(GUARD_S).arbitration_id)
        sender.stop_all_periodic_tasks()
        assert len(rest(receiver)) < 50

    def test_tasks_end_with_their_bus(self, pair):
        sender, receiver = pair
        sender.send_periodic(standard(0x123, 7), PERIOD_S)
        assert first_bytes(receiver, 2) == [7, 7]
        sender.shutdown()
        assert len(rest(receiver)) < 50

    def test_tasks_and_single_frames_mix(self, pair):
        sender, receiver = pair
        task = sender.send_periodic(standard(0x100), PERIOD_S)
        sender.send(standard(0x200))
        assert {receiver.recv(GUARD_S).arbitration_id for _ in range(5)} == {0x100, 0x200}
        task.stop()
