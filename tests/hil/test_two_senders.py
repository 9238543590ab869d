"""Another sender of our identifiers: heard before a run, and known during it by what no single sender would send."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from random import Random
from typing import Any

import can
import pytest

from dbc.compiler import load_arm
from hil import scenario_file
from hil.before_run import check_place
from hil.can_node import Place
from hil.can_port import CanPort
from hil.errors import ChannelError
from hil.two_senders import TwoSenders
from tests.hil.test_sync_drive import Scatter, load

CODEC = load_arm()
WORDS = ("run", "-i", "hil", "-c", "street", "--clock", "sync", "--json")
LIMIT_S = 60


@contextmanager
def sender(name: str, *values: int, every_s: float = 0.05) -> Iterator[None]:
    """Somebody who sends this frame again and again."""
    over = threading.Event()
    message = can.Message(arbitration_id=CODEC[name].identifier, is_extended_id=False, data=CODEC[name].pack(*values))

    def send() -> None:
        with can.Bus(interface="hil", channel="street") as bus:
            while not over.wait(every_s):
                with suppress(can.CanOperationError):  # while it is alone nobody acknowledges, and its queue is full
                    bus.send(message)

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


# -- before a run --


def test_sender_of_our_identifiers_is_named_before_anything_is_started(hil: Any) -> None:
    hil.bus("street")
    with sender("Encoder_2", 0, 0):
        run = hil.run(*WORDS)
    assert run.returncode == 4
    assert "hil street: somebody else sends Encoder_2 0x102 " in run.stderr
    assert " times a second: another sender of our identifiers: see who by unplugging" in run.stderr
    assert "see `hil doctor -i hil -c street`" in run.stderr


def test_run_that_is_going_on_is_left_alone(hil: Any) -> None:
    hil.bus("street")
    other = CanPort("hil", "street", {0x080})
    first = hil.start(*WORDS, "--set", "duration_s=30")
    while other.receive(1.0) is None:
        pass
    other.close()
    second = hil.run(*WORDS)
    assert second.returncode == 4
    assert "Sync 0x080" in second.stderr
    assert "a run is going on: let it end, or stop it" in second.stderr
    assert first.poll() is None


def test_external_dsp_may_repeat_its_sync_before_the_rig_is_there(hil: Any, short_settings: list[str]) -> None:
    hil.bus("street")
    dsp = hil.start("node", "dsp", "-c", "street", "--set", "clock.kind=sync", *short_settings)
    other = CanPort("hil", "street", {0x080})
    while other.receive(1.0) is None:
        pass
    other.close()
    run = hil.run(*WORDS, "--external", "dsp", *short_settings)
    assert run.returncode == 0, run.stderr
    dsp.communicate(timeout=LIMIT_S)
    assert dsp.returncode == 0


@pytest.mark.parametrize(("rate", "fits"), [("1000000", True), ("250000", False)])
def test_bit_rate_is_looked_at_first(hil: Any, rate: str, fits: bool) -> None:
    hil.bus("street", "--bitrate", rate)
    place, scenario = Place("hil", "street", {}), scenario_file.load("paper-joint")
    if fits:
        check_place(place, scenario)
        return
    with pytest.raises(ChannelError, match=r"250000 bit/s.*hil bus street --bitrate 1000000"):
        check_place(place, scenario)


# -- during a run --


def test_second_sender_in_a_run_ends_it_with_a_stop(hil: Any) -> None:
    hil.bus("street")
    witness = CanPort("hil", "street", {0x010, 0x080})
    rig = hil.start(*WORDS, "--set", "duration_s=30")
    while witness.receive(1.0) != (0x080, b"\x10"):
        pass
    with sender("Current_2", 1234, 5, 0x40):
        _, err = rig.communicate(timeout=LIMIT_S)
    assert rig.returncode == 4, err
    assert "Current_2 0x122 in cycle " in err
    assert ": another sender of our identifiers: see who" in err
    assert "Traceback" not in err
    while (frame := witness.receive(1.0)) is None or frame[0] == 0x080:
        pass
    assert frame == (0x010, b"\x01")
    witness.close()


@pytest.mark.parametrize("seed", range(4))
def test_what_nodes_say_again_is_no_other_sender(seed: int) -> None:
    """A whole run, in which the DSP, and so everybody, repeats themselves in the set-up, heard in any order."""
    ether = Scatter(load("paper-joint", **{"duration_s": 0.3, "trajectory.time_s": 0.25}), seed)
    senders, chance, hear = TwoSenders(CODEC), Random(seed), ether.witness.hear
    heard: list[int] = []

    def judge(identifier: int, data: bytes) -> bool:
        if not ether.witness.stopped:
            senders.hear(identifier, data, ether.witness.cycle)
        heard.append(identifier)
        if chance.random() < 0.02:
            ether.say("dsp", ether.drives["dsp"].idle())
        return hear(identifier, data)

    ether.witness.hear = judge  # type: ignore[method-assign]
    ether.run()
    assert heard.count(0x080) > 200 + 300
    assert ether.witness.stopped


def frame(name: str, *values: int) -> tuple[int, bytes]:
    return CODEC[name].identifier, CODEC[name].pack(*values)


FIRST = frame("Sync", 0)

STRANGE = {
    "two boards for one joint": (
        [frame("Current_1", 7, 3, 1), frame("Current_1", 0, 0, 1), frame("Sync", 2), frame("Sync", 5)],
        "Current_1 0x121 in cycle 9: 00 00 00 00 01",
    ),
    "two encoders": ([frame("Encoder_1", 7, 3), frame("Encoder_1", 8, 3)], "Encoder_1 0x101 in cycle 9"),
    "two references": ([frame("AccelRef", 1, 2, 3, 255), frame("AccelRef", 1, 2, 4, 255)], "AccelRef 0x130"),
    "two states": ([frame("State_1", 1, 0, 0, 0, 0, 2), frame("State_1", 2, 0, 0, 0, 0, 2)], "State_1 0x401"),
    "Sync goes back": ([frame("Sync", 2), frame("Sync", 254)], "FE behind 02 of a later cycle"),
    "a cycle of long ago": ([frame("Current_1", 7, 3, 1), frame("Current_1", 7, 3, 0)], "Current_1 0x121 in cycle 9"),
    "a cycle to come": ([frame("Encoder_1", 7, 4)], "before Sync 4: another sender"),
    "wrong length": ([(0x101, b"\1\2\3")], "whose length or CRC is not that of arm.dbc"),
    "wrong CRC": ([(0x121, bytes(6))], "Current_1 0x121 in cycle 9: 00 00 00 00 00 00 whose length or CRC"),
}


@pytest.mark.parametrize("name", STRANGE)
def test_each_sign_of_another_sender(name: str) -> None:
    *before, last = [FIRST, *STRANGE[name][0]]
    senders = TwoSenders(CODEC)
    for each in before:
        senders.hear(*each, 9)
    with pytest.raises(ChannelError) as caught:
        senders.hear(*last, 9)
    assert STRANGE[name][1] in str(caught.value)
    assert "unplugging one device after the other" in str(caught.value)


LEGAL = {
    "again": [frame("Encoder_1", 7, 3)] * 3,
    "the next cycle": [frame("Encoder_1", 7, 0), frame("Encoder_1", 8, 1)],
    "a late Sync": [frame("Sync", 255), frame("Encoder_1", 7, 0), frame("Sync", 0)],
    "two Syncs lost": [frame("Sync", 253), frame("Encoder_1", 7, 0)],
    "cycles that the rig did not hear": [frame("Sync", 250), frame("Sync", 4), frame("Sync", 100)],
    "a joint that heard Stop": [frame("Current_1", 7, 3, 1), frame("Current_1", 0, 0, 1), frame("Sync", 2)],
    "a board in run, of another rig": [frame("Current_1", 0, 0, 200), frame("Sync", 56), frame("Current_1", 0, 0, 56)],
    "the set-up": [frame("Parameter_1", 0, 7, 1), frame("Parameter_1", 1, 8, 1)],
    "not ours": [(0x7DF, b"\1"), (0x7DF, b"\2")],
}


@pytest.mark.parametrize("name", LEGAL)
def test_what_a_single_sender_may_send(name: str) -> None:
    senders = TwoSenders(CODEC)
    for each in LEGAL[name]:
        senders.hear(*each, 9)


LATE = {
    "a State behind the next Sync": [frame("Sync", 1), frame("Sync", 2), frame("State_1", 2, 0, 0, 0, 0, 1)],
    "Encoders of two cycles at once": [frame("Sync", 2), frame("Encoder_1", 7, 1), frame("Encoder_1", 8, 2)],
    "Encoder in front of its Sync, then an older one": [frame("Encoder_1", 8, 9), frame("Encoder_1", 7, 8)],
    "cycles that the DSP skipped": [frame("Sync", 100), frame("Current_1", 7, 3, 1), frame("Current_1", 8, 3, 100)],
}


@pytest.mark.parametrize("name", LATE)
def test_by_the_wall_late_is_no_other_sender(name: str) -> None:
    senders = TwoSenders(CODEC, in_order=False)
    for each in [FIRST, *LATE[name]]:
        senders.hear(*each, 9)


@pytest.mark.parametrize("name", [name for name in STRANGE if name.startswith(("two", "wrong"))])
def test_by_the_wall_two_things_of_one_cycle_are_still_two_senders(name: str) -> None:
    *before, last = [FIRST, *STRANGE[name][0]]
    senders = TwoSenders(CODEC, in_order=False)
    for each in before:
        senders.hear(*each, 9)
    with pytest.raises(ChannelError, match=STRANGE[name][1]):
        senders.hear(*last, 9)
