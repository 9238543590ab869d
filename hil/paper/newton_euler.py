"""Inverse dynamics of the general arm of n revolute joints, with every multiplication and addition counted by its line.

Link frames by Denavit and Hartenberg, frame i at the end of link i and its z along joint i + 1. As the equations are
printed: nothing is left out because an operand is known to be zero, at the base, at the hand or in a rotation; only
the zeros and the one of z = (0, 0, 1) cost nothing. The rotations are given: n sines, n cosines and 4 n products come
on top. Units: SI.

Ref: J. Y. S. Luh, M. W. Walker, R. P. C. Paul, On-Line Computational Scheme for Mechanical Manipulators, 1980.
Not implemented: sliding joints; rotors and friction.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin
from typing import Any, NamedTuple, TypeVar

from firmware_py.words import InstrumentedWords

T = TypeVar("T")
Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]

ZERO: Vector = (0.0, 0.0, 0.0)
UNIT: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
WORD_BITS = 4096
"""Wide enough that every float passes for an operand: here the words only count."""


class Operations(NamedTuple):
    """How many of each."""

    multiplications: int
    additions: int


@dataclass(frozen=True)
class Link:
    """One link: a, d (m) and alpha (rad) by Denavit and Hartenberg, its mass, and in its own frame its body.

    centre: from the frame's origin to the centre of mass, m; inertia: about the centre of mass, kg m^2.
    """

    a: float
    d: float
    alpha: float
    mass: float
    centre: Vector
    inertia: Matrix

    def rotation(self, q: float) -> Matrix:
        """Return the matrix that takes vectors from this link's frame to that of the link before."""
        c, s, ca, sa = cos(q), sin(q), cos(self.alpha), sin(self.alpha)
        return (c, -ca * s, sa * s), (s, ca * c, -sa * c), (0.0, sa, ca)

    @property
    def reach(self) -> Vector:
        """From the origin of the frame before to this one's, in this frame."""
        return self.a, self.d * sin(self.alpha), self.d * cos(self.alpha)


class Ledger:
    """Vector algebra in counted operations, and for which line of the equations they were made."""

    def __init__(self) -> None:
        self._words: Any = InstrumentedWords(WORD_BITS)
        self.lines: dict[str, Operations] = {}

    def line(self, name: str, value: T) -> T:
        """Charge to this line what was counted since the last one; return its value."""
        spent = self.lines.get(name, Operations(0, 0))
        words = self._words
        self.lines[name] = Operations(spent[0] + words.multiplications, spent[1] + words.additions)
        words.multiplications = words.additions = 0
        return value

    @property
    def total(self) -> Operations:
        """Of all lines."""
        return Operations(*(sum(column) for column in zip(*self.lines.values(), strict=True)))

    def add(self, x: float, y: float) -> float:
        """Return x + y."""
        return float(self._words.add(x, y))

    def plus(self, u: Vector, v: Vector) -> Vector:
        """Return u + v."""
        add = self._words.add
        return add(u[0], v[0]), add(u[1], v[1]), add(u[2], v[2])

    def scaled(self, k: float, v: Vector) -> Vector:
        """Return k v."""
        multiply = self._words.multiply
        return multiply(k, v[0]), multiply(k, v[1]), multiply(k, v[2])

    def dot(self, u: Vector, v: Vector) -> float:
        """Return u . v."""
        multiply, add = self._words.multiply, self._words.add
        return float(add(add(multiply(u[0], v[0]), multiply(u[1], v[1])), multiply(u[2], v[2])))

    def apply(self, A: Matrix, v: Vector) -> Vector:
        """Return A v."""
        return self.dot(A[0], v), self.dot(A[1], v), self.dot(A[2], v)

    def cross(self, u: Vector, v: Vector) -> Vector:
        """Return u x v."""
        multiply, subtract = self._words.multiply, self._words.subtract
        return (
            subtract(multiply(u[1], v[2]), multiply(u[2], v[1])),
            subtract(multiply(u[2], v[0]), multiply(u[0], v[2])),
            subtract(multiply(u[0], v[1]), multiply(u[1], v[0])),
        )

    def turned(self, v: Vector, speed: Vector, rate: float) -> Vector:
        """Return v + speed x (z rate): z has one entry that is not zero, so two products and two sums."""
        multiply, add, subtract = self._words.multiply, self._words.add, self._words.subtract
        return add(v[0], multiply(speed[1], rate)), subtract(v[1], multiply(speed[0], rate)), v[2]

    def raised(self, v: Vector, z: float) -> Vector:
        """Return v + (0, 0, z)."""
        return v[0], v[1], self.add(v[2], z)


def transposed(A: Matrix) -> Matrix:
    """Return A^T, which moves numbers and computes none."""
    (a, b, c), (d, e, f), (g, h, i) = A
    return (a, d, g), (b, e, h), (c, f, i)


def newton_euler(
    ledger: Ledger,
    links: Sequence[Link],
    motion: Sequence[tuple[float, float, float]],
    base_acceleration: Vector = ZERO,
) -> list[float]:
    """Return the torque of every joint, N m, for its (q, q', q"); gravity is base_acceleration = -g, m/s^2."""
    rotations = [link.rotation(q) for link, (q, _, _) in zip(links, motion, strict=True)]
    bodies = _outward(ledger, links, rotations, motion, base_acceleration)
    force = moment = ZERO
    torques = []
    onward = UNIT  # takes vectors from the frame behind the link to its own; behind the last there is none
    for link, A, (F, N) in zip(reversed(links), reversed(rotations), reversed(bodies), strict=True):
        moment = _moment(ledger, link, onward, force, moment, F, N)
        force = ledger.line("f", ledger.plus(ledger.apply(onward, force), F))
        torques.append(ledger.line("tau", ledger.dot(moment, A[2])))  # A[2] is the joint's axis
        onward = A
    return torques[::-1]


def _outward(
    ledger: Ledger,
    links: Sequence[Link],
    rotations: Sequence[Matrix],
    motion: Sequence[tuple[float, float, float]],
    acceleration: Vector,
) -> list[tuple[Vector, Vector]]:
    """Return the force and the moment that each link's own body takes, about its centre of mass."""
    line, apply, cross, plus = ledger.line, ledger.apply, ledger.cross, ledger.plus
    bodies = []
    w = dw = ZERO
    for link, A, (_, rate, second) in zip(links, rotations, motion, strict=True):
        inward = transposed(A)
        dw = line("w'", apply(inward, ledger.raised(ledger.turned(dw, w, rate), second)))
        w = line("w", apply(inward, ledger.raised(w, rate)))
        swing = plus(cross(dw, link.reach), cross(w, cross(w, link.reach)))
        acceleration = line("v'", plus(swing, apply(inward, acceleration)))
        swing = plus(cross(dw, link.centre), cross(w, cross(w, link.centre)))
        F = line("F", ledger.scaled(link.mass, line("v' of the centre", plus(swing, acceleration))))
        N = line("N", plus(apply(link.inertia, dw), cross(w, apply(link.inertia, w))))
        bodies.append((F, N))
    return bodies


def _moment(ledger: Ledger, link: Link, onward: Matrix, force: Vector, moment: Vector, F: Vector, N: Vector) -> Vector:
    """Return the moment at the link's joint; force and moment are those at its end, in the frame behind it."""
    reach = ledger.apply(transposed(onward), link.reach)
    moment = ledger.apply(onward, ledger.plus(moment, ledger.cross(reach, force)))
    own = ledger.plus(ledger.cross(ledger.plus(link.reach, link.centre), F), N)
    return ledger.line("n", ledger.plus(moment, own))
