"""candump as a witness: the frames of a run as it heard them, compared with our log and read by cantools."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cantools

from hil.rig import Outcome
from tests.lab.inside import kernel, rig
from tests.lab.inside.conftest import ROOT, needs

SYNC, ACCEL_REF, STOP = 0x080, 0x130, 0x010

Frame = tuple[int, bytes]


@contextmanager
def dumped(channel: str, folder: Path) -> Iterator[Path]:
    """Have candump write down what it hears meanwhile; behind that the file is whole, up to Stop."""
    candump, path = needs(kernel.program, "candump"), folder / "candump.log"
    before = kernel.listeners(channel)
    with path.open("w") as log, subprocess.Popen([candump, "-L", channel], stdout=log) as process:
        try:
            kernel.wait_for(lambda: kernel.listeners(channel) > before, f"candump listens to {channel}")
            yield path
            kernel.wait_for(lambda: f" {STOP:03X}#" in path.read_text(), "candump has written Stop")
        finally:
            process.terminate()


def frames(path: Path) -> list[Frame]:
    """Return the frames of a run: from the Sync after the first AccelRef to Stop."""
    lines = [line.split()[2].split("#") for line in path.read_text().splitlines()]
    found = [(int(identifier, 16), bytes.fromhex(data)) for identifier, data in lines]
    kinds = [identifier for identifier, _ in found]
    begin = kinds.index(SYNC, kinds.index(ACCEL_REF))
    return found[begin : kinds.index(STOP, begin) + 1]


def decode(heard: list[Frame]) -> int:
    """Have cantools decode every frame; return how many there are."""
    database = cantools.database.load_file(ROOT / "dbc" / "arm.dbc")
    for identifier, data in heard:
        assert database.decode_message(identifier, data)
    return len(heard)


def same(logged: Outcome, heard: list[Frame]) -> int:
    """Assert that each identifier has the same data in the same order; return how many places of the whole differ.

    Frames that two CPUs send at once may come to two sockets in two orders, so no more can be asked.
    """
    ours = [(identifier, data) for _, identifier, data, _ in logged.log.frames]
    assert rig.payloads(heard) == rig.payloads(ours)
    return sum(one != other for one, other in zip(ours, heard, strict=True))
