"""`hil timing --dbc`: what databases say and do not, CAN FD, transmit queues, and what is refused."""

import json
import signal
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import dbc.compiler
from dbc.compiler import describe
from hil.cli import app
from hil.wire.fd_bits import fd_worst_case_bits

HEAD = """VERSION ""
BU_: A B
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN",{reserved}"StandardCAN_FD","ExtendedCAN_FD";
BA_DEF_ BO_ "GenMsgSendType" ENUM "Cyclic","Event","cyclicAndSpontanX";
BA_DEF_ BO_ "GenMsgCycleTime" FLOAT 0 10000;
BA_DEF_ BO_ "GenMsgCycleTimeFast" INT 0 10000;
BA_DEF_ BO_ "GenMsgDelayTime" INT 0 10000;
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_DEF_DEF_ "GenMsgSendType" "Cyclic";
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "GenMsgCycleTimeFast" 0;
BA_DEF_DEF_ "GenMsgDelayTime" 0;
""".replace("{reserved}", '"reserved",' * 12)
NO_DEPTH = {"depth": None, "holds": None}
FD = ("VFrameFormat", 14)
CYCLE, FAST, DELAY = "GenMsgCycleTime", "GenMsgCycleTimeFast", "GenMsgDelayTime"
EVENT, BOTH = ("GenMsgSendType", 1), ("GenMsgSendType", 2)


def message(identifier: int, length: int, *attributes: tuple[str, float], sender: str = "A", name: str = "") -> str:
    """Return the lines of a message, called m and its identifier."""
    lines = [f"BO_ {identifier} {name or f'm{identifier}'}: {length} {sender}"]
    lines += [f'BA_ "{attribute}" BO_ {identifier} {value};' for attribute, value in attributes]
    return "\n".join(lines) + "\n"


@pytest.fixture
def made(tmp_path: Path) -> Any:
    """Write a database of these messages; return its path."""

    def make(*messages: str) -> str:
        path = tmp_path / "made.dbc"
        frames = [line for each in messages for line in each.splitlines() if line.startswith("BO_ ")]
        rest = [line for each in messages for line in each.splitlines() if not line.startswith("BO_ ")]
        head, definitions = HEAD.split("BA_DEF_", 1)
        path.write_text(head + "\n".join(frames) + "\nBA_DEF_" + definitions + "\n".join(rest) + "\n")
        return str(path)

    return make


@pytest.fixture
def run() -> Any:
    """Run `hil timing --dbc` in this process: a start costs half a second."""
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    yield lambda dbc, *words: CliRunner().invoke(app, ["timing", "--dbc", dbc, *words])
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def analysed(run: Any) -> Any:
    """Run it; return what it found."""

    def analyse(dbc: str, *words: str) -> Any:
        found = run(dbc, *words, "--json")
        assert found.stdout, found.stderr
        return json.loads(found.stdout)

    return analyse


@pytest.mark.parametrize(
    ("attributes", "distance_ms"),
    [
        ([], 0),
        ([(CYCLE, 2.5)], 2.5),
        ([(CYCLE, 100), (FAST, 20)], 20),
        ([(DELAY, 30)], 30),
        ([EVENT, (DELAY, 30)], 30),
        ([(CYCLE, 100), (DELAY, 30)], 100),
        ([BOTH, (CYCLE, 100), (DELAY, 30)], 30),
        ([BOTH, (CYCLE, 100)], 100),
    ],
)
def test_how_soon_a_message_may_come_again(made, attributes, distance_ms) -> None:
    """Its shortest cycle; the least distance where it comes by event, too, or has no cycle."""
    (found,) = describe(made(message(256, 8, *attributes)))
    assert found.distance_ms == distance_ms


