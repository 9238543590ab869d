"""Half a minute of the fuzzer on every run; `make fuzz` is ten minutes of it."""

import pytest

from tests.hil.fuzzer import fuzz

pytestmark = pytest.mark.usefixtures("runtime")

SECONDS = 30
GROWTH_KB = 100_000
"""What the bus may have grown: the 64 MiB that are kept for one observer that does not read, and as much again."""
DESCRIPTORS = 8
"""Strangers that the bus has not yet seen leave."""


def test_bus_stands_whatever_it_is_told():
    found = fuzz(SECONDS, seed=7)
    assert found["exit_code"] == 0, found["said"][-3000:]
    assert "Traceback" not in found["said"], found["said"][-3000:]
    assert found["crossed"] > 0
    assert sum(found["done"].values()) > 100
    before, after = found["memory_kB"]
    assert after - before < GROWTH_KB
    before, after = found["descriptors"]
    assert after - before <= DESCRIPTORS
