"""Least and most clocks of machine code, over all paths from an entry to its return, without running it.

Every branch may go both ways, and every operand be at its worst at once: what can happen lies within, but not all that
lies within need happen. The stack is at an even address. A branch backwards ends a loop, whose rounds have to be known.
Clocks are those of hil/i8086/clocks.py.
"""

from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

from hil.i8086.clocks import TAKEN
from hil.i8086.decode import decode
from hil.i8086.decoded import BRANCH, CALL, JUMP, RETURN, Decoded, UnknownForm
from hil.i8086.interpreter import MachineCodeError
from hil.i8086.state import LONGEST

WORD = 16


class Bounds(NamedTuple):
    """Least and most of what a piece of code can take; each by a path of its own."""

    least_clocks: int
    most_clocks: int
    least_instructions: int = 1
    most_instructions: int = 1

    def then(self, other: "Bounds") -> "Bounds":
        """Return what both take, one after the other."""
        return Bounds(*(a + b for a, b in zip(self, other, strict=True)))

    def either(self, other: "Bounds") -> "Bounds":
        """Return what one or the other takes."""
        return Bounds(*(choose(a, b) for choose, a, b in zip((min, max, min, max), self, other, strict=True)))


def joint_rounds(shift: int) -> tuple[int, int]:
    """Return the rounds of the joint step's loops, shift_left and shift_right, for a joint's shift (0 to 32767)."""
    return max(WORD - shift, 0), min(max(shift - WORD, 0), WORD)


def bounds(code: bytes, entry: int, rounds: Sequence[int]) -> Bounds:
    """Return what code, which begins at offset 0, takes from entry to its return, with that return.

    rounds: of each loop, in the order of their branches: a loop of none is on no path, any other on every path. Raise
    MachineCodeError for what is no code, for another number of loops, or where no path has these rounds.
    """
    instructions = reachable(code, entry)
    loops = [at for at, decoded in instructions.items() if _ends_loop(decoded)]
    if len(loops) != len(rounds):
        raise MachineCodeError(
            f"8086: rounds of {len(rounds)} loops are given, and code from {entry:04X} on has {len(loops)}: "
            f"give one for each of the branches at {', '.join(f'{at:04X}' for at in loops) or 'none'}"
        )
    found = _Paths(instructions, loops).from_here(_Place(entry, (), tuple(rounds)))
    if found is None:
        raise MachineCodeError(
            f"8086: no path from {entry:04X} to its return has {tuple(rounds)} rounds of its loops: a loop that cannot "
            "be gone past has 1 or more, and two on different paths are not both passed"
        )
    return found


def reachable(code: bytes, entry: int) -> dict[int, Decoded]:
    """Return the instructions that can be reached from entry, by offset, in order; raise MachineCodeError."""
    found: dict[int, Decoded] = {}
    open_ends = [entry]
    while open_ends:
        at = open_ends.pop()
        if at not in found:
            found[at] = _at(code, at)
            open_ends += _next(at, found[at])
    return dict(sorted(found.items()))


def _at(code: bytes, at: int) -> Decoded:
    try:
        decoded = decode(code[at : at + LONGEST].ljust(LONGEST, b"\0"))
    except UnknownForm:
        decoded = None
    if decoded is None or at + decoded.length > len(code):
        raise MachineCodeError(
            f"8086: bytes {code[at : at + LONGEST].hex(' ').upper()} at {at:04X} of {len(code):04X} are no instruction "
            "that the interpreter knows: use the forms of hil/i8086/clocks.py, or look what leads there"
        )
    return decoded


def _behind(at: int, decoded: Decoded) -> int:
    return at + decoded.length & 0xFFFF


def _target(at: int, decoded: Decoded) -> int:
    return at + decoded.length + decoded.displacement & 0xFFFF


def _next(at: int, decoded: Decoded) -> list[int]:
    """Return where it may go on, but for a return."""
    if decoded.goes == RETURN:
        return []
    if decoded.goes == JUMP:
        return [_target(at, decoded)]
    if decoded.goes in (BRANCH, CALL):
        return [_behind(at, decoded), _target(at, decoded)]
    return [_behind(at, decoded)]


def _ends_loop(decoded: Decoded) -> bool:
    return decoded.goes == BRANCH and decoded.displacement < 0


class _Place(NamedTuple):
    """Where a path is: at an instruction, with who called, and with the rounds that each loop has left."""

    at: int
    callers: tuple[int, ...]
    rounds: tuple[int, ...]


class _Paths:
    """What can follow each place, found once. For paths of some hundred instructions: it calls itself at each."""

    def __init__(self, instructions: dict[int, Decoded], loops: list[int]) -> None:
        self.instructions = instructions
        self.loops = loops
        self.found: dict[_Place, Bounds | None] = {}
        self.begun: set[_Place] = set()

    def from_here(self, place: _Place) -> Bounds | None:
        """Return what all takes from this instruction to the last return, None where no path has these rounds."""
        if place not in self.found:
            if place in self.begun:
                raise MachineCodeError(
                    f"8086: nothing counts the rounds through {place.at:04X}: end them with a branch"
                )
            self.begun.add(place)
            self.found[place] = self._follow(place)
        return self.found[place]

    def _follow(self, place: _Place) -> Bounds | None:
        decoded = self.instructions[place.at]
        cost = Bounds(decoded.clocks + decoded.least, decoded.clocks + decoded.most)
        if decoded.goes == RETURN and not place.callers:
            return None if any(place.rounds) else cost
        ways = [
            cost.then(Bounds(TAKEN, TAKEN, 0, 0) if taken else Bounds(0, 0, 0, 0)).then(rest)
            for taken, after in self._ways(place, decoded)
            if (rest := self.from_here(after)) is not None
        ]
        return reduce(Bounds.either, ways) if ways else None

    def _ways(self, place: _Place, decoded: Decoded) -> list[tuple[bool, _Place]]:
        """Return where it goes on, each with whether a branch is taken for it."""
        behind = place._replace(at=_behind(place.at, decoded))
        target = place._replace(at=_target(place.at, decoded))
        if decoded.goes == RETURN:
            return [(False, place._replace(at=place.callers[-1], callers=place.callers[:-1]))]
        if decoded.goes == CALL:
            return [(False, target._replace(callers=(*place.callers, behind.at)))]
        if decoded.goes == JUMP:
            return [(False, target)]
        if decoded.goes != BRANCH:
            return [(False, behind)]
        if place.at not in self.loops:
            return [(False, behind), (True, target)]
        loop = self.loops.index(place.at)
        left = place.rounds[loop] - 1
        rounds = (*place.rounds[:loop], left, *place.rounds[loop + 1 :])
        if left < 0:
            return []
        return [(True, target._replace(rounds=rounds))] if left else [(False, behind._replace(rounds=rounds))]
