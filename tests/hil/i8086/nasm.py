"""The assembler: on the path, or Debian's, kept in the cache; where it cannot be had tests skip, under CI they fail."""

import shutil
import subprocess
from pathlib import Path

from tests.lab import packages
from tests.lab.packages import Missing
from tests.wanting import wanting

SOURCE = Path(__file__).parents[3] / "firmware_py" / "targets" / "i8086" / "joint.asm"


def program() -> Path:
    """Return the program; raise Missing with the reason where it cannot be had."""
    if on_path := shutil.which("nasm"):
        return Path(on_path)
    try:
        return packages.unpacked("nasm") / "usr" / "bin" / "nasm"
    except Missing:
        packages.ask("apt-get", "update")
        return packages.unpacked("nasm") / "usr" / "bin" / "nasm"


def assemble(text: str, folder: Path) -> tuple[bytes, str]:
    """Return the machine code and its listing."""
    try:
        nasm = program()
    except Missing as missing:
        wanting(f"NO NASM, so joint.asm is NOT ASSEMBLED: {missing}")
    (folder / "joint.asm").write_text(text)
    command = [nasm, "-f", "bin", "-o", "joint.bin", "-l", "joint.lst", "joint.asm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return (folder / "joint.bin").read_bytes(), (folder / "joint.lst").read_text()
