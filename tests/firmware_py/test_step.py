"""The control step against the five lines of the design in numpy's integers, and against the physics it stands for."""

from dataclasses import dataclass
from math import pi

import numpy as np
import pytest

from firmware_py.joint_cpu import CURRENT, ERROR, KB_DW, SIGNALS, D, W, make_step
from firmware_py.words import InstrumentedWords, Words
from hil.constants import parameter_table
from hil.scenario_file import load

T_S = 1e-3
G = 700.0
COUNTS_PER_TURN = 819_200
RAD = 2 * pi / COUNTS_PER_TURN
JN = (1.344, 0.537, 0.0832)
KTN = (10.0, 6.0, 2.0)
AMPERE = 1 / 2048
RAD_S2 = 1 / 128

I16, I32 = np.iinfo(np.int16), np.iinfo(np.int32)
ROWS = 120_000


# -- the five lines, in numpy --


def nearest(x, count):
    """Round to the nearest, halves up: what SAR and one ADC of the carry give."""
    return (x + (1 << count >> 1)) >> count


def sat16(x):
    return np.clip(x, I16.min, I16.max)


def sat32(x):
    return np.clip(x, I32.min, I32.max)


def wrap16(x):
    return x.astype(np.int16).astype(np.int64)


def limited(x, bound):
    return np.clip(x, -bound, bound)


@dataclass(frozen=True)
class Naive:
    """One field for everything that a wrong step could do otherwise."""

    wrap_w: object = wrap16
    wrap_dw: object = wrap16
    sat_kb: object = sat16
    sat_d1: object = sat32
    sat_d2: object = sat32
    sat_error: object = sat16
    limit: object = limited
    shift_kj: object = nearest
    high: object = lambda d: d >> 16
    last_shift: int = 1
    observe_first: bool = True
    limited_into_d: bool = True

    def __call__(self, rows):
        count, count_prev, w_prev, d, a_ref, ka, kb, kj, s, bound = (column.astype(np.int64) for column in rows)
        w = self.wrap_w(count - count_prev)
        dw = self.wrap_dw(w - w_prev)
        pull = self.sat_kb(kb * dw) << 16
        if self.observe_first:
            d = self.sat_d1(d - pull)
        estimate = self.high(d)
        i_free = self.shift_kj(kj * a_ref, s) + estimate
        i = self.limit(i_free, bound)
        error = self.sat_error((i if self.limited_into_d else i_free) - estimate)
        d = self.sat_d2(d + (ka * error << self.last_shift))
        if not self.observe_first:
            d = self.sat_d1(d - pull)
        return w, d, i, estimate


def toward_zero(x, count):
    return np.sign(x) * (np.abs(x) >> count)


MUTATIONS = {
    "KJ shift toward zero": {"shift_kj": toward_zero},
    "KJ shift floors": {"shift_kj": lambda x, count: x >> count},
    "high word toward zero": {"high": lambda d: toward_zero(d, 16)},
    "high word to nearest": {"high": lambda d: nearest(d, 16)},
    "no limit": {"limit": lambda x, _: sat16(x)},
    "limit one count wider": {"limit": lambda x, bound: limited(x, bound + 1)},
    "the two updates of d swapped": {"observe_first": False},
    "no << 1": {"last_shift": 0},
    "KB dw wraps": {"sat_kb": wrap16},
    "i - d wraps": {"sat_error": wrap16},
    "i before the limit goes into d": {"limited_into_d": False},
    "d wraps after the first update": {"sat_d1": lambda x: x.astype(np.int32).astype(np.int64)},
    "w saturates": {"wrap_w": sat16},
    "dw saturates": {"wrap_dw": sat16},
}


