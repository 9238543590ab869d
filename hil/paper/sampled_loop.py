"""The sampled loop in theory: what the observer and the position controller do to one joint, bus delay included.

Written from the paper's formulas with KA = g T and KB = g Jn / Ktn, not from the firmware. With currents in units of
acceleration, u = Ktn i / Jn, and w_k = (q_k - q_k-1) / T, the step of cycle k is

    u_k = a_k + g T (a_0 + .. + a_k-1) - g w_k        a_k+1 = -K1 w_k - K2 q_k

since d starts at zero and each cycle adds g T a_k - g (w_k+1 - w_k). u_k acts from kT + delay on, for T.

Units: rad, s, rad/s. Ref: the paper's eqs. (5)-(9), (16); K. Astrom, B. Wittenmark, Computer-Controlled Systems.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class Loop:
    """g [rad/s], K1 [1/s], K2 [1/s^2], period [s], and the delay [s] from the sample to the current's action."""

    g: float
    k1: float
    k2: float
    period_s: float
    delay_s: float

    def sensitivity(self, rad_s: Array) -> Complex:
        """Return 1 - G at these frequencies: (a_ref - q") / (u - q") of this loop, which does not hang on the inertia.

        The position is sampled; a_ref and u are held for a period from their delay on.
        """
        s = 1j * rad_s
        back = np.exp(-s * self.period_s)  # z^-1
        hold = np.exp(-s * self.delay_s) * (1 - back) / (s * self.period_s)
        speed = (1 - back) / self.period_s
        reference = -back * (self.k2 + self.k1 * speed)
        u = reference * (1 + self.g * self.period_s * back / (1 - back)) - self.g * speed
        found: Complex = (hold * reference - s**2) / (hold * u - s**2)
        return found

    def noise_to_reference(self, angles: Array, felt: float) -> Complex:
        """Return from an error of the position [rad] to u [rad/s^2], at z = exp(i angle), with the loop closed.

        felt: Jn / J, how much the joint accelerates for one unit of u.
        """
        T, tau, z = self.period_s, self.delay_s, np.exp(1j * angles)
        back = 1 / z
        speed = (1 - back) / T
        reference = -back * (self.k2 + self.k1 * speed)
        controller = reference * (1 + self.g * T * back / (1 - back)) - self.g * speed
        # q(k+1) = q + T q' + .., q'(k+1) = q' + ..: the double integrator under a current that changes at tau
        to_speed = (tau * back + (T - tau)) / (z - 1)
        to_position = (T * to_speed + tau * (T - tau / 2) * back + (T - tau) ** 2 / 2) / (z - 1)
        found: Complex = controller / (1 - felt * controller * to_position)
        return found


def first_order(g: float, rad_s: Array) -> Complex:
    """Return 1 - G of the continuous observer, s / (s + g): fig. 8 as printed."""
    s = 1j * rad_s
    found: Complex = s / (s + g)
    return found


def spectral_radius(
    inertia: Array, nominal: Sequence[float], g: float, gains: tuple[float, float], period_s: float, delay_s: Array
) -> float:
    """Return the largest modulus of the closed loop's eigenvalues at one pose: stable below 1.

    inertia: M (n, n) of the pose; nominal: Jn (n) of the controllers; delay_s: of each joint's current (n), which may
    be longer than a period. Friction, gravity, rounding and limits are left out.
    """
    return float(np.max(np.abs(np.linalg.eigvals(_transition(inertia, nominal, g, gains, period_s, delay_s)))))


def _transition(
    inertia: Array, nominal: Sequence[float], g: float, gains: tuple[float, float], period_s: float, delay_s: Array
) -> Array:
    """Return A of x(k+1) = A x(k), x = (q, q', q before, sum of g T a, a, u before, u before that, ..), each (n).

    A delay is d whole periods and a rest: until the rest is over, u of d + 1 cycles ago acts, then that of d ago.
    """
    n, T = len(inertia), period_s
    whole = np.floor(delay_s / T).astype(int)
    one, none = np.eye(n), np.zeros((n, n))
    places = 6 + int(np.max(whole))
    q, v, before, total, a, *past = (
        np.hstack([one if k == place else none for k in range(places)]) for place in range(places)
    )
    w = (q - before) / T
    u = [a + total - g * w, *past]
    held, acting = (np.array([u[d + older][joint] for joint, d in enumerate(whole)]) for older in (1, 0))
    to_acceleration = np.linalg.solve(inertia, np.diag(nominal))
    old, new = np.diag(delay_s - whole * T), np.diag(T - (delay_s - whole * T))
    speed = v + to_acceleration @ (old @ held + new @ acting)
    position = q + T * v + to_acceleration @ (old @ (T * one - old / 2) @ held + new @ new / 2 @ acting)
    k1, k2 = gains
    return np.vstack([position, speed, q, total + g * T * a, -k1 * w - k2 * q, *u[:-1]])
