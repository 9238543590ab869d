"""`hil timing --dbc`: any database, analysed alone."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hil.timing.analysis import analyse, lowest_bitrate
from hil.timing.frame_time import as_fd, longest_bits
from hil.timing.response_time import Message

DBC = """VERSION ""
BU_: A B
BO_ 256 Fast: 8 A
 SG_ X : 0|8@1+ (1,0) [0|255] "" B
BO_ 512 Slow: 2 B
 SG_ Y : 0|8@1+ (1,0) [0|255] "" A
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 256 1;
"""

MS = 1_000_000


@pytest.fixture
def dbc(tmp_path: Path) -> str:
    path = tmp_path / "two.dbc"
    path.write_text(DBC)
    return str(path)


def test_figures_of_two_messages_are_those_by_hand(hil: Any, dbc: str) -> None:
    """135 bits of 8 bytes, 75 of 2, 4 us each: Fast waits for Slow; Slow for one Fast, for its period is 1 ms."""
    run = hil.run("timing", "--dbc", dbc, "--bitrate", "250000", "--period", "Slow=10", "--json")
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout)
    fast, slow = found["messages"]
    assert found["utilisation"] == pytest.approx(0.540 / 1 + 0.300 / 10)
    assert (fast["bits_worst"], slow["bits_worst"]) == (135, 75)
    assert (fast["response_bound_s"], slow["response_bound_s"]) == (0.84e-3, 0.84e-3)
    assert (fast["deadline_s"], fast["meets_deadline"], fast["response_max_s"]) == (1e-3, True, None)
    assert found["lowest_bitrate"] == 210_040  # 210 bits within 1 ms, of whole ns each: 4761 ns


def test_a_message_that_is_not_seen_is_as_long_as_it_may_be_and_one_that_is_as_it_was() -> None:
    """120 bits of Fast in place of 132: 12 bits of 4 us less for both."""
    messages = [Message("Fast", 0x100, MS, MS, 540_000), Message("Slow", 0x200, 10 * MS, 10 * MS, 300_000)]
    assert {row["response_bound_actual_s"] for row in analyse(messages, 4000)["messages"]} == {None}
    fast, slow = analyse(messages, 4000, actual_bits={"Fast": 120})["messages"]
    assert (fast["response_bound_s"], fast["bits_worst"]) == (0.84e-3, 135)
    assert (fast["response_bound_actual_s"], slow["response_bound_actual_s"]) == (0.792e-3, 0.792e-3)


def test_a_shorter_fd_frame_is_shorter_by_bits_at_the_data_rate() -> None:
    nominal, data = longest_bits(8, False, True)
    message = Message("M", 0x100, MS, MS, nominal * 2000 + data * 500, length=8, data_bits=data)
    (row,) = analyse([message], 2000, data_bit_ns=500, actual_bits={"M": nominal + data - 3 - 5})["messages"]
    assert row["bits_worst"] == nominal + data
    assert row["response_bound_s"] - row["response_bound_actual_s"] == pytest.approx(5 * 500e-9, abs=1e-12)


def test_a_lower_rate_than_the_lowest_misses_and_the_lowest_does_not(hil: Any, dbc: str) -> None:
    slow = hil.run("timing", "--dbc", dbc, "--bitrate", "200000", "--period", "10")
    assert slow.returncode == 6
    assert slow.stderr == "hil: Fast: may miss the deadline; utilisation 71.2%\n"
    assert hil.run("timing", "--dbc", dbc, "--bitrate", "250000", "--period", "10").returncode == 0


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        ((), 3, "has no GenMsgCycleTime for Slow: say how often each comes at most, for example --period Slow=10"),
        (("--period", "Sluw=10"), 3, "--period Sluw: no such message in"),
        (("--period", "Slow=0"), 2, "write NAME=MS or MS, from 0.001 to 1000000"),
        (("--period", "10", "--bitrate", "333333"), 2, "--bitrate 333333: a bit lasts 3000.003 ns"),
        (
            ("--period", "10", "--bitrate", "100000"),
            6,
            "Fast, Slow: may wait for ever: it and what goes before it fill the bus; utilisation 142.5%",
        ),
    ],
)
def test_what_cannot_be_is_said(hil: Any, dbc: str, words: tuple[str, ...], code: int, says: str) -> None:
    run = hil.run("timing", "--dbc", dbc, *words)
    assert run.returncode == code
    assert says in " ".join(run.stderr.replace("│", " ").split())


def test_no_database_is_said(hil: Any, tmp_path: Path) -> None:
    (tmp_path / "none.dbc").write_text("nonsense")
    for name in ("none.dbc", "missing.dbc"):
        run = hil.run("timing", "--dbc", name)
        assert (run.returncode, run.stderr.count("\n")) == (3, 1)
        assert "name a DBC file" in run.stderr


def test_the_data_rate_is_raised_where_it_would_be_below_the_other() -> None:
    """At 1 Mbit/s the frame takes its deadline to the ns, if its data goes as fast."""
    nominal, data = longest_bits(8, False, True)
    time_ns, deadline_ns = nominal * 4000 + data * 2000, (nominal + data) * 1000
    message = Message("M", 0x100, MS, deadline_ns, time_ns, length=8, data_bits=data)
    assert lowest_bitrate([message], 4000, data_bit_ns=2000) == 1_000_000
    assert lowest_bitrate([replace(message, deadline_ns=deadline_ns - 1)], 4000, data_bit_ns=2000) is None


def test_as_fd_asks_for_lengths() -> None:
    with pytest.raises(ValueError, match="M: its length is not known"):
        as_fd([Message("M", 0x100, MS, MS, 1000)], 1000, 500)
