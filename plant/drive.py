"""The drives: amplifiers from counts to amperes, and the torque constant with its ripple.

Units: A, s, N m/A; counts of 1 / current_counts_per_A ampere; one tuple entry a joint. Ref: eqs. (1), (4).
Not modelled: the current loop's own dynamics beyond one first-order lag, supply voltage, heating.
"""

from math import cos, exp

from plant.parameters import ArmParameters, Vector


class Amplifiers:
    """One current amplifier a joint: limit, resolution, first-order lag; starts at 0 A."""

    def __init__(self, parameters: ArmParameters) -> None:
        self._counts_per_A = parameters.current_counts_per_A
        self._limit_A = parameters.current_limit_A
        self._lag_s = parameters.amplifier_lag_s
        self.reference_A: Vector = (0.0,) * parameters.joints
        self.current_A: Vector = self.reference_A
        self.saturations = [0] * parameters.joints
        """References beyond the limit, a joint."""

    @property
    def instant(self) -> bool:
        """A reference is the current at once."""
        return self._lag_s == 0.0

    @property
    def steady(self) -> bool:
        """The currents will stay as they are."""
        return self.instant or self.current_A == self.reference_A

    def command(self, index: int, counts: int) -> None:
        """Set the reference of joint index (from 0), limited to the largest current."""
        self.command_A(index, counts / self._counts_per_A)

    def command_A(self, index: int, asked_A: float) -> None:
        """Set a reference that is no whole count."""
        given_A = asked_A
        if not -self._limit_A <= asked_A <= self._limit_A:
            given_A = self._limit_A if asked_A > 0.0 else -self._limit_A
            self.saturations[index] += 1
        if given_A == self.reference_A[index]:
            return
        references = [*self.reference_A]
        references[index] = given_A
        self.reference_A = tuple(references)
        if self._lag_s == 0.0:
            self.current_A = self.reference_A

    def during(self, span_s: float) -> tuple[Vector, Vector, Vector]:
        """Return the currents now, after half of span_s, and after span_s."""
        current = self.current_A
        if self._lag_s == 0.0:
            return current, current, current
        return current, self._after(0.5 * span_s), self._after(span_s)

    def elapse(self, span_s: float) -> None:
        """Let span_s pass."""
        if self._lag_s != 0.0:
            self.current_A = self._after(span_s)

    def _after(self, span_s: float) -> Vector:
        left = exp(-span_s / self._lag_s)
        return tuple([r + (i - r) * left for r, i in zip(self.reference_A, self.current_A, strict=True)])


def torque_constant(parameters: ArmParameters, q: Vector) -> Vector:
    """Return Kt(q) [N m/A] = Ktn (1 + ripple cos(order q)) of each joint."""
    columns = zip(parameters.torque_constant_Nm_A, parameters.ripple, parameters.ripple_order, q, strict=True)
    return tuple([Ktn * (1.0 + ripple * cos(order * angle)) for Ktn, ripple, order, angle in columns])
