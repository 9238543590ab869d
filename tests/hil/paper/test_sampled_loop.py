"""The theory of the sampled loop against a naive simulation of the same: floats, one instant after the other."""

from math import pi, sin, sqrt

import numpy as np
import pytest

from hil.paper.sampled_loop import Loop, first_order, spectral_radius

T, G, K1, K2 = 0.001, 700.0, 90.0, 2000.0
PINNED = {
    (0.0, 0.0, 0.0): 0.9681384680017152,
    (3.6e-4, 4.7e-4, 5.8e-4): 0.9681017954526564,
    (9.99e-4, 2e-4, 9e-4): 0.9694361603210335,
}
FINE = 40
"""Parts of a period that the naive model integrates, and at which the Fourier sums look."""


class Naive:
    """Joints under M q" = Jn u - torque with the paper's law in floats; u acts `late` parts after its sample, for T.

    The observer is written as in the paper's derivation, t_dis_hat filtered: d' = g (u - d) - g q", not in the closed
    sum of the theory.
    """

    def __init__(self, M, nominal, g, late, lsb=0.0):
        self.acceleration_of = np.linalg.inv(M)
        self.nominal, self.g, self.late, self.lsb = np.array(nominal), g, late, lsb
        n = len(nominal)
        self.q, self.v = np.zeros(n), np.zeros(n)
        self.seen, self.w, self.d, self.a, self.next_a = (np.zeros(n) for _ in range(5))
        self.commanded = []
        self.history = []

    def sample(self):
        q = np.floor(self.q / self.lsb) * self.lsb if self.lsb else self.q
        w = (q - self.seen) / T
        self.a, self.d = self.next_a, self.d - self.g * (w - self.w)
        u = self.a + self.d
        self.d = self.d + self.g * T * (u - self.d)
        self.next_a = -K1 * w - K2 * q
        self.seen, self.w = q.copy(), w
        return u

    def period(self, torque, t_s):
        u, dt = self.sample(), T / FINE
        self.commanded.append(np.array([u, self.a]))
        whole, rest = np.divmod(self.late, FINE)
        before, behind = self.of_cycles_ago(whole + 1), self.of_cycles_ago(whole)
        for part in range(FINE):
            acting, acting_a = np.where(part >= rest, behind, before)
            push = torque(t_s + (part + 0.5) * dt)
            acceleration = self.acceleration_of @ (self.nominal * acting - push)
            self.q = self.q + dt * self.v + 0.5 * dt * dt * acceleration
            self.v = self.v + dt * acceleration
            self.history.append((acting_a[0], acting[0], acceleration[0]))
        return u

    def of_cycles_ago(self, ago):
        """Return u and a of each joint so many cycles before the present one; 0 before the first."""
        cycles = len(self.commanded) - 1 - ago
        return np.array([self.commanded[k][:, n] if k >= 0 else (0.0, 0.0) for n, k in enumerate(cycles)]).T


@pytest.mark.parametrize("rad_s", [50.0, 300.0, 700.0, 1500.0])
@pytest.mark.parametrize("inertia", [1.0, 1.4])
def test_sensitivity_is_that_of_the_simulated_loop_whatever_the_inertia(rad_s, inertia):
    """To 0.1 dB: FINE parts a period round a sine of 1500 rad/s by 0.03 dB, and the window leaks a little."""
    late = 24
    periods = max(2, round(rad_s * 0.6 / (2 * pi)))
    window = round(2 * pi * periods / (rad_s * T))
    rad_s = 2 * pi * periods / (window * T)
    naive = Naive(np.array([[inertia]]), [1.0], G, np.array([late]))
    for k in range(400 + window):
        naive.period(lambda t: np.array([sin(rad_s * t)]), k * T)
    t = (np.arange(window * FINE) + 0.5) * T / FINE
    a, u, q = np.exp(-1j * rad_s * t) @ np.array(naive.history[400 * FINE :])
    measured = abs((a - q) / (u - q))
    theory = abs(Loop(G, K1, K2, T, late / FINE * T).sensitivity(np.array([rad_s]))[0])
    assert 20 * np.log10(measured / theory) == pytest.approx(0.0, abs=0.1)