def make_rows(tables):
    """Columns of arguments: random over the whole range, near the edges, and as in a run."""
    rng = np.random.default_rng(20250101)

    def word(low=I16.min):
        edges = np.array([I16.min, I16.min + 1, -2, -1, 0, 1, 2, I16.max - 1, I16.max])
        kinds = rng.integers(0, 4, ROWS)
        plain, small, edge = (
            rng.integers(I16.min, I16.max + 1, ROWS),
            rng.integers(-40, 41, ROWS),
            rng.choice(edges, ROWS),
        )
        return np.maximum(np.choose(kinds, [plain, plain, small, edge]), low)

    count = word() & 0xFFFF
    near = rng.random(ROWS) < 0.5
    count_prev = np.where(near, (count + rng.integers(-300, 301, ROWS)) & 0xFFFF, word() & 0xFFFF)
    w = (count - count_prev).astype(np.int16).astype(np.int64)
    w_prev = np.where(rng.random(ROWS) < 0.5, (w + rng.integers(-80, 81, ROWS)).astype(np.int16), word())
    # bridge() may leave count_prev outside of the counter, by one word at most
    count_prev = count_prev + rng.choice([-0x10000, 0, 0, 0], ROWS)
    d = (word() << 16) + (word() & 0xFFFF)
    of_a_run = np.array(tables)[rng.integers(0, 3, ROWS)].T
    constants = np.stack([word(0), word(0), word(0), rng.integers(0, 16, ROWS), word(1)])
    ka, kb, kj, s, bound = np.where(rng.random(ROWS) < 0.6, of_a_run, constants)
    return count, count_prev, w_prev, d, word(), ka, kb, kj, s, bound


@pytest.fixture(scope="module")
def rows(tables):
    return make_rows(tables)


@pytest.fixture(scope="module")
def truth(rows):
    return np.stack(Naive()(rows))


@pytest.fixture(scope="module")
def stepped(rows):
    """The step's results, row by row, and its words."""
    words = Words(16, len(SIGNALS))
    step = make_step(Words)
    return np.array([step(words, *row) for row in np.stack(rows).T.tolist()]).T, words


def test_equals_the_five_lines(rows, truth, stepped):
    results, _ = stepped
    wrong = np.flatnonzero((results != truth).any(axis=0))
    assert wrong.size == 0, f"step{tuple(int(c[wrong[0]]) for c in rows)} is not {truth[:, wrong[0]].tolist()}"


def test_rows_reach_every_saturation(rows, stepped):
    _, words = stepped
    for signal in (KB_DW, D, CURRENT, ERROR):
        assert words.saturations[signal] > ROWS // 1000, SIGNALS[signal]
    assert words.saturations[W] == 0
    assert len(rows[0]) >= 100_000


@pytest.mark.parametrize("name", MUTATIONS)
def test_rows_detect(name, rows, truth):
    mutant = np.stack(Naive(**MUTATIONS[name])(rows))
    assert (mutant != truth).any()


def test_second_update_never_leaves_the_double(rows, truth):
    """KA < 1 moves d towards i, never past it: no saturation can be needed there."""
    unsaturated = np.stack(Naive(sat_d2=lambda x: x)(rows))
    assert (unsaturated == truth).all()


def test_results_stay_in_their_words(stepped):
    (w, d, i, estimate), _ = stepped
    for word in (w, i, estimate):
        assert I16.min <= word.min() <= word.max() <= I16.max
    assert I32.min <= d.min() <= d.max() <= I32.max


def test_instrumented_step_is_the_same_and_costs_3_and_6_on_every_branch(rows, truth):
    words = InstrumentedWords(16, len(SIGNALS))
    step = make_step(InstrumentedWords)
    branches = set()
    for index, row in enumerate(np.stack(rows).T[::10].tolist()):
        words.multiplications = words.additions = 0
        before = list(words.saturations)
        result = step(words, *row)
        assert (words.multiplications, words.additions) == (3, 6), row
        assert list(result) == truth[:, 10 * index].tolist()
        branches.add(tuple(now > then for now, then in zip(words.saturations, before, strict=True)))
    assert len(branches) >= 10  # of 16: KB dw, d, i and i - d, each saturated or not


