"""The predicted dead band against a naive joint: its law in floats, one rounding on at a time, and all of them."""

from fractions import Fraction
from math import ceil, floor, pi, sin

import pytest

from dbc.compiler import load_arm
from hil import scenario_file
from hil.constants import action_delays_ns, parameter_table
from hil.engine.functional_run import functional
from hil.errors import ScenarioError
from hil.quantise.dead_band import dead_band

CODEC = load_arm()
BUS_CURRENT, BUS_ACCELERATION = 1 / 2048, 1 / 128
"""A and rad/s^2 a count, ARCHITECTURE.md."""


def to_zero(x):
    return floor(x) if x >= 0 else ceil(x)


def halves_up(x):
    return floor(x + Fraction(1, 2))


ROUND = {"floor": floor, "nearest": halves_up, "convergent": round, "toward-zero": to_zero}


class Joint:
    """One joint with roundings by choice: rad, rad/s^2, A. on: names of the resolutions that are there."""

    def __init__(self, scenario, number, on):
        word, settings = scenario.joint.word, scenario.joint
        self.on, self.word = on, word
        self.g, self.k1, self.k2 = settings.g_rad_s, scenario.dsp.k1_1_s, scenario.dsp.k2_1_s2
        self.T = scenario.clock.period_s
        self.inertia = settings.inertia_kg_m2[number - 1] / settings.torque_constant_N_m_A[number - 1]
        self.count = 2 * pi / scenario.encoder.counts_per_turn
        self.current = 2.0 ** -(word.bits - 5 if word.current_fraction is None else word.current_fraction)
        acceleration = 2.0 ** -(word.bits - 9 if word.acceleration_fraction is None else word.acceleration_fraction)
        self.reference = max(BUS_ACCELERATION, acceleration)
        self.d_count = self.current * 2.0 ** -(word.bits if word.d_fraction is None else word.d_fraction)

    def rounded(self, what, x, count, how):
        return ROUND[how](x / count) * count if what in self.on else x

    def seen(self, q):
        return self.rounded("encoder", q, self.count, "floor")

    def feed(self, error, speed=0.0):
        asked = self.rounded("reference", -self.k1 * speed - self.k2 * error, self.reference, "nearest")
        return self.rounded("current", asked * self.inertia, self.current, self.word.round_reference)

    def step_of_d(self, x):
        return self.rounded("d", x, self.d_count, self.word.round_d)


def silent_width(joint, reach, points=4001):
    """Width of the angles that leave d as it is, and the grid's step."""
    step = 2 * reach / (points - 1)
    angles = (-reach + k * step for k in range(points))
    silent = [q for q in angles if joint.step_of_d(joint.g * joint.T * joint.feed(joint.seen(q))) == 0]
    return max(silent) - min(silent) + step, step


@pytest.mark.parametrize("name", ["encoder", "reference", "current", "d"])
@pytest.mark.parametrize("rounding", ["floor", "nearest", "convergent", "toward-zero"])
@pytest.mark.parametrize("number", [1, 3])
def test_each_resolution_alone_leaves_what_it_leaves_in_a_naive_joint(name, rounding, number):
    settings = (
        f"joint.word.round_d={rounding}",
        f"joint.word.round_reference={rounding}",
        "joint.word.d_fraction=3",
        "joint.word.acceleration_fraction=5",
    )
    scenario = scenario_file.load("paper-joint", settings)
    predicted = dead_band(scenario, number, CODEC).alone[name]
    width, step = silent_width(Joint(scenario, number, {name}), 1.1 * predicted)
    assert width == pytest.approx(predicted, abs=2 * step)


def exact_chain(scenario, number, counts):
    """What d takes for an error of whole encoder counts, every rounding in fractions; the DSP's argument is a float."""
    word = scenario.joint.word
    ka, _, kj, shift, _ = parameter_table(scenario, number, CODEC)
    asked = round(-scenario.dsp.k2_1_s2 * counts * 2 * pi / scenario.encoder.counts_per_turn / BUS_ACCELERATION)
    own = 7 if word.acceleration_fraction is None else word.acceleration_fraction
    asked = halves_up(Fraction(asked) * Fraction(2) ** (own - 7))
    feed = ROUND[word.round_reference](Fraction(kj * asked, 2**shift))
    d_fraction = 16 if word.d_fraction is None else word.d_fraction
    return ROUND[word.round_d](Fraction(ka * feed, 2**15) * 2**d_fraction)