def test_without_delay_and_for_a_short_period_the_loop_is_the_continuous_observer():
    rad_s = np.geomspace(1.0, 1e4, 50)
    loop = Loop(G, 0.0, 0.0, 1e-7, 0.0)
    np.testing.assert_allclose(np.abs(loop.sensitivity(rad_s)), np.abs(first_order(G, rad_s)), rtol=1e-3)


M3 = np.array([[2.1, 0.5, 0.06], [0.5, 0.75, 0.04], [0.06, 0.04, 0.085]])


@pytest.mark.parametrize(
    ("late", "factor", "g"),
    [
        *(((16, 20, 24), factor, G) for factor in (1.0, 1.3, 1.45, 1.7)),
        ((16, 39, 40), 0.7, G),
        ((16, 56, 24), 1.0, G),
        ((90, 20, 24), 1.0, G),
        ((80, 80, 80), 1.0, 300.0),
        ((63, 101, 139), 0.8, 300.0),
    ],
)
def test_spectral_radius_is_the_growth_of_the_simulated_loop(late, factor, g):
    """Of three coupled joints with delays of their own, up to 3.5 periods: the slope of the logarithm of its size."""
    late = np.array(late)
    nominal = np.array([1.344, 0.537, 0.0832 * factor])
    naive = Naive(M3, nominal, g, late)
    naive.q = np.array([1e-3, -2e-3, 1.5e-3])
    naive.seen = naive.q.copy()
    naive.v, naive.d = np.array([0.3, 0.2, -0.5]), np.array([5.0, -7.0, 3.0])
    size = []
    for _ in range(2000):
        naive.period(lambda _t: np.zeros(3), 0.0)
        size.append(np.linalg.norm(np.concatenate([naive.q * 1000, naive.v, naive.d / 1000])))
    # over whole swings of what is left: the envelope of the maxima of 100 cycles
    envelope = np.log(np.max(np.array(size[1000:]).reshape(10, 100), axis=1))
    growth = np.polyfit(np.arange(10) * 100, envelope, 1)[0]
    radius = spectral_radius(M3, nominal.tolist(), g, (K1, K2), T, late / FINE * T)
    assert np.exp(growth) == pytest.approx(radius, abs=2e-3)


@pytest.mark.parametrize("periods", [1, 2, 3])
def test_spectral_radius_does_not_jump_where_a_delay_is_a_whole_number_of_periods(periods):
    """It changes by some 0.1 a period of delay: by 1e-7 from 1 ns before to 1 ns behind."""
    delay_s = [np.array([5e-4, 1.3e-3, periods * T + way * 1e-9]) for way in (-1, 0, 1)]
    before, there, behind = (spectral_radius(M3, (1.3, 0.5, 0.08), 300.0, (K1, K2), T, each) for each in delay_s)
    assert before == pytest.approx(there, abs=1e-6)
    assert behind == pytest.approx(there, abs=1e-6)
    assert before != behind


def test_spectral_radius_of_short_delays_is_what_it_was_before_longer_ones_were_allowed():
    """Figures of the paper's arm, from the version without them."""
    for delay_s, radius in PINNED.items():
        assert spectral_radius(M3, (1.344, 0.537, 0.0832), G, (K1, K2), T, np.array(delay_s)) == pytest.approx(
            radius, abs=1e-12
        )


@pytest.mark.parametrize(("g", "felt"), [(200.0, 1.0), (700.0, 1.0), (700.0, 0.8)])
def test_noise_of_the_encoder_reaches_the_reference_as_in_the_simulated_loop(g, felt):
    """Rounding of a joint that moves by several counts a sample: variance LSB^2 / 12 through the loop, within 6 %."""
    late, lsb, cycles = 20, 1e-5, 6000
    naive = Naive(np.array([[1.0 / felt]]), [1.0], g, np.array([late]), lsb)
    # a torque that swings the joint over hundreds of counts
    u = np.array([naive.period(lambda t: np.array([40.0 * sin(20.0 * t)]), k * T)[0] for k in range(cycles)])[1000:]
    high = u[1:-1] - (u[:-2] + u[2:]) / 2  # what no motion of 20 rad/s has
    angles = (np.arange(2048) + 0.5) * pi / 2048
    gain = np.abs(Loop(g, K1, K2, T, late / FINE * T).noise_to_reference(angles, felt) * (1 - np.cos(angles)))
    assert np.std(high) == pytest.approx(lsb / sqrt(12) * np.sqrt(np.mean(gain**2)), rel=0.06)