@pytest.mark.parametrize(
    ("signal", "arguments"),
    [
        (None, (100, 0, 90, 0, 50, 22938, 1478, 17616, 13, 16384)),
        (KB_DW, (100, 0, 0, 0, 50, 22938, 1478, 17616, 13, 16384)),
        (D, (0, 20, 0, 0x7FFF0000, 50, 22938, 1478, 17616, 13, 16384)),
        (CURRENT, (0, 0, 0, 0, 32767, 22938, 1478, 17616, 13, 16384)),
        (ERROR, (0, 0, 0, -0x7FFF0000, 32767, 22938, 1478, 17616, 13, 16384)),
        (None, (0, 0, 0, 0, 0, 0, 0, 1, 0, 1)),
    ],
)
def test_operations_of_each_branch(signal, arguments):
    words = InstrumentedWords(16, len(SIGNALS))
    make_step(InstrumentedWords)(words, *arguments)
    assert (words.multiplications, words.additions) == (3, 6)
    assert (sum(words.saturations) == 0) if signal is None else words.saturations[signal] == 1


@pytest.mark.parametrize("bits", [12, 24, 32])
def test_other_word_lengths_follow_the_same_lines(bits):
    """Against the lines in unbounded ints, scaled to the word length; the bus has 16 bits for what it shows."""
    rng = np.random.default_rng(bits)
    words = Words(bits, len(SIGNALS))
    step = make_step(Words)
    top = 1 << (bits - 1)

    def clip(x, n):
        return max(-(1 << (n - 1)), min((1 << (n - 1)) - 1, x))

    for _ in range(2000):
        count, count_prev, w_prev, d_high, a_ref = (int(x) for x in rng.integers(-top, top, 5))
        ka, kb, kj, bound = (int(x) for x in rng.integers(1, top, 4))
        d, s = (d_high << bits) + int(rng.integers(0, 2 * top)), bits - 3
        w = (count - count_prev + top) % (2 * top) - top
        dw = (w - w_prev + top) % (2 * top) - top
        d1 = clip(d - (clip(kb * dw, bits) << bits), 2 * bits)
        i = max(-bound, min(bound, (kj * a_ref + (1 << s >> 1) >> s) + (d1 >> bits)))
        d2 = clip(d1 + (ka * clip(i - (d1 >> bits), bits) << 1), 2 * bits)
        assert step(words, count, count_prev, w_prev, d, a_ref, ka, kb, kj, s, bound) == (
            w,
            d2,
            clip(i, 16),
            clip(d1 >> bits, 16),
        )


# -- constants --


def test_constants_of_the_papers_arm(tables):
    assert [table[0] for table in tables] == [22938] * 3
    assert [table[1] for table in tables] == [1478, 984, 457]
    assert [table[3] for table in tables] == [13, 14, 15]
    assert [table[4] for table in tables] == [16384] * 3  # 8 A


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_constants_are_the_designs_formulas_rounded(tables, joint):
    Jn, Ktn = JN[joint], KTN[joint]
    ka, kb, kj, s, _ = tables[joint]
    assert abs(ka - G * T_S * 2**15) <= 0.5
    assert abs(kb - G * Jn / Ktn * 2048 * RAD / T_S) <= 0.5
    assert abs(kj - Jn / Ktn * 2048 / 128 * 2**s) <= 0.5
    assert 2**14 <= kj < 2**15  # as fine as a word allows


# -- the physics --


