"""The dead band of a joint at rest: the angle errors that its loop leaves standing, predicted from its resolutions.

At standstill the observer says KA (i - d) = KA KJ q"_ref, and q"_ref = -K2 e, eqs. (8), (16). Where that leaves nothing
for d the loop has no integral action: a slow torque carries the joint through the band before anything holds it.
What an error e must be before it counts, each resolution alone, all others exact, is its zero cell over the gain
from e to where it is rounded:

    encoder     2 pi / N                               floor
    reference   c_a / K2                               c_a: the coarser of the bus's and the joint's count, rad/s^2
    current     z c_i Ktn / (Jn K2)                    c_i: the joint's count, A
    d           z 2^-f c_i Ktn / (Jn K2 KA)            f: bits of d behind a current count

with z the width of a rounding's zero cell, in units: 1, and 2 toward zero. A floor's cell lies on one side of nothing,
so its error has one sign. Together they do not add up: one that comes later rounds what an earlier one left, and the
edges are those whole encoder counts whose reference, current and step of d are the first to be something.

No joint rests on the edge of an encoder's count: after it has crossed one it goes on until a current answers, which is
for the rest of a period, T / 2 in the mean, and the delay of that current. KB for one sample changes the speed of joint
k by g (2 pi / N) Jn_k (M^-1)_kk, and that of joint i by (M^-1)_ik in place of the last. Between none and all of that
speed, on two sides: the encoder's limit cycle adds

    sum over k of g (2 pi / N) Jn_k |(M^-1)_ik| (T / 2 + delay_k)

Units: rad. Ref: the paper's eqs. (5), (6), (8), (16); firmware_py.joint_cpu.
Not predicted: friction, which holds a joint anywhere in the band; loops near their limit of stability; what the DSP's
single precision adds, 0.06 urad at 1 rad.
"""

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass
from math import ceil

import numpy as np

from dbc.codec import Codec
from firmware_py.joint_cpu import A_REF
from hil.assemble import arm_parameters
from hil.constants import action_delays_ns, parameter_table
from hil.engine.functional_run import functional
from hil.errors import ScenarioError
from hil.exact_constants import rad_per_count
from hil.scenario import Scenario
from hil.word_format import BUS_BITS, WordFormat, words_of
from plant.array_form import inertia

ZERO_CELL = {"floor": 1.0, "nearest": 1.0, "convergent": 1.0, "toward-zero": 2.0}
LARGEST_REFERENCE = (1 << (BUS_BITS - 1)) - 1
"""Counts of AccelRef."""


@dataclass(frozen=True)
class DeadBand:
    """What is predicted of a joint. alone: width by each resolution; low, high: the edges of all together, angle minus
    command; cycle: what the encoder's limit cycle adds.
    """

    alone: dict[str, float]
    low: float
    high: float
    cycle: float

    @property
    def width(self) -> float:
        """Of all resolutions together."""
        return self.high - self.low

    @property
    def range(self) -> float:
        """Of the angles at which the joint is to be found."""
        return self.width + self.cycle

    @property
    def dominant(self) -> str:
        """Name of the resolution with the widest band of its own."""
        return max(self.alone, key=self.alone.__getitem__)


def dead_band(scenario: Scenario, joint: int, codec: Codec) -> DeadBand:
    """Return that of joint 1 to n; raise ScenarioError where it has no end: errors of any size are left standing."""
    if not scenario.joint.observer or scenario.dsp.k2_1_s2 == 0.0:
        what = "dsp.k2_1_s2 = 0" if scenario.joint.observer else "joint.observer = false"
        raise ScenarioError(f"{what}: at rest an error of any size is left standing: leave out --rest, or the setting")
    count = rad_per_count(scenario)
    silent_below, silent_above = _silent_counts(scenario, joint, codec)
    return DeadBand(
        alone=_alone(scenario, joint, codec),
        low=-silent_below * count,
        high=(silent_above + 1) * count,
        cycle=_limit_cycle(scenario, joint, codec),
    )


def _limit_cycle(scenario: Scenario, joint: int, codec: Codec) -> float:
    """Return what the encoders' counts add to a joint's band at the start pose."""
    settings, drive = scenario.joint, scenario.drive
    dead_s = np.array(drive.dead_time_s or (0.0,) * scenario.joints)
    delays_s = np.array(action_delays_ns(functional(scenario))) * 1e-9 + dead_s + drive.lag_s
    M = inertia(arm_parameters(scenario, codec), np.array([scenario.start_rad]), np.zeros(1))[0]
    turned = np.array(settings.inertia_kg_m2) * np.abs(np.linalg.inv(M)[joint - 1])
    speeds = settings.g_rad_s * rad_per_count(scenario) * turned
    return float(np.sum(speeds * (scenario.clock.period_s / 2 + delays_s)))


def _alone(scenario: Scenario, joint: int, codec: Codec) -> dict[str, float]:
    """Return the width that each resolution has where all others are exact."""
    settings, form, k2 = scenario.joint, WordFormat.of(scenario, codec), scenario.dsp.k2_1_s2
    inertia, torque_constant = settings.inertia_kg_m2[joint - 1], settings.torque_constant_N_m_A[joint - 1]
    current = 0.5**form.current * torque_constant / (inertia * k2)
    ka = settings.g_rad_s * scenario.clock.period_s
    return {
        "encoder": rad_per_count(scenario),
        "reference": 0.5 ** min(form.acceleration, form.bus_acceleration) / k2,
        "current": ZERO_CELL[settings.word.round_reference] * current,
        "d": ZERO_CELL[settings.word.round_d] * 0.5**form.d_fraction * current / ka,
    }


def _silent_counts(scenario: Scenario, joint: int, codec: Codec) -> tuple[int, int]:
    """Return how many encoder counts below and above the command leave d as it is."""
    per_count = -scenario.dsp.k2_1_s2 * rad_per_count(scenario) / codec.scale("AccelRef", "Joint1")
    ka, _, kj, shift, _ = parameter_table(scenario, joint, codec)
    words = words_of(scenario, codec)

    def moves_d(counts: int) -> bool:
        asked = max(-LARGEST_REFERENCE, min(LARGEST_REFERENCE, round(per_count * counts)))
        feed = words.reference_current(kj * words.acceleration_from_bus(A_REF, asked), shift)
        return bool(words.current_in_d(ka * feed))

    return _first(lambda n: moves_d(-n), per_count, joint) - 1, _first(moves_d, per_count, joint) - 1


def _first(moves_d: Callable[[int], bool], per_count: float, joint: int) -> int:
    """Return the least count from 1 on that moves d; what is asked for is never less further away."""
    most = ceil(LARGEST_REFERENCE / abs(per_count))
    if not moves_d(most):
        raise ScenarioError(
            f"joint{joint}: the largest reference of the DSP leaves d as it is: so coarse are "
            "joint.word.acceleration_fraction, current_fraction and d_fraction: raise them"
        )
    return 1 + bisect_left(range(1, most), True, key=moves_d)
