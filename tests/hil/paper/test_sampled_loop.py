"""The theory of the sampled loop against a naive simulation of the same: floats, one instant after the other."""

from math import pi, sin, sqrt

import numpy as np
import pytest

from hil.paper.sampled_loop import Loop, first_order, spectral_radius

T, G, K1, K2 = 0.001, 700.0, 90.0, 2000.0
FINE = 40
"""Parts of a period that the naive model integrates, and at which the Fourier sums look."""


class Naive:
    """Joints under M q" = Jn u - torque with the paper's law in floats; u acts `late` parts after its sample.

    The observer is written as in the paper's derivation, t_dis_hat filtered: d' = g (u - d) - g q", not in the closed
    sum of the theory.
    """

    def __init__(self, M, nominal, g, late, lsb=0.0):
        self.acceleration_of = np.linalg.inv(M)
        self.nominal, self.g, self.late, self.lsb = np.array(nominal), g, late, lsb
        n = len(nominal)
        self.q, self.v, self.acting = np.zeros(n), np.zeros(n), np.zeros(n)
        self.seen, self.w, self.d, self.a, self.next_a, self.acting_a = (np.zeros(n) for _ in range(6))
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
        for part in range(FINE):
            acts = part >= self.late
            self.acting, self.acting_a = np.where(acts, u, self.acting), np.where(acts, self.a, self.acting_a)
            push = torque(t_s + (part + 0.5) * dt)
            acceleration = self.acceleration_of @ (self.nominal * self.acting - push)
            self.q = self.q + dt * self.v + 0.5 * dt * dt * acceleration
            self.v = self.v + dt * acceleration
            self.history.append((self.acting_a[0], self.acting[0], acceleration[0]))
        return u


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


@pytest.mark.parametrize("factor", [1.0, 1.3, 1.45, 1.7])
def test_spectral_radius_is_the_growth_of_the_simulated_loop(factor):
    """Of three coupled joints with delays of their own: the slope of the logarithm over the last 1000 cycles."""
    late = np.array([16, 20, 24])
    nominal = np.array([1.344, 0.537, 0.0832 * factor])
    naive = Naive(M3, nominal, G, late)
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
    radius = spectral_radius(M3, nominal.tolist(), G, (K1, K2), T, late / FINE * T)
    assert np.exp(growth) == pytest.approx(radius, abs=2e-3)


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
