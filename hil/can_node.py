"""One node as a process on any python-can interface, by the Sync frame: `python -m hil.can_node ORDER.json NAME`.

What the rig starts, with its order in a file; `hil node -i socketcan` does the same by hand.
"""

import json
import os
import sys
from pathlib import Path
from typing import Any, NamedTuple

from dbc.compiler import load_arm
from hil.assemble import build_node
from hil.can_port import CanPort
from hil.errors import NodeError
from hil.node_process import be_child
from hil.scenario import Scenario
from hil.sync_drive import make_drive

QUIET_S = 0.25
"""Wall time without a frame after which a node looks whether its rig is still there, and says again what it said."""


class Place(NamedTuple):
    """Where a bus is: python-can's interface, channel and further keywords."""

    interface: str
    channel: str
    options: dict[str, Any]


def play(
    scenario: Scenario, name: str, place: Place, ready: Path | None = None, rig: int | None = None
) -> dict[str, Any]:
    """Play one node by the Sync frame until its part is over; return its report.

    ready: a file that appears when it listens. rig: the process without which it goes on no more.
    """
    codec = load_arm()
    node = build_node(scenario, name, codec, compiled=True)
    drive = make_drive(node, scenario, codec)
    port = CanPort(place.interface, place.channel, drive.listens, **place.options)
    try:
        if ready is not None:
            ready.touch()
        for frame in drive.start():
            port.send(*frame)
        while not drive.finished:
            heard = port.receive(QUIET_S)
            if heard is None and rig is not None and os.getppid() != rig:
                raise NodeError(f"{name}: the rig is gone")
            for frame in drive.idle() if heard is None else drive.hear(*heard):
                port.send(*frame)
    finally:
        port.close()
    counted = {"full_queue": port.retries, "strange_frames": port.strangers, "bus_errors": dict(port.errors.counts)}
    return node.report() | counted


def main() -> int:
    """Run as the rig's child."""
    order_path, name = sys.argv[1:]
    folder = Path(order_path).parent

    def play_ordered() -> dict[str, Any]:
        order = json.loads(Path(order_path).read_text())
        scenario, place = Scenario.model_validate(order["scenario"]), Place(*order["places"][name])
        return play(scenario, name, place, folder / f"{name}.ready", os.getppid())

    return be_child(name, play_ordered, folder / f"{name}.json")


if __name__ == "__main__":
    sys.exit(main())