@pytest.mark.parametrize(
    "settings",
    [
        (),
        ("joint.word.d_fraction=0",),
        ("joint.word.d_fraction=0", "joint.word.round_d=convergent", "joint.word.current_fraction=8"),
        ("joint.word.current_fraction=7",),
        ("joint.word.current_fraction=7", "joint.word.round_reference=floor"),
        ("joint.word.current_fraction=7", "joint.word.round_reference=toward-zero", "joint.g_rad_s=20"),
        ("encoder.counts_per_turn=26214400", "joint.word.kb_fraction=4", "joint.word.acceleration_fraction=6"),
        ("encoder.counts_per_turn=26214400", "joint.word.kb_fraction=4", "joint.word.d_fraction=0"),
        ("encoder.counts_per_turn=26214400", "joint.word.kb_fraction=4", "joint.g_rad_s=20", "joint.word.d_fraction=0"),
    ],
)
def test_the_edges_are_the_first_counts_that_move_d(settings):
    scenario = scenario_file.load("paper-joint", settings)
    count = 2 * pi / scenario.encoder.counts_per_turn
    for number in (1, 2, 3):
        found = dead_band(scenario, number, CODEC)
        below, above = round(-found.low / count), round(found.high / count) - 1
        assert all(exact_chain(scenario, number, n) == 0 for n in range(-below, above + 1))
        assert exact_chain(scenario, number, -below - 1) != 0
        assert exact_chain(scenario, number, above + 1) != 0


def pushed_range(joint, push, delay_s, seconds=3.0):
    """Range of a rigid joint's angle in its last two thirds, under a slow torque (in A) of one period in these.

    Its current acts delay_s behind the sample: motion under constant acceleration is exact.
    """
    T, q, w, d, before, speed_before, i = joint.T, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    seen = []
    for k in range(round(seconds / T)):
        pushed = push * sin(2 * pi * k * T / (seconds * 2 / 3))
        error = joint.seen(q)
        speed = (error - before) / T
        d -= joint.g * joint.inertia * (speed - speed_before)
        feed = joint.feed(error, speed)
        given = feed + joint.rounded("current", d, joint.current, "floor")
        d += joint.step_of_d(joint.g * T * feed)
        before, speed_before = error, speed
        for span_s, acting in ((delay_s, i), (T - delay_s, given)):
            a = (acting + pushed) / joint.inertia
            q, w = q + w * span_s + a * span_s**2 / 2, w + a * span_s
        i = given
        if k * T > seconds / 3:
            seen.append(q)
    return max(seen) - min(seen)


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("encoder", ()),
        ("reference", ()),
        ("current", ("joint.word.current_fraction=9",)),
        ("d", ("joint.g_rad_s=50", "joint.word.d_fraction=0")),
        ("d", ("joint.g_rad_s=50", "joint.word.d_fraction=2")),
    ],
)
@pytest.mark.parametrize("number", [1, 3])
def test_a_naive_joint_with_one_resolution_rests_within_a_factor_of_2(name, settings, number):
    """The torque is 2 g K1 Jn times the band, as in hil.quantise.rest, and as slow; no encoder, no limit cycle."""
    scenario = scenario_file.load("paper-joint", settings)
    band = dead_band(scenario, number, CODEC)
    joint = Joint(scenario, number, {name})
    predicted = band.alone[name] + (band.cycle if name == "encoder" else 0.0)
    delay_s = action_delays_ns(functional(scenario))[number - 1] * 1e-9
    push = 2 * joint.g * joint.k1 * joint.inertia * band.alone[name]
    assert 0.5 <= pushed_range(joint, push, delay_s) / predicted <= 2.0


def test_bits_of_d_halve_its_band_until_another_is_wider():
    wide = [dead_band(at_g_20(bits), 3, CODEC) for bits in range(17)]
    widths = [band.alone["d"] for band in wide]
    assert widths == pytest.approx([widths[0] / 2**bits for bits in range(17)])
    assert [band.dominant for band in wide] == ["d"] * 6 + ["encoder"] * 11


def at_g_20(bits):
    return scenario_file.load("paper-joint", ("joint.g_rad_s=20", f"joint.word.d_fraction={bits}"))


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (("joint.observer=false",), "joint.observer = false"),
        (("dsp.k2_1_s2=0",), "dsp.k2_1_s2 = 0"),
        (
            ("joint.word.acceleration_fraction=-10", "joint.word.current_fraction=-3", "joint.word.kb_fraction=14"),
            "joint1: the largest reference of the DSP leaves d as it is",
        ),
    ],
)
def test_bands_without_an_end_are_refused(settings, said):
    scenario = scenario_file.load("paper-joint", settings)
    with pytest.raises(ScenarioError, match=said):
        dead_band(scenario, 1, CODEC)
