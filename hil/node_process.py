"""One node as a process of its own on the `hil` bus: `python -m hil.node_process NAME SCENARIO CODEC CHANNEL REPORT`.

What the rig starts; `hil node` does the same by hand. Kept apart from the command line so that a node starts quickly.
"""

import gc
import json
import os
import re
import resource
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from dbc.codec import Codec
from hil.assemble import build_node
from hil.drive import over
from hil.errors import HilError, NodeError, OutputError, failed
from hil.scenario import Scenario
from hil.wire import client
from hil.wire.protocol import Closed


def run_node(scenario: Scenario, name: str, channel: str, codec: Codec | None = None) -> dict[str, Any]:
    """Play one node until the bus ends or its part is over; return its report, with the process's own figures."""
    node = build_node(scenario, name, codec, compiled=True)
    start_ns = -scenario.clock.setup_cycles * scenario.period_ns
    connection, welcome = client.join(channel, name, True, start_ns, node.wakes_on, node.stores)
    try:
        _check_bus(scenario, welcome, channel)
        over(connection, node)
    except Closed:
        raise NodeError(f"{name}: the bus {channel!r} went away in the middle of the run") from None
    finally:
        connection.close()
    usage = resource.getrusage(resource.RUSAGE_SELF)
    process = {"pid": os.getpid(), "cpu_s": usage.ru_utime + usage.ru_stime, "peak_memory_kB": _peak_memory_kB()}
    return node.report() | {"process": process}


def _peak_memory_kB() -> int:
    """Return this program's own peak; ru_maxrss is that of whoever started it, if that was larger."""
    try:
        status = Path("/proc/self/status").read_text()
        return int(re.findall(r"VmHWM:\s+(\d+) kB", status)[0])
    except (OSError, IndexError):
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _check_bus(scenario: Scenario, welcome: dict[str, Any], channel: str) -> None:
    """Refuse a bus that runs at another rate or fidelity than the scenario says."""
    bus = scenario.bus
    wanted = {"bit_ns": 0 if bus.fidelity == "functional" else scenario.bit_ns, "fidelity": bus.fidelity}
    for key, value in wanted.items():
        if welcome.get(key) != value:
            raise NodeError(
                f"channel {channel!r} runs with {key} = {welcome.get(key)}, the scenario wants {value}: "
                "start the bus with the same --bitrate and --fidelity"
            )


def write_report(report: dict[str, Any], path: Path) -> None:
    """Write a report so that a half-written one is never taken for a whole."""
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(report))
    partial.replace(path)


def main() -> int:
    """Run as the rig's child."""
    name, scenario_path, codec_path, channel, report_path = sys.argv[1:]

    def play() -> dict[str, Any]:
        scenario = Scenario.model_validate_json(Path(scenario_path).read_text())
        return run_node(scenario, name, channel, Codec.of_table(*json.loads(Path(codec_path).read_text())))

    return be_child(name, play, Path(report_path))


def be_child(name: str, play: Callable[[], dict[str, Any]], report_path: Path) -> int:
    """Play a node and leave its report; return the exit code, having said on stderr what went wrong."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    gc.freeze()  # what is imported is no garbage: neither the run nor the process's end need search it
    try:
        report = play()
    except HilError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    except Exception as error:
        print(failed(name, error), file=sys.stderr)
        return NodeError.exit_code
    try:
        write_report(report, report_path)
    except OSError as error:
        print(f"{name}: cannot write its report: {error.strerror}", file=sys.stderr)
        return OutputError.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
