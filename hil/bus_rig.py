"""A run on any python-can interface, by Sync or by the clock: processes for our nodes, patience for the others.

The rig itself only listens. By Sync its log has every frame of the run at the beginning of its cycle, as under
`functional`; by the clock `wall` where its stamp says.
"""

import json
import tempfile
import time
from collections.abc import Collection, Mapping
from itertools import chain
from math import inf
from pathlib import Path
from types import MappingProxyType

from dbc.codec import Codec
from dbc.compiler import load_arm
from hil.assemble import build_nodes, check_node_name
from hil.before_run import check_place, check_silence
from hil.bus_errors import as_wire
from hil.can_node import Place
from hil.can_port import CanPort
from hil.constants import STOP_OPERATOR
from hil.errors import NodeError, OutputError
from hil.expectation import expectation
from hil.joint_check import check_crystals
from hil.processes import START_S, Processes
from hil.rig import Outcome, Progress, no_progress
from hil.scenario import Scenario
from hil.sync_drive import Frame
from hil.two_senders import TwoSenders
from hil.wall_loop import QUIET_S
from hil.wall_witness import WallWitness
from hil.watchdog import Notice, watchdog
from hil.wire.participants import OnWait
from hil.witness import Witness

STOP_S = 2.0
"""Wall time for which an interface that went down may come up again, to carry the Stop."""


def run_on_bus(
    scenario: Scenario,
    place: Place,
    external: Collection[str] = (),
    elsewhere: Mapping[str, str] = MappingProxyType({}),
    progress: Progress = no_progress,
    notice: Notice = lambda _text: None,
    patience_s: float = inf,
) -> Outcome:
    """Run a scenario by its clock, `wall` or `sync`; external: nodes of somebody else; elsewhere: channels by node.

    Raises NodeError naming a node of ours that died, or whoever has not answered for patience_s; the robot is stopped.
    """
    began = time.perf_counter()
    for name in (*external, *elsewhere):
        check_node_name(scenario, name)
    scenario, codec = for_bus(scenario), load_arm()
    by_wall = scenario.clock.kind == "wall"
    build_nodes(scenario)
    own = [name for name in scenario.node_names if name not in external]
    port = CanPort(place.interface, place.channel, None, **place.options)
    if by_wall:
        port.stamp()
    try:
        check_place(place, scenario)
        check_silence(port, place, codec, external)
        with tempfile.TemporaryDirectory(prefix="hil-") as folder:
            nodes = _processes(scenario, place, elsewhere, Path(folder))
            witness = Witness(scenario, codec)
            if by_wall:
                witness = WallWitness(scenario, codec, external, lambda: sum(port.errors.counts.values()))
            try:
                for name in external:
                    notice(expectation(scenario, name))
                if external and "dsp" not in external:  # a DSP that repeats its first Sync would take it for the end
                    _stop_what_was_left(port, codec, notice)
                on_wait = _patient(witness, notice, patience_s)
                _start(nodes, own, on_wait, notice)
                _watch(witness, TwoSenders(codec, in_order=not by_wall), port, nodes, progress, on_wait)
                return _outcome(scenario, witness, nodes, port, began)
            finally:
                if not witness.stopped:
                    _stop(port, codec, notice)
                nodes.end()
    except OSError as error:
        raise OutputError(f"temporary files of the run: {error.strerror}; make room, or set TMPDIR") from None
    finally:
        port.close()


def _patient(witness: Witness, notice: Notice, patience_s: float) -> OnWait:
    """Return a watchdog that gives our processes START_S until the first Sync, however short patience is."""
    starting, running = watchdog(notice, max(patience_s, START_S)), watchdog(notice, patience_s)
    before_all = witness.cycle

    def on_wait(name: str, waited_s: float) -> None:
        (starting if witness.cycle == before_all else running)(name, waited_s)

    return on_wait


def _stop(port: CanPort, codec: Codec, notice: Notice) -> None:
    """Take whoever is in run to init; say so if that cannot be."""
    deadline = time.monotonic() + STOP_S
    while True:
        try:
            return port.send(codec["Stop"].identifier, codec["Stop"].pack(STOP_OPERATOR))
        except NodeError as error:
            if time.monotonic() > deadline:
                return notice(f"no Stop was sent, and who is in run stays there: {error}")
        time.sleep(0.1)