def test_fd_frames_take_nominal_and_data_bits(made, analysed) -> None:
    """48 bytes at 500 kbit/s and 2 Mbit/s, alone; 10 bytes are padded to 12."""
    found = analysed(made(message(256, 48, FD, (CYCLE, 10))), "--bitrate", "500000", "--data-bitrate", "2000000")
    (row,) = found["messages"]
    nominal, data = fd_worst_case_bits(48)
    assert row["bits_worst"] == nominal + 3 + data
    assert row["response_bound_s"] == pytest.approx((nominal + 3) * 2e-6 + data * 0.5e-6, abs=1e-12)
    assert row["response_bound_fd_s"] is None
    (row,) = analysed(made(message(256, 10, FD, (CYCLE, 10))), "--data-bitrate", "1000000")["messages"]
    assert row["bits_worst"] == sum(fd_worst_case_bits(12)) + 3


def test_the_lowest_bitrate_keeps_the_data_rate(made, analysed) -> None:
    """One message with a deadline that the nominal bits alone may stretch: 1 ms less the data bits at 2 Mbit/s."""
    found = analysed(made(message(256, 48, FD, (CYCLE, 1))), "--bitrate", "500000", "--data-bitrate", "2000000")
    nominal, data = fd_worst_case_bits(48)
    bit_ns = (1_000_000 - data * 500) // (nominal + 3)
    assert found["lowest_bitrate"] == -(-1_000_000_000 // bit_ns)


def test_a_classic_database_is_shown_as_fd_beside_it(made, analysed, run) -> None:
    dbc = made(message(256, 8, (CYCLE, 10)), message(512, 2, (CYCLE, 10), sender="B"))
    assert {row["response_bound_fd_s"] for row in analysed(dbc)["messages"]} == {None}
    found = analysed(dbc, "--bitrate", "500000", "--data-bitrate", "4000000")
    assert (found["bitrate"], found["data_bitrate"]) == (500_000, 4_000_000)
    spans = [(fd_worst_case_bits(n)[0] + 3) * 2e-6 + fd_worst_case_bits(n)[1] * 0.25e-6 for n in (8, 2)]
    for row in found["messages"]:
        assert row["response_bound_s"] == pytest.approx((135 + 75) * 2e-6, abs=1e-12)
        assert row["response_bound_fd_s"] == pytest.approx(sum(spans), abs=1e-12)
    assert "CAN FD" in run(dbc, "--data-bitrate", "4000000").stdout


def test_jitter_and_deadline_are_given_by_name_or_for_all(made, analysed) -> None:
    dbc = made(message(256, 8, (CYCLE, 10)), message(512, 8, (CYCLE, 10)))
    options = ("--jitter", "m256=0.5", "--jitter", "0.25", "--deadline", "m512=7", "--deadline", "8")
    first, second = analysed(dbc, *options)["messages"]
    assert (first["jitter_s"], second["jitter_s"]) == (0.5e-3, 0.25e-3)
    assert (first["deadline_s"], second["deadline_s"]) == (8e-3, 7e-3)
    assert first["response_bound_s"] == pytest.approx(0.5e-3 + 2 * 135e-6, abs=1e-12)


def test_fifo_and_places_of_transmit_queues(made, analysed, run) -> None:
    """A's two messages wait for each other and for B's; B's for one below it, since no more of A is above it."""
    dbc = made(*(message(k, 8, (CYCLE, 10), sender=each) for k, each in ((256, "A"), (512, "B"), (768, "A"))))
    alone = analysed(dbc, "--fifo", "A", "--depth", "2")
    assert [round(row["response_bound_s"] / 135e-6, 6) for row in alone["messages"]] == [3, 3, 3]
    assert alone["queues"] == [
        {"node": "A", "frames_at_most": 2, "depth": 2, "holds": True},
        {"node": "B", "frames_at_most": 1, "depth": 2, "holds": True},
    ]
    assert analysed(dbc, "--fifo", "all")["queues"][0] == {"node": "A", "frames_at_most": 2} | NO_DEPTH
    ended = run(dbc, "--depth", "1")
    assert ended.exit_code == 6
    assert "A may hold 2 frames at once, 1 have a place in its queue: give it 2 places" in ended.stderr
    assert "MAY OVERFLOW" in ended.stdout


def test_messages_of_nobody_are_in_no_queue(made, analysed) -> None:
    found = analysed(made(message(256, 8, (CYCLE, 10), sender="Vector__XXX")), "--depth", "1")
    assert found["queues"] == [{"node": None, "frames_at_most": None, "depth": 1, "holds": None}]


def test_the_arm_is_analysed_with_any_node_a_fifo(analysed) -> None:
    """Stop, for one, has eight senders."""
    found = analysed(str(Path(dbc.compiler.__file__).parent / "arm.dbc"), "--period", "1000", "--fifo", "all")
    assert found["messages"]
    assert all(row["response_bound_s"] or row["unbounded"] for row in found["messages"])


def test_overload_tells_who_waits_for_ever_from_who_is_late(made, run) -> None:
    """Two of 135 us every 280 take 96 % of the bus, so that a third is too much."""
    dbc = made(*(message(k, 8, (CYCLE, 0.28)) for k in (256, 512)), message(768, 8, (CYCLE, 1)))
    ended = run(dbc, "--deadline", "m256=0.2")
    assert ended.exit_code == 6
    assert ended.stderr == (
        "hil: m256, m512: may miss the deadline; "
        "m768: may wait for ever: it and what goes before it fill the bus; utilisation 109.9%\n"
    )


@pytest.mark.parametrize(
    ("messages", "words", "code", "says"),
    [
        ([], (), 3, "has no messages: name a DBC file with BO_ lines"),
        ([message(256, 48, FD, (CYCLE, 10))], (), 3, "m256: CAN FD: say how fast the data goes, for example --data-"),
        ([message(256, 48, (CYCLE, 10))], (), 3, "m256: data length 48 is outside 0..8: split it over several frames"),
        ([message(256, 65, FD, (CYCLE, 10))], ("--data-bitrate", "2000000"), 3, "the limit is 64: split it"),
        ([message(256, 8, (CYCLE, 10)), message(256, 8, name="twin")], (), 3, "twin share identifier 0x100: renumber"),
        ([message(256, 8, (CYCLE, 10)), message(257, 8, name="m256")], (), 3, "m256 is there twice: rename one"),
        ([message(256, 8, (CYCLE, 3.3333333))], (), 3, "no whole number of ns: round it, for example --period m256=3."),
        (
            [message(256, 8)],
            ("--period", "0.3333333333"),
            2,
            "no whole number of ns: round it, for example to 0.333333",
        ),
        ([message(256, 8)], ("--period", "nan"), 2, "write NAME=MS or MS, from 0.001 to 1000000"),
        ([message(256, 8)], ("--period", "1e999999999"), 2, "write NAME=MS or MS, from 0.001 to 1000000"),
        ([message(256, 8)], ("--period", "1", "--jitter", "x=1"), 3, "--jitter x: no such message in"),
        ([message(256, 8)], ("--period", "1", "--deadline", "x=1"), 3, "--deadline x: no such message in"),
        ([message(256, 8)], ("--period", "1", "--jitter", "-1"), 2, "--jitter -1: write NAME=MS or MS, from 0 to"),
        ([message(256, 8)], ("--period", "1", "--fifo", "C"), 3, "--fifo C: sends nothing in"),
        ([message(256, 8)], ("--burst", "1", "--error-interval", "inf"), 2, "--error-interval inf: write milliseconds"),
        ([message(256, 8)], ("--data-bitrate", "500000"), 2, "data bit rate 500000 is below the nominal one, 1000000"),
        ([message(256, 8)], ("--data-bitrate", "3000000"), 2, "a bit lasts 333.333 ns, which is no whole number"),
    ],
)
def test_what_cannot_be_analysed_is_said(made, run, messages, words, code, says) -> None:
    ended = run(made(*messages), *words)
    assert ended.exit_code == code, ended.stderr
    assert says in " ".join(ended.stderr.replace("│", " ").split())
