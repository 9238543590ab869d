"""One node as a process on any python-can interface, by Sync or by the clock: `python -m hil.can_node ORDER.json NAME`.

What the rig starts, with its order in a file; `hil node -i socketcan` does the same by hand.
"""

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from dbc.codec import Codec
from hil import real_time
from hil.assemble import build_node, read_codec
from hil.can_port import CanPort
from hil.errors import NodeError
from hil.node_process import be_child, write_report
from hil.scenario import Scenario
from hil.sync_drive import SyncDrive, make_drive
from hil.wall_drive import WallDrive, make_wall_drive
from hil.wall_loop import QUIET_S, WallLoop


class Place(NamedTuple):
    """Where a bus is: python-can's interface, channel and further keywords."""

    interface: str
    channel: str
    options: dict[str, Any]


Check = Callable[[], None]
"""Called all the time; raises NodeError where there is no reason to go on."""


def play(
    scenario: Scenario,
    name: str,
    place: Place,
    ready: Path | None = None,
    rig: int | None = None,
    codec: Codec | None = None,
) -> dict[str, Any]:
    """Play one node until its part is over; return its report.

    ready: a file that appears when it listens, and says what it was refused. rig: the process without which it goes on
    no more. codec: of arm.dbc, if somebody has it already.
    """
    codec = codec or read_codec()
    node = build_node(scenario, name, codec, compiled=True)

    def check() -> None:
        if rig is not None and os.getppid() != rig:
            raise NodeError(f"{name}: the rig is gone")

    by_wall = scenario.clock.kind == "wall"
    drive = (make_wall_drive if by_wall else make_drive)(node, scenario, codec)
    port = CanPort(place.interface, place.channel, drive.listens, **place.options)
    try:
        if isinstance(drive, WallDrive):
            counted = _by_wall(scenario, drive, port, ready, check)
        else:
            counted = _by_sync(drive, port, ready, check)
    finally:
        port.close()
    refusals = {"full_queue": port.retries, "strange_frames": port.strangers, "bus_errors": dict(port.errors.counts)}
    return node.report() | counted | refusals


def _by_sync(drive: SyncDrive, port: CanPort, ready: Path | None, check: Check) -> dict[str, Any]:
    """Play a node by Sync, which counts nothing beside the node's own."""
    _say_ready(ready, [])
    for frame in drive.start():
        port.send(*frame)
    while not drive.finished:
        heard = port.receive(QUIET_S)
        check()
        if heard is not None and drive.is_of_another_run(heard[0]):
            continue
        for frame in drive.idle() if heard is None else drive.hear(*heard):
            port.send(*frame)
    return {}


def _by_wall(scenario: Scenario, drive: WallDrive, port: CanPort, ready: Path | None, check: Check) -> dict[str, Any]:
    """Play a node by the clock; return what its loop counted, and what the machine refused."""
    loop = WallLoop(drive, port, scenario.clock.stamps == "hardware")
    refused = real_time.prepare(scenario.node_names.index(drive.node.name))
    _say_ready(ready, refused)
    loop.run(check)
    return loop.report() | {"refused": refused}


def _say_ready(ready: Path | None, refused: list[str]) -> None:
    if ready is not None:
        write_report({"refused": refused}, ready)


def main() -> int:
    """Run as the rig's child."""
    order_path, name = sys.argv[1:]
    folder = Path(order_path).parent

    def play_ordered() -> dict[str, Any]:
        order = json.loads(Path(order_path).read_text())
        scenario, place = Scenario.model_validate(order["scenario"]), Place(*order["places"][name])
        codec = Codec.of_table(*order["codec"])
        return play(scenario, name, place, folder / f"{name}.ready", os.getppid(), codec)

    return be_child(name, play_ordered, folder / f"{name}.json")


if __name__ == "__main__":
    sys.exit(main())