def _stop_what_was_left(port: CanPort, codec: Codec, notice: Notice) -> None:
    """Take nodes to init that are still in a run whose rig was killed; what they answer belongs to no run."""
    _stop(port, codec, notice)
    deadline = time.monotonic() + QUIET_S
    while (left_s := deadline - time.monotonic()) > 0:
        port.receive(left_s)


def for_bus(scenario: Scenario) -> Scenario:
    """Return the scenario as a bus without time of its own runs it: by its clock `wall`, or else by Sync.

    By Sync the rule is that of `functional`: each current acts at its delay after the cycle's start. Raises
    ScenarioError for a joint by its own timer.
    """
    if scenario.clock.kind == "wall":
        return scenario
    bus = scenario.bus.model_copy(update={"fidelity": "functional"})
    by_sync = scenario.model_copy(update={"bus": bus, "clock": scenario.clock.model_copy(update={"kind": "sync"})})
    check_crystals(by_sync)
    return by_sync


def _processes(scenario: Scenario, place: Place, elsewhere: Mapping[str, str], folder: Path) -> Processes:
    order = folder / "order.json"
    places = {name: place._replace(channel=elsewhere.get(name, place.channel)) for name in scenario.node_names}
    given = {"scenario": scenario.model_dump(mode="json"), "codec": load_arm().table(), "places": places}
    order.write_text(json.dumps(given))
    return Processes(folder, lambda name: ["hil.can_node", str(order), name])


def _start(nodes: Processes, own: Collection[str], on_wait: OnWait, notice: Notice) -> None:
    """Start our nodes, the DSP when the others listen: a bus keeps nothing for who comes later."""
    listening = [name for name in own if name != "dsp"]
    nodes.start(listening)
    began = time.monotonic()
    while missing := [name for name in listening if not (nodes.folder / f"{name}.ready").exists()]:
        nodes.check(missing)
        on_wait(missing[0], time.monotonic() - began)
        time.sleep(0.01)
    refused = [json.loads((nodes.folder / f"{name}.ready").read_text())["refused"] for name in listening]
    for line in dict.fromkeys(chain(*refused)):
        notice(line)
    nodes.start([name for name in own if name == "dsp"])


def _watch(
    witness: Witness, senders: TwoSenders, port: CanPort, nodes: Processes, progress: Progress, on_wait: OnWait
) -> None:
    """Listen until Stop; look after our nodes, and after whoever keeps the others waiting."""
    moved = time.monotonic()
    while not witness.stopped:
        heard = _receive(witness, port)
        now = time.monotonic()
        if heard is not None:
            senders.hear(*heard, witness.cycle)
        if heard is not None and witness.hear(*heard, port.came_ns):
            moved = now
            if witness.begins_cycle(heard[0]):
                progress(witness.done)
        elif now - moved > witness.patience_s:
            ended = [name for name, process in nodes.processes.items() if process.poll() is not None]
            if witness.in_real_time and nodes.processes and len(ended) == len(nodes.processes):
                return
            nodes.check(name for name in ended if not witness.in_real_time or nodes.processes[name].returncode)
            on_wait(witness.missing(), now - moved)


def _receive(witness: Witness, port: CanPort) -> Frame | None:
    """Return a frame, or None; by the clock the nodes go on without a bus that is down, and say what they did."""
    try:
        return port.receive(QUIET_S)
    except NodeError:
        if not witness.in_real_time:
            raise
        time.sleep(QUIET_S)
        return None


def _outcome(scenario: Scenario, witness: Witness, nodes: Processes, port: CanPort, began: float) -> Outcome:
    ended = time.perf_counter()
    started = ended if witness.began is None else witness.began
    wall_s, setup_wall_s = ended - started, started - began
    clock = witness.figures()
    try:
        reports = nodes.reports()
    except NodeError as error:
        raise NodeError(f"{error}; {witness.end()}") from None
    told = {name: report["bus_errors"] for name, report in reports.items()} | {"rig": port.errors.counts}
    kind = scenario.clock.kind
    return Outcome(
        scenario,
        kind,
        witness.log,
        reports,
        bits_on_wire=0,
        wall_s=wall_s,
        setup_wall_s=setup_wall_s,
        wire={name: as_wire(counts) for name, counts in told.items()},
        lost_frames=witness.lost,
        deterministic=kind == "sync",
        clock=clock,
    )
