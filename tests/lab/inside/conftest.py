"""The interfaces that the tests here need: vcan0, and two cards on one bus. In the lab a missing one is a failure."""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from hil.processes import Processes
from tests.lab import report as report_page
from tests.lab.inside import kernel
from tests.lab.inside.warm import start_node

ROOT = Path(__file__).parents[3]
Join = Callable[..., can.BusABC]
RESULTS = Path(os.environ.get("HIL_LAB_RESULTS", report_page.RESULTS))


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "row(*names): its outcome, and what it found, stand in these rows of the report")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Leave what a test of a row found, passed or not, for tests/lab/report.py."""
    found = yield
    mark = item.get_closest_marker("row")
    if mark is not None and not found.skipped and (found.when == "call" or found.failed):
        got = [str(value) for _, value in item.user_properties]
        for name in mark.args:
            write(f"row-{name}-{item.name}", {"row": name, "got": got, "passed": found.passed})
    return found


def write(name: str, figures: dict[str, Any]) -> None:
    """Leave figures in the folder of results."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    (RESULTS / f"{name}.json").write_text(json.dumps(figures, indent=2) + "\n")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.socketcan)


@pytest.fixture
def alone() -> Iterator[None]:
    """Nobody else's tests on the interfaces meanwhile."""
    with kernel.alone():
        yield


@pytest.fixture
def vcan(alone: None) -> str:  # noqa: ARG001 (it is there)
    """The kernel's virtual CAN."""
    needs(kernel.link, "vcan0")
    return "vcan0"


@pytest.fixture
def up(vcan: str) -> Iterator[None]:
    """Have vcan0 up again behind the test."""
    yield
    kernel.set_link(vcan, "up")


@pytest.fixture
def cards(alone: None) -> tuple[str, str]:  # noqa: ARG001 (it is there)
    """Two cards on one bus, which the tests may load as they like: somebody has to say which."""
    names = os.environ.get("HIL_LAB_CARDS", "").split(",")
    if len(names) != 2:
        kernel.give_up("HIL_LAB_CARDS=can0,can1 would say that these two are on one bus and may be loaded; or make lab")
    for name in names:
        needs(kernel.link, name)
    return names[0], names[1]


@pytest.fixture
def lab() -> None:
    """Only where interfaces may be taken down and controllers are as slow as in the lab."""
    if not kernel.INSIDE:
        kernel.give_up("only in the lab: make lab")


@pytest.fixture
def slow_wire(cards: tuple[str, str]) -> Iterator[None]:
    """In the lab, where a card's frames are gone at once, let its queue drain as over a wire of 100 kbit/s.

    The queue holds ten frames of 16 bytes, as txqueuelen says. Unlike netem, tbf leaves them in the sender's SO_SNDBUF.
    """
    if not kernel.INSIDE:
        yield
        return
    kernel.set_queue(cards[0], "replace", "tbf", "rate", "100kbit", "burst", "16", "limit", "160")
    yield
    kernel.set_queue(cards[0], "delete")


@pytest.fixture(params=["vcan0", "cards"])
def pair(request: pytest.FixtureRequest) -> tuple[str, str]:
    """Two channels, of which the one hears the other: vcan0 twice, or two cards."""
    if request.param == "cards":
        left, right = request.getfixturevalue("cards")
        return left, right
    return request.getfixturevalue("vcan"), "vcan0"


@pytest.fixture
def join() -> Iterator[Join]:
    """Open sockets, closed behind the test."""
    made: list[can.BusABC] = []

    def make(channel: str, **options: Any) -> can.BusABC:
        made.append(can.Bus(interface="socketcan", channel=channel, **options))
        return made[-1]

    yield make
    for bus in made:
        bus.shutdown()


@pytest.fixture
def report() -> Callable[[str, dict[str, Any]], None]:
    """Leave figures in the folder of results."""
    return write


@pytest.fixture
def got(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """Say what was found, for the test's row of the report."""
    return lambda text: request.node.user_properties.append(("got", text))


@pytest.fixture
def nodes(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Any]]:
    """Have the rig's nodes forked, in the lab; they are here by name, and all have ended when the test has."""
    started: dict[str, Any] = {}

    begin = start_node if kernel.INSIDE else Processes._start

    def start(self: Processes, name: str) -> Any:
        started[name] = begin(self, name)
        return started[name]

    monkeypatch.setattr(Processes, "_start", start)
    yield started
    left = [name for name, process in started.items() if process.poll() is None]
    for name in left:
        started[name].kill()
    assert not left, f"the rig has left {left} behind"


@pytest.fixture(scope="session")
def joint_c() -> Path:
    """The program in C that plays a joint; in the lab it has been built before."""
    needs(kernel.program, "make")
    needs(kernel.program, "cc")
    folder = RESULTS / "joint_c"
    target = folder / "joint_socketcan"
    make = ("make", "-C", str(ROOT / "examples" / "joint_c"), f"BUILD={folder}")
    subprocess.run([*make, f"CANTOOLS={sys.executable} -m cantools", str(target)], check=True, capture_output=True)
    return target


def needs(ask: Callable[..., Any], *words: str) -> Any:
    """Return what the kernel says; skip where it is unavailable."""
    try:
        return ask(*words)
    except kernel.Unavailable as why:
        kernel.give_up(why)
