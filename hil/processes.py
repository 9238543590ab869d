"""Running a scenario as processes: one a node, and the wire in this one. They share nothing but CAN frames.

All of them are kept on one CPU while they run, at the same addresses (hil/addresses.py): one works at a time, and
waking another CPU costs more than the work itself (three times slower on two). A node that dies, hangs or breaks the
protocol ends the run with its name; whatever happens, no process is left behind: a node whose bus is gone ends by
itself.
"""

import gc
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from math import inf
from pathlib import Path
from typing import Any

from dbc.compiler import load_arm
from hil.addresses import fixed_addresses
from hil.assemble import build_nodes
from hil.drive import RUN_IS_OVER
from hil.errors import NodeError, OutputError
from hil.pace import Pace
from hil.rig import Outcome, Progress, Recorder, carry_through, make_kernel, no_progress, wire_counts
from hil.scenario import Scenario
from hil.watchdog import Notice, watchdog
from hil.wire.channel import Listener
from hil.wire.participants import OnWait
from hil.wire.server import Bus, Server

START_S = 30.0
"""Wall time in which all nodes must have joined."""
END_S = 10.0
"""Wall time in which a node must have ended after the bus did."""
PATIENCE_S = 20.0
"""Wall time for which the bus waits for a node's answer."""


def run_processes(
    scenario: Scenario,
    channel: str,
    progress: Progress = no_progress,
    notice: Notice = lambda _text: None,
    patience_s: float = PATIENCE_S,
    pace: float = inf,
) -> Outcome:
    """Run every node as a process of its own; raise NodeError naming the one that failed.

    pace: virtual seconds a wall second, at most.
    """
    began = time.perf_counter()
    build_nodes(scenario)
    listener = Listener(channel)
    try:
        with tempfile.TemporaryDirectory(prefix="hil-") as folder:
            nodes = Processes(Path(folder), _command(scenario, channel, Path(folder)))
            try:
                nodes.start(scenario.node_names)
                return _run(scenario, listener, nodes, progress, watchdog(notice, patience_s), Pace(pace), began)
            finally:
                nodes.end()
    except OSError as error:
        raise OutputError(f"temporary files of the run: {error.strerror}; make room, or set TMPDIR") from None
    finally:
        listener.close()


def _command(scenario: Scenario, channel: str, folder: Path) -> Callable[[str], list[str]]:
    """Return what starts a node by its name, from files that hold the scenario and the codec."""
    resolved, codec = folder / "scenario.json", folder / "codec.json"
    resolved.write_text(scenario.model_dump_json())
    codec.write_text(json.dumps(load_arm().table()))
    return lambda name: ["hil.node_process", name, *map(str, (resolved, codec)), channel, str(folder / f"{name}.json")]


def _run(
    scenario: Scenario,
    listener: Listener,
    nodes: "Processes",
    progress: Progress,
    on_wait: OnWait,
    pace: Pace,
    began: float,
) -> Outcome:
    kernel = make_kernel(scenario)
    recorder = Recorder(kernel, load_arm())
    server = Server([Bus(listener, kernel)], scenario.node_names, on_wait, pace)
    reason = "the rig gave up"
    try:
        _gather(server, nodes)
        gc.freeze()  # as in the nodes: what is there is no garbage
        with nodes.named(), one_cpu([0, *nodes.pids()]):
            server.start()
            wall_s, setup_wall_s, bits = carry_through(scenario, kernel, server.run, progress, began)
        wire = wire_counts(kernel, scenario.node_names)
        reason = RUN_IS_OVER
    finally:
        gc.unfreeze()
        server.end(reason)
    reports = nodes.reports()
    return Outcome(
        scenario,
        "processes",
        recorder.log,
        reports,
        bits,
        wall_s,
        setup_wall_s,
        wire,
        server.lost_frames,
        server.deterministic,
    )


def _gather(server: Server, nodes: "Processes") -> None:
    """Wait until every node has joined."""
    deadline = time.monotonic() + START_S
    while server.missing():
        server.poll(0.05)
        nodes.check(server.missing())
        if time.monotonic() > deadline:
            raise NodeError(f"{', '.join(server.missing())} did not join the bus within {START_S:.0f} s of the start")


@contextmanager
def one_cpu(pids: Sequence[int]) -> Iterator[None]:
    """Keep these processes (0: this one) on one CPU meanwhile, where the system can."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    for pid in pids:
        with suppress(ProcessLookupError):
            os.sched_setaffinity(pid, {sorted(before)[os.getpid() % len(before)]})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


class Processes:
    """The node processes of one run; command: a module and its words, by the node's name.

    Each leaves its report as NAME.json in the folder.
    """

    def __init__(self, folder: Path, command: Callable[[str], list[str]]) -> None:
        self.folder = folder
        self.command = command
        self.processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, names: Sequence[str]) -> None:
        """Start these nodes."""
        with fixed_addresses():
            for name in names:
                self.processes[name] = self._start(name)

    def _start(self, name: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", *self.command(name)]
        with (self.folder / f"{name}.err").open("wb") as stderr:
            # A session of its own: Ctrl-C reaches the rig alone, which ends its nodes in order.
            return subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=stderr, stderr=stderr, start_new_session=True
            )

    def pids(self) -> list[int]:
        """Return the process ids."""
        return [process.pid for process in self.processes.values()]

    def check(self, names: Iterable[str]) -> None:
        """Raise NodeError for one of these nodes that has ended."""
        for name in names:
            if self.processes[name].poll() is not None:
                raise NodeError(self._obituary(name))

    @contextmanager
    def named(self) -> Iterator[None]:
        """Add to a NodeError how the process ended that it is about."""
        try:
            yield
        except NodeError as error:
            name = str(error).partition(" ")[0]
            if name in self.processes and self._ended(name, 1.0):
                raise NodeError(self._obituary(name)) from None
            raise

    def _ended(self, name: str, timeout_s: float) -> bool:
        try:
            self.processes[name].wait(timeout_s)
        except subprocess.TimeoutExpired:
            return False
        return True

    def _obituary(self, name: str) -> str:
        code = self.processes[name].returncode
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        said = (self.folder / f"{name}.err").read_text(errors="replace").strip().splitlines()
        return f"{name} {how} in the middle of the run" + (f": {said[-1]}" if said else "")

    def reports(self) -> dict[str, dict[str, Any]]:
        """Wait for every node's end and return what each reports."""
        found = {}
        for name in self.processes:
            if not self._ended(name, END_S):
                raise NodeError(f"{name} did not end within {END_S:.0f} s of the bus's end")
            if self.processes[name].returncode != 0:
                raise NodeError(self._obituary(name))
            found[name] = json.loads((self.folder / f"{name}.json").read_text())
        return found

    def end(self) -> None:
        """End what still runs: ask, and after a while insist (a stopped process hears only that)."""
        for process in self.processes.values():
            if process.poll() is None:
                process.terminate()
        for name, process in self.processes.items():
            if not self._ended(name, 1.0):
                process.kill()
                process.wait()
