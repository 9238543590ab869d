"""What the bytes of an instruction mean, wherever they stand.

Ref: Intel 8086 Family User's Manual 1979, chapter 4, machine instruction encoding and decoding.
Not implemented: what the joint CPU's code has no use for, as bytes in memory, strings, far calls and division.
"""

from hil.i8086 import flow_forms, word_forms
from hil.i8086.clocks import PREFIX
from hil.i8086.decoded import Decoded, UnknownForm
from hil.i8086.state import CS, DS, ES, SS

DECODERS = word_forms.DECODERS | flow_forms.DECODERS
OVERRIDES = {0x26: ES, 0x2E: CS, 0x36: SS, 0x3E: DS}
"""Prefixes that name the segment of an operand in memory; one at most."""


def decode(code: bytes) -> Decoded:
    """Return the instruction that code, state.LONGEST bytes, begins with; raise UnknownForm."""
    segment = OVERRIDES.get(code[0])
    if segment is None:
        return _decode(code, None)
    decoded = _decode(code[1:], segment)
    return decoded._replace(length=decoded.length + 1, clocks=decoded.clocks + PREFIX)


def _decode(code: bytes, segment: int | None) -> Decoded:
    decoder = DECODERS.get(code[0])
    if decoder is None:
        raise UnknownForm
    return decoder(code, segment)
