"""Short sweeps of one joint, and an executor that makes up rows at once."""

import hashlib
from concurrent.futures import Executor, Future
from contextlib import contextmanager

import pytest

from hil.sweep.crew import Crew

HEAD = """
scenario = "one-joint"
seed = {seed}
[set]
duration_s = 0.02
trajectory.time_s = 0.02
trajectory.by_rad = [0.001]
clock.setup_cycles = 40
"""
SWEEPS = """
[[sweep]]
name = "g"
method = "grid"
[sweep.vary]
joint.g_rad_s = [100, 700, 1200]
"joint.inertia_kg_m2 *" = [0.9, 1.0]
[[sweep]]
name = "drawn"
method = "monte-carlo"
samples = {samples}
[sweep.vary]
"encoder.counts_per_turn" = {{ from = 200000, to = 800000, log = true }}
"joint.observer" = [true, false]
"""


@pytest.fixture
def write(tmp_path):
    """Write a sweep file of two sweeps, 6 points and these samples; return its path."""

    def file(samples=6, seed=1, text=SWEEPS, name="sweep.toml"):
        path = tmp_path / name
        path.write_text(HEAD.format(seed=seed) + text.format(samples=samples))
        return str(path)

    return file


class AtOnce(Executor):
    """Makes rows of what is submitted at once, without any run, and counts them."""

    def __init__(self):
        self.points = 0

    def submit(self, _function, _base, chunk):
        future = Future()
        self.points += len(chunk)
        future.set_result([made_up(point) for point in chunk])
        return future


def made_up(point):
    """A row whose figures are a hash of the point's values."""
    key = {"sweep": point.sweep, "index": point.index}
    if point.values.get("joint.g_rad_s") == 1200:
        return key | {"status": "refused", "reason": "KA must be below 1"}
    digest = hashlib.sha256(repr(point.values).encode()).digest()
    return key | {"status": "ok", "reason": "", "saturations_d": digest[0], "max_tip_deviation_m": digest[1] / 256}


@pytest.fixture
def at_once():
    """An executor, as a crew."""
    executor = AtOnce()

    @contextmanager
    def crew():
        yield Crew(executor, 1, lambda: None)

    crew.executor = executor
    return crew