def rigid_run(table, joint, reference, cycles, disturbance_Nm=0.0, rad=None):
    """Run the word step on J q" = Kt i - disturbance, i acting for the whole period; return (estimates, speeds).

    rad: one encoder count, the paper's if not said.
    """
    words, step = Words(16, len(SIGNALS)), make_step(Words)
    rad = RAD if rad is None else rad
    q, speed = 0.5 * rad, 0.0
    count_prev = w_prev = d = 0
    estimates, speeds = [], []
    for _ in range(cycles):
        count = int(np.floor(q / rad)) & 0xFFFF
        w_prev, d, i, estimate = step(words, count, count_prev, w_prev, d, reference, *table)
        count_prev = count
        estimates.append(estimate)
        speeds.append(speed)
        acceleration = (KTN[joint] * i * AMPERE - disturbance_Nm) / JN[joint]
        q += speed * T_S + acceleration * T_S**2 / 2
        speed += acceleration * T_S
    return np.array(estimates), np.array(speeds)


@pytest.mark.parametrize("joint", [0, 1, 2])
@pytest.mark.parametrize("reference", [-700, -128, -37, -1, 0, 1, 64, 300, 700])
def test_rigid_joint_follows_the_reference_without_bias(tables, joint, reference):
    """Mean over 2 s: the estimate within 2 counts of 0, the acceleration within 1 count of the reference.

    At joint 3 a count of acceleration is only 0.67 counts of current: a floor of KJ a_ref would cost up to 1.5, so the
    shift rounds, which costs 0.75 at most. The mean is taken from the speed at both ends: an encoder count a period.
    """
    cycles = 2000
    estimates, speeds = rigid_run(tables[joint], joint, reference, cycles + 21)
    acceleration = (speeds[-1] - speeds[20]) / (cycles * T_S) / RAD_S2
    assert abs(estimates[20:].mean()) <= 2
    assert abs(acceleration - reference) <= 1


@pytest.mark.parametrize("joint", [0, 1, 2])
@pytest.mark.parametrize("reference", [-6400, -3000, 1500, 5000])
def test_rigid_joint_at_large_references_is_off_by_the_rounding_of_the_constants_only(tables, joint, reference):
    """Where the observer rests, KA (i - d) = KB dw: the acceleration is (KJ a_ref) KA / KB in the constants' units."""
    ka, kb, kj, s, _ = tables[joint]
    estimates, speeds = rigid_run(tables[joint], joint, reference, 521)
    acceleration = (speeds[-1] - speeds[20]) / (500 * T_S)
    expected = (kj * reference / 2**s) * (ka / 2**15) / kb * RAD / T_S**2
    inexact = RAD / (0.5 * T_S) / 0.5  # the encoder's floor at both ends of 0.5 s
    assert abs(acceleration - expected) <= RAD_S2 + inexact
    assert abs(expected / (reference * RAD_S2) - 1) < 0.5 / kb + 0.5 / ka + 0.5 / kj
    # J a = Kt i and i = KJ a_ref + d in the mean: what is missing is the estimate
    assert abs(estimates[20:].mean() - (expected / (reference * RAD_S2) - 1) * kj * reference / 2**s) <= 3


class FloatStep:
    """The five lines in floats, units A and rad, the speed not quantised."""

    def __init__(self, joint, g=G):
        self.ka, self.kj = g * T_S, JN[joint] / KTN[joint]
        self.kb = g * self.kj / T_S
        self.q_prev = self.w_prev = self.d = 0.0

    def __call__(self, q, a_ref):
        w = q - self.q_prev
        dw = w - self.w_prev
        self.q_prev, self.w_prev = q, w
        self.d -= self.kb * dw
        estimate = self.d
        i = self.kj * a_ref + estimate
        self.d += self.ka * (i - estimate)
        return i, estimate


def float_run(joint, a_ref, cycles, disturbance_A=0.0):
    """Return (estimates, accelerations) of the float twin."""
    step = FloatStep(joint)
    q = speed = 0.0
    estimates, accelerations = [], []
    for _ in range(cycles):
        i, estimate = step(q, a_ref)
        acceleration = (i - disturbance_A) * KTN[joint] / JN[joint]
        q += speed * T_S + acceleration * T_S**2 / 2
        speed += acceleration * T_S
        estimates.append(estimate)
        accelerations.append(acceleration)
    return np.array(estimates), np.array(accelerations)


