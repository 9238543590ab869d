"""The examples in C, built once: by their Makefile as a user does, and with the compiler's sanitizers."""

import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = ROOT / "examples" / "joint_c"
HERE = Path(__file__).parent
CORE = ("law.c", "frames.c", "joint.c")
STRICT = ("-std=c11", "-Wall", "-Wextra", "-Werror")
SANITIZED = ("-O1", "-g", "-fsanitize=undefined,address", "-fno-sanitize-recover=all")


def run(*command):
    """Run a command that must succeed in silence."""
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "warning" not in done.stderr
    return done


def compile_replay(target, arm, sources=SOURCES, flags=("-O2",), objects=()):
    """Compile the program that plays calls to the core; arm: where arm.h and arm.c are."""
    core = [sources / name for name in CORE]
    made = objects or [arm / "arm.c"]
    run("cc", *STRICT, *flags, f"-I{sources}", f"-I{arm}", "-o", target, HERE / "replay.c", *core, *made)
    return target


@pytest.fixture(scope="session")
def built(tmp_path_factory):
    """What make makes, and two programs that play calls to the core: replay, and sanitized, which may be None."""
    if shutil.which("cc") is None or shutil.which("make") is None:
        pytest.skip("NO C COMPILER: `cc` and `make` are not installed, so the joint in C is NOT TESTED")
    folder = tmp_path_factory.mktemp("joint_c")
    run("make", "-C", SOURCES, f"BUILD={folder}", f"CANTOOLS={sys.executable} -m cantools")
    return SimpleNamespace(
        folder=folder,
        program=folder / "joint_socketcan",
        library=folder / "libjoint.so",
        replay=compile_replay(folder / "replay", folder, objects=[folder / "arm.o"]),
        arm_object=folder / "arm.o",
    )


@pytest.fixture(scope="session")
def sanitized(built):
    """The core with address and undefined-behaviour sanitizers."""
    probe = built.folder / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    command = ["cc", *SANITIZED, str(probe), "-o", str(built.folder / "probe")]
    if subprocess.run(command, capture_output=True, check=False).returncode != 0:
        pytest.skip("NO SANITIZERS: this compiler lacks -fsanitize=undefined,address, so they are NOT RUN")
    return compile_replay(built.folder / "sanitized", built.folder, flags=SANITIZED)
