"""Captures of single instructions of a real 8086, and the interpreter run on them.

They lie outside the project: in the folder that HIL_8086_CAPTURES names, else in ../shared/captures-8086.
"""

import gzip
import json
import os
from pathlib import Path
from typing import Any

import pytest

from hil.i8086.decode import decode
from hil.i8086.decoded import Decoded, UnknownForm
from hil.i8086.interpreter import Interpreter
from hil.i8086.state import LONGEST, MEMORY_BYTES, REGISTERS, SEGMENTS
from tests.hil.i8086.processor import refuse

VARIABLE = "HIL_8086_CAPTURES"
BESIDE = Path(__file__).parents[3].parent / "shared" / "captures-8086"
PORTS = {"E4", "E5", "E6", "E7"}
"""Forms that no capture can have: what a port answers is not the processor's."""

Capture = dict[str, Any]


def captures() -> dict[str, dict[str, Any]]:
    """Return flags_mask and tests by form; skip the calling test where there are none."""
    path = Path(os.environ.get(VARIABLE, BESIDE)) / "captures.json.gz"
    if not path.exists():
        pytest.skip(f"NOT CHECKED AGAINST SILICON: no captures of an 8086 at {path}: name their folder in {VARIABLE}")
    with gzip.open(path) as packed:
        found: dict[str, dict[str, Any]] = json.load(packed)
    return found


def decoded(capture: Capture) -> Decoded | None:
    """Return its instruction, or None where the interpreter does not know the form."""
    try:
        return decode(bytes(capture["bytes"]).ljust(LONGEST, b"\x90"))
    except UnknownForm:
        return None


class Replay:
    """Runs captures, one after the other, in a memory that is all zeros but for what the capture says."""

    def __init__(self) -> None:
        self.memory = bytearray(MEMORY_BYTES)

    def __call__(self, capture: Capture, flags_mask: int) -> tuple[list[str], int]:
        """Return what is not as in silicon (registers, defined flags, memory), and clocks measured - counted."""
        before, after = capture["initial"], capture["final"]
        for address, byte in before["ram"]:
            self.memory[address] = byte
        cpu = Interpreter(self.memory, refuse, refuse)
        cpu.registers = [before["regs"][name] for name in REGISTERS]
        cpu.segments = [before["regs"][name] for name in SEGMENTS]
        cpu.ip, cpu.flags = before["regs"]["ip"], before["regs"]["flags"]
        cpu.step()
        got = dict(zip((*REGISTERS, *SEGMENTS), (*cpu.registers, *cpu.segments), strict=True)) | {"ip": cpu.ip}
        expected = before["regs"] | after["regs"]
        wrong = [f"{name} {got[name]:04X} for {expected[name]:04X}" for name in got if got[name] != expected[name]]
        if (cpu.flags ^ expected["flags"]) & flags_mask:
            wrong.append(f"flags {cpu.flags:04X} for {expected['flags']:04X}")
        return wrong + self._memory(before["ram"], after["ram"]), capture["cycles"] - cpu.clocks

    def _memory(self, before: list[list[int]], after: list[list[int]]) -> list[str]:
        """Return what differs, and clear it all; a write anywhere else is left behind as a byte that is not zero."""
        expected = dict(before) | dict(after)
        wrong = [
            f"[{at:05X}] {self.memory[at]:02X} for {byte:02X}"
            for at, byte in expected.items()
            if self.memory[at] != byte
        ]
        for address in expected:
            self.memory[address] = 0
        return wrong