@pytest.mark.parametrize("joint", [0, 1, 2])
@pytest.mark.parametrize("a_ref", [-40.0, -3.0, 0.0, 0.5, 25.0])
def test_float_twin_is_unbiased_after_the_transient(joint, a_ref):
    """Rounding: q of some rad in float64 differenced twice over T^2 leaves 1e-16 / 1e-6 rad/s^2, here times ten."""
    estimates, accelerations = float_run(joint, a_ref, 400)
    tolerance = 1e-8 * max(1.0, abs(a_ref))
    assert np.abs(accelerations[100:] - a_ref).max() < tolerance
    assert np.abs(estimates[100:]).max() < tolerance


def closed_form(disturbance, cycles):
    """Return the estimate of cycle k by d' = g (i - d) - KB w', the joint at rest before, reference 0.

    In units of current the rigid joint has a = d - t, and one period's difference of speed, from positions, is
    T^2 (a_k-1 + a_k-2) / 2. So e = d - t obeys e_k = e_k-1 - gT (e_k-1 + e_k-2) / 2 with e_0 = -t, e_-1 = 0: powers of
    its two poles z, sum of e = e_0 / gT.
    """
    z1, z2 = np.roots([1.0, -(1 - G * T_S / 2), G * T_S / 2])
    k = np.arange(cycles)
    return disturbance * (1.0 - ((z1 ** (k + 1) - z2 ** (k + 1)) / (z1 - z2)).real)


@pytest.mark.parametrize("joint", [0, 1, 2])
@pytest.mark.parametrize("disturbance_A", [-1.5, 0.25, 2.0])
def test_float_twin_finds_a_step_disturbance_as_the_closed_form_says(joint, disturbance_A):
    estimates, _ = float_run(joint, 0.0, 60, disturbance_A)
    expected = closed_form(disturbance_A, 60)
    assert np.abs(estimates - expected).max() < 1e-9
    assert abs(estimates[-1] - disturbance_A) < 1e-9


@pytest.mark.parametrize("joint", [0, 1, 2])
@pytest.mark.parametrize("disturbance_A", [-1.5, 0.25, 2.0])
def test_word_step_finds_a_step_disturbance_with_time_constant_1_over_g(codec, joint, disturbance_A):
    """An encoder 64 times finer, so that its noise (KB, one count) does not hide the response.

    Tolerance: three counts of the encoder, and the rounding of KB, which is up to half a count of 7 there.
    """
    finer = load("paper-joint", [f"encoder.counts_per_turn={64 * COUNTS_PER_TURN}"])
    table = parameter_table(finer, joint + 1, codec)
    counts, kb = disturbance_A / AMPERE, table[1]
    exact_kb = G * JN[joint] / KTN[joint] / AMPERE * RAD / 64 / T_S
    tolerance = 3 * kb + abs(kb / exact_kb - 1) * abs(counts)
    estimates, _ = rigid_run(table, joint, 0, 40, disturbance_A * KTN[joint], rad=RAD / 64)
    assert np.abs(estimates - closed_form(counts, 40)).max() < tolerance
    time_constant_s = T_S * (1 - estimates / counts).sum()
    assert time_constant_s == pytest.approx(1 / G, rel=abs(kb / exact_kb - 1) + 2 * kb * G * T_S / abs(counts))


@pytest.mark.parametrize("joint", [0, 1, 2])
@pytest.mark.parametrize("disturbance_A", [-1.5, 0.25, 2.0])
def test_word_step_holds_a_constant_disturbance(tables, joint, disturbance_A):
    estimates, _ = rigid_run(tables[joint], joint, 0, 2050, disturbance_A * KTN[joint])
    assert abs(estimates[50:].mean() - disturbance_A / AMPERE) <= 2
