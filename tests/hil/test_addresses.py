"""What programs inherit that are started at fixed addresses."""

import subprocess
import sys
from pathlib import Path

import pytest

from hil.addresses import ADDR_NO_RANDOMIZE, ASK, _personality, fixed_addresses

PERSONA = Path("/proc/self/personality")
ASK_A_CHILD = [sys.executable, "-c", f"print(open('{PERSONA}').read())"]


def persona_of_a_child() -> int:
    return int(subprocess.run(ASK_A_CHILD, check=True, capture_output=True, text=True).stdout, 16)


@pytest.mark.skipif(not PERSONA.exists(), reason="no personalities here")
def test_programs_started_meanwhile_are_at_fixed_addresses_and_later_ones_as_before() -> None:
    before = _personality(ASK)
    with fixed_addresses():
        forbidden = _personality(ASK) == before & ~ADDR_NO_RANDOMIZE
        assert forbidden or persona_of_a_child() == before | ADDR_NO_RANDOMIZE
    assert persona_of_a_child() == before


def test_where_there_is_no_such_switch_nothing_happens(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    with fixed_addresses():
        assert _personality(ASK) == -1


@pytest.mark.skipif(not PERSONA.exists(), reason="no personalities here")
def test_a_program_starts_again_at_fixed_addresses_once_and_as_the_same_process() -> None:
    program = (
        "import os, sys; from hil.addresses import *; print(os.getpid(), sys.argv, flush=True); "
        "restart_at_fixed_addresses(); print('goes on')"
    )
    said = subprocess.run(
        [sys.executable, "-c", program, "a word"], check=True, capture_output=True, text=True
    ).stdout.splitlines()
    with fixed_addresses():
        forbidden = not _personality(ASK) & ADDR_NO_RANDOMIZE
    assert said == [said[0]] * (1 if forbidden else 2) + ["goes on"]
