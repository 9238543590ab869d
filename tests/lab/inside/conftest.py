"""The interfaces that the tests here need: vcan0, and two cards on one bus. In the lab a missing one is a failure."""

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest

from tests.lab.inside import kernel

ROOT = Path(__file__).parents[3]
Join = Callable[..., can.BusABC]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.socketcan)


@pytest.fixture
def vcan() -> str:
    """The kernel's virtual CAN."""
    needs(kernel.link, "vcan0")
    return "vcan0"


@pytest.fixture
def cards() -> tuple[str, str]:
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
    folder = Path(os.environ.get("HIL_LAB_RESULTS", ROOT / "build" / "lab"))

    def write(name: str, figures: dict[str, Any]) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.json").write_text(json.dumps(figures, indent=2) + "\n")

    return write


def needs(ask: Callable[..., Any], *words: str) -> Any:
    """Return what the kernel says; skip where it is unavailable."""
    try:
        return ask(*words)
    except kernel.Unavailable as why:
        kernel.give_up(why)
