"""Ranges of a joint's signals by interval arithmetic: what no run leaves that keeps to these limits, from rest.

Speeds: SPEED_ROOM times the largest that is commanded. Accelerations: what the amplifiers' largest currents, gravity,
friction, coupling and torques from outside can do to the arm anywhere on the commanded path at such speeds. References:
all that the bus can say. An interval knows nothing of what depends on what, so a range may be far wider than any run's.
Not seen: contact, poses off the path, brakes that slip before the start.

Ref: R. E. Moore, Interval Analysis, 1966; eq. (1).
"""

from dataclasses import dataclass

import numpy as np

from dbc.codec import Codec
from hil.assemble import arm_parameters, joint_trajectory
from hil.constants import parameter_table
from hil.evaluate import Array
from hil.exact_constants import rad_per_count
from hil.quantise.float_twin import FloatLaw
from hil.scenario import Scenario
from hil.word_format import WordFormat
from plant.array_form import gravity, inertia
from plant.closed_form import constants

SPEED_ROOM = 2.0
"""As the design's factor of two on every signal."""
FLOORED = 1.0
"""Counts that an encoder's floor adds to a difference."""
BUS_WORD = 0x8000


@dataclass(frozen=True)
class Interval:
    """All values from low to high."""

    low: float
    high: float

    @classmethod
    def within(cls, bound: float) -> "Interval":
        """Return that from -bound to bound."""
        return cls(-bound, bound)

    def __add__(self, other: "Interval") -> "Interval":
        return Interval(self.low + other.low, self.high + other.high)

    def __sub__(self, other: "Interval") -> "Interval":
        return Interval(self.low - other.high, self.high - other.low)

    def __mul__(self, factor: float) -> "Interval":
        ends = self.low * factor, self.high * factor
        return Interval(min(ends), max(ends))

    def cut(self, word: "Interval") -> "Interval":
        """Return what a saturation to a word leaves."""
        return Interval(max(self.low, word.low), min(self.high, word.high))

    @property
    def bound(self) -> float:
        """Largest magnitude."""
        return max(abs(self.low), abs(self.high))


@dataclass(frozen=True)
class Limits:
    """The largest speed, rad/s, and acceleration, rad/s^2, of each joint."""

    speed: Array
    acceleration: Array


def physical_limits(scenario: Scenario, codec: Codec) -> Limits:
    """Return the limits of every joint on the commanded path."""
    arm, period_s = arm_parameters(scenario, codec), scenario.clock.period_s
    motion = joint_trajectory(scenario)
    commands = [motion.at(k * period_s) for k in range(min(scenario.cycles, round(motion.time_s / period_s) + 1))]
    q = np.array([position for position, _, _ in commands])
    speed = SPEED_ROOM * np.max(np.abs([velocity for _, velocity, _ in commands]), axis=0)
    current_A = min(scenario.drive.limit_A, scenario.joint.limit_A)
    torque = np.array(arm.torque_constant_Nm_A) * (1.0 + np.array(arm.ripple)) * current_A
    torque = torque + np.array(arm.coulomb_Nm) + np.array(arm.viscosity_Nms) * speed
    for each in scenario.torque:
        torque[each.joint - 1] += abs(each.amplitude_N_m)
    heaviest = sum(load.mass_kg for load in scenario.load)
    acceleration = np.zeros(scenario.joints)
    for payload_kg in {0.0, heaviest}:
        masses = np.full(len(q), payload_kg)
        all_torque = torque + np.max(np.abs(gravity(arm, q, masses)), axis=0)
        all_torque = all_torque + _coupling_bound(constants(arm, payload_kg), speed)
        compliance = np.max(np.abs(np.linalg.inv(inertia(arm, q, masses))), axis=0)
        acceleration = np.maximum(acceleration, compliance @ all_torque)
    return Limits(np.maximum(speed, acceleration * period_s), acceleration)


def _coupling_bound(link: dict[str, float], speed: Array) -> Array:
    """Return the largest |h| at such speeds, N m, whatever the pose: sines are at most 1."""
    n = len(speed)
    squares = np.cumsum(speed) ** 2
    rows = [
        sum(link[f"A{min(i, j)}{max(i, j)}"] * squares[j - 1] for j in range(1, n + 1) if j != i)
        for i in range(1, n + 1)
    ]
    bound: Array = np.cumsum(rows[::-1])[::-1]
    return bound


def _word(bits: int, fraction: int) -> Interval:
    """Return what a word holds with that many bits behind the point."""
    return Interval(-(1 << (bits - 1)), (1 << (bits - 1)) - 1) * 0.5**fraction


def derived(scenario: Scenario, joint: int, codec: Codec, limits: Limits) -> dict[str, Interval]:
    """Return the range of each signal of joint 1 to n, in counts of the bus, as its operation returns it.

    d' = (1 - KA) (d - KB dw) + KA i stays within what leaves it where it is.
    """
    form = WordFormat.of(scenario, codec)
    law = FloatLaw.of_table(form, *parameter_table(scenario, joint, codec))
    count, period_s = rad_per_count(scenario), scenario.clock.period_s
    w = Interval.within(limits.speed[joint - 1] * period_s / count + FLOORED)
    dw = Interval.within(limits.acceleration[joint - 1] * period_s**2 / count + 2 * FLOORED)
    word = _word(form.bits, form.current_shift)
    from_speed = (dw * law.kb).cut(_word(form.bits + form.kb_fraction, form.kb_places))
    a_ref = Interval(-BUS_WORD, BUS_WORD - 1).cut(_word(form.bits, form.acceleration_shift))
    feed = a_ref * law.kj
    i = Interval.within(law.limit)
    at_rest = i.bound + from_speed.bound * ((1.0 - law.ka) / law.ka if law.ka else 0.0)
    behind = form.d_fraction
    d = Interval.within(at_rest + from_speed.bound).cut(_word(form.bits + behind, form.current_shift + behind))
    error = (i - d).cut(word)
    return {
        "w": w,
        "dw": dw,
        "KB*dw": from_speed,
        "d": d,
        "estimate": d.cut(word),
        "a_ref": a_ref,
        "KJ*a_ref": feed,
        "i": i,
        "i-d": error,
        "KA*(i-d)": error * law.ka,
    }
