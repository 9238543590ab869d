"""An instruction, decoded: what it is, what it takes, where it goes on, and how to carry it out."""

from collections.abc import Callable
from typing import NamedTuple

from hil.i8086.clocks import FORMS
from hil.i8086.state import State

NEXT, JUMP, BRANCH, CALL, RETURN = range(5)
"""Where it goes on: behind itself; elsewhere, always or perhaps; there, and back; to who called."""

Execute = Callable[[State], object]


class UnknownForm(Exception):
    """Bytes that are no instruction of ours."""


class Decoded(NamedTuple):
    """clocks: without those that execute adds: least to most on an even stack, a branch that is taken apart.

    displacement: of where it goes on, from its own end.
    """

    form: str
    length: int
    clocks: int
    execute: Execute
    least: int = 0
    most: int = 0
    goes: int = NEXT
    displacement: int = 0


Decoder = Callable[[bytes, int | None], Decoded]
"""Of an instruction's bytes, and the segment that a prefix before them names."""


def plain(form: str, length: int, execute: Execute) -> Decoded:
    """Return an instruction that has nothing in memory but the stack."""
    return Decoded(form, length, FORMS[form].register, execute)


def opcode_form(code: bytes) -> str:
    """Return the name of a form that its opcode alone tells."""
    return f"{code[0]:02X}"


def group_form(code: bytes) -> str:
    """Return the name of a form of which ModRM has a part."""
    return f"{code[0]:02X}.{code[1] >> 3 & 7}"
