"""Lays out what lies on a board that plays a joint under MicroPython: the sources as they stand, and what is made.

    python -m examples.joint_micropython.board DIR

The table of frames is made from dbc/arm.dbc, the rest of settings.py from a scenario.
"""

import argparse
import sys
from importlib.resources import files
from pathlib import Path
from pprint import pformat

from dbc.compiler import load_arm
from firmware_py.joint_cpu import JointCPU
from hil.assemble import build_joint, check_node_name
from hil.errors import HilError, OutputError, ScenarioError
from hil.scenario_file import load

HERE = Path(__file__).parent / "on_board"
UNCHANGED = {"dbc": ("__init__.py", "crc.py", "status.py"), "firmware_py": ("__init__.py", "joint_cpu.py", "words.py")}
"""By package."""
FOR_BOARDS = {"codec.py": "dbc/codec.py"}
"""Where a file of ours takes the place of another."""


def lay_out(folder, joint):
    """Write the board's folder for a joint, a firmware_py.joint_cpu.JointCPU."""
    for package, names in UNCHANGED.items():
        for name in names:
            _copy(files(package) / name, folder / package / name)
    for path in sorted(HERE.glob("*.py")):
        _copy(path, folder / FOR_BOARDS.get(path.name, path.name))
    lines = [f"{name} = {pformat(value)}\n" for name, value in settings(joint).items()]
    (folder / "settings.py").write_text('"""Made by board.py; not to be edited."""\n\n' + "".join(lines))


def _copy(source, target):
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(source.read_bytes())


def settings(joint):
    """Return what settings.py says, by name."""
    status = joint.status
    own = (joint.encoder, joint.current, joint.parameter, joint.acknowledge, status.state, status.heartbeat)
    messages = [
        (each.name, each.identifier, each.formats, each.protected) for each in (joint.stop, joint.accel_ref, *own)
    ]
    return {
        "NUMBER": joint.number,
        "TURN": status.turn,
        "TURNS": status.turns,
        "PERIOD_NS": joint.period_ns,
        "TAIL_NS": status.tail_ns,
        "COMPUTE_NS": joint.compute_ns,
        "REFERENCE": (joint.accel_ref.name, joint.reference_index),
        "WORDS": formats(joint.words),
        "VERSION": joint.database_version,
        "MESSAGES": messages,
    }


def formats(words):
    """Return the arguments that make such Words."""
    return (
        words.bits,
        len(words.saturations),
        words.d_fraction,
        words.current_places + words.d_fraction,
        words.speed_places + words.d_fraction,
        words.current_shift,
        words.acceleration_shift,
        (words.round_d, words.round_estimate, words.round_reference),
        words.wraps_over,
        words.counter_mask.bit_length(),
    )


def joint_of(scenario, number):
    """Return joint `number` of a scenario, in Python; raise ScenarioError where that is no joint of its own."""
    check_node_name(scenario, f"joint{number}")
    joint = build_joint(scenario, number, load_arm())
    if type(joint) is not JointCPU:
        raise ScenarioError(
            f"joint{number} of {scenario.name} is not the joint CPU as it stands: leave out its cpu and crystal_ppm"
        )
    return joint


def main(words=None):
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m examples.joint_micropython.board", description=__doc__.splitlines()[0]
    )
    parser.add_argument("folder", type=Path, metavar="DIR", help="the folder, made if it is not there")
    parser.add_argument("--joint", type=int, default=2, help="which joint, from 1 (%(default)s)")
    parser.add_argument("--scenario", default="paper-joint", help="built-in name or TOML file (%(default)s)")
    options = parser.parse_args(words)
    try:
        lay_out(options.folder, joint_of(load(options.scenario), options.joint))
    except HilError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    except OSError as error:
        print(f"{options.folder} cannot be written: {error.strerror}", file=sys.stderr)
        return OutputError.exit_code
    print(f"{options.folder}: joint {options.joint} of {options.scenario}, all that lies on a board")
    return 0


if __name__ == "__main__":
    sys.exit(main())
