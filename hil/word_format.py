"""The formats of a joint CPU's numbers: what a scenario's [joint.word] means for the word arithmetic.

Counts of the bus are those of arm.dbc; the CPU's own may have more bits, or less, behind the point.
"""

from dataclasses import dataclass
from math import floor, log2
from typing import Any

from dbc.codec import Codec
from firmware_py.joint_cpu import SIGNALS
from firmware_py.words import ROUNDINGS, Words
from hil.errors import ScenarioError
from hil.exact_constants import exact_constants
from hil.scenario import Scenario

BUS_BITS = 16
"""Of a constant in a Parameter frame, of a counter in an Encoder frame."""
LARGEST_KB_FRACTION = 32
SHORTEST_PRODUCT = 2
MOST_BITS = 62
"""Of d: every sum fits 64 bits then, which is what the fast engine has."""


@dataclass(frozen=True)
class WordFormat:
    """Word length, and bits behind the point: of d behind a current count, of KA, of KB behind a current count per
    count and sample, of the CPU's counts and the bus's behind the ampere and 1 rad/s^2.
    """

    bits: int
    d_fraction: int
    ka_fraction: int
    kb_fraction: int
    current: int
    acceleration: int
    bus_current: int
    bus_acceleration: int

    @classmethod
    def of(cls, scenario: Scenario, codec: Codec) -> "WordFormat":
        """Return the formats of a scenario's joints; raise ScenarioError where d gets too long."""
        word = scenario.joint.word
        bits = word.bits
        current = bits - 5 if word.current_fraction is None else word.current_fraction
        d_fraction = min(bits, MOST_BITS - bits) if word.d_fraction is None else word.d_fraction
        if bits + d_fraction > MOST_BITS:
            raise ScenarioError(
                f"joint.word.d_fraction = {d_fraction} with joint.word.bits = {bits}: d would have "
                f"{bits + d_fraction} bits, and {MOST_BITS} is the most: take {MOST_BITS - bits} or less"
            )
        kb_fraction = _kb_fraction(scenario, codec, current)
        if bits + kb_fraction < SHORTEST_PRODUCT:
            raise ScenarioError(
                f"joint.word.kb_fraction = {kb_fraction} with joint.word.bits = {bits}: KB dw would have "
                f"{bits + kb_fraction} bits: take {SHORTEST_PRODUCT - bits} or more"
            )
        return cls(
            bits=bits,
            d_fraction=d_fraction,
            ka_fraction=min(bits, BUS_BITS) - 1,
            kb_fraction=kb_fraction,
            current=current,
            acceleration=bits - 9 if word.acceleration_fraction is None else word.acceleration_fraction,
            bus_current=_fraction(codec.scale("Current_1", "Reference")),
            bus_acceleration=_fraction(codec.scale("AccelRef", "Joint1")),
        )

    @property
    def current_shift(self) -> int:
        """Bits that the CPU's current counts have more than the bus's."""
        return self.current - self.bus_current

    @property
    def acceleration_shift(self) -> int:
        """Bits that the CPU's acceleration counts have more than the bus's."""
        return self.acceleration - self.bus_acceleration

    @property
    def kb_places(self) -> int:
        """Bits of KB behind the bus's current count."""
        return self.kb_fraction + self.current_shift

    def kj_places(self, shift: int) -> int:
        """Return the bits of KJ behind the bus's counts. shift: of the joint's table."""
        return shift + self.current_shift - self.acceleration_shift

    @property
    def total_bits(self) -> int:
        """What a joint's numbers take: d; KA, KB, KJ; both counters; the words a_ref, i, i - d and KB dw."""
        return self.bits + self.d_fraction + 3 * self.constant_bits + 2 * min(self.bits, BUS_BITS) + 4 * self.bits

    @property
    def constant_bits(self) -> int:
        """Of KA, KB and KJ, which come over the bus."""
        return min(self.bits, BUS_BITS)

    @property
    def largest_constant(self) -> int:
        """What they can be."""
        return (1 << (self.constant_bits - 1)) - 1


def with_word(scenario: Scenario, **formats: Any) -> Scenario:
    """Return the scenario with these formats of its words."""
    joint = scenario.joint.model_copy(update={"word": scenario.joint.word.model_copy(update=formats)})
    return scenario.model_copy(update={"joint": joint})


def _fraction(scale: float) -> int:
    """Return the bits behind the point of counts of that scale, a power of two."""
    return -round(log2(scale))


def _kb_fraction(scenario: Scenario, codec: Codec, current: int) -> int:
    """Return KB's bits behind the point; to fit: the most with which that of no joint leaves its word."""
    word = scenario.joint.word
    if word.kb_fraction is None:
        return min(0, BUS_BITS - word.bits)
    if word.kb_fraction != "fit":
        return word.kb_fraction
    largest = max(exact_constants(scenario, joint, codec)[1] for joint in range(1, scenario.joints + 1))
    own = largest * 2.0 ** (current - _fraction(codec.scale("Current_1", "Reference")))
    return max(
        SHORTEST_PRODUCT - word.bits,
        min(LARGEST_KB_FRACTION, MOST_BITS - word.bits, _most(own, min(word.bits, BUS_BITS))),
    )


def _most(exact: float, bits: int) -> int:
    """Return the most bits behind the point that leave a constant in its word."""
    return floor(log2(((1 << (bits - 1)) - 0.5) / exact))


def q_format(bits: int, fraction: int) -> str:
    """Return the name of a signed format: Q whole.fraction, with the sign's bit beside."""
    return f"Q{bits - fraction - 1}.{fraction}"


def raw(what: str, exact: float, fraction: int, bits: int, cure: str, setting: str = "") -> int:
    """Return a positive constant in its format; raise ScenarioError where that cannot hold it, and say which can.

    setting: what chooses the fraction.
    """
    value, largest = round(exact * 2.0**fraction), (1 << (bits - 1)) - 1
    if 0 < value <= largest:
        return value
    can = _most(exact, bits)
    other = f"{q_format(bits, can)} can: set {setting} = {can}{' or below' if value else ''}, or " if setting else ""
    raise ScenarioError(
        f"{what} = {value} does not fit its format {q_format(bits, fraction)} (1 to {largest}): {other}{cure}"
    )


def words_of(scenario: Scenario, codec: Codec, kind: Any = Words) -> Any:
    """Return the word arithmetic of one joint. kind: class of the words."""
    form, word = WordFormat.of(scenario, codec), scenario.joint.word
    roundings = tuple(ROUNDINGS.index(each) for each in (word.round_d, word.round_estimate, word.round_reference))
    return kind(
        form.bits,
        len(SIGNALS),
        form.d_fraction,
        form.ka_fraction,
        form.kb_fraction,
        form.current_shift,
        form.acceleration_shift,
        roundings,
        word.overflow == "wrap",
        min(form.bits, BUS_BITS),
    )
