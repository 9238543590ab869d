"""firmware_py/targets/i8086/joint.bin in a board's memory: where it is entered, where its data lie.

Code, data and stack have 4 KiB each: what executes machine code by translating it then never finds data among it.
"""

from importlib.resources import files
from struct import Struct, unpack_from

CODE = (files("firmware_py") / "targets" / "i8086" / "joint.bin").read_bytes()
INTERRUPT, STEP, SATURATING = unpack_from("<3H", CODE)
"""Offsets in the code segment: of both entries, and of what the step does only where something saturates."""

PAGE = 0x1000
CODE_AT, DATA_AT, STACK_AT, END = PAGE, 2 * PAGE, 3 * PAGE, 4 * PAGE
"""Addresses; segments are a 16th of them."""
STACK_TOP = PAGE
"""The stack pointer of an empty stack."""
RETURN = PAGE - 1
"""Where a call from outside returns to, in the code segment: HLT is there."""
HLT = 0xF4

PARAMETERS = Struct("<Hhi6h")
"""count_prev, w_prev, d, a_ref, KA, KB, KJ, shift, current limit: from DS:0 on."""
RESULTS, RESULTS_AT = Struct("<hi12x2h4H"), DATA_AT + 2
"""w_prev, d; behind the parameters i, estimate; saturations of KB dw, d, i, i - d: counters that wrap."""
DATA_BYTES = RESULTS_AT + RESULTS.size - DATA_AT

ENCODER, DAC = 0x10, 0x12
"""Ports."""


def load(memory: bytearray | memoryview) -> None:
    """Put the code where it belongs."""
    memory[CODE_AT : CODE_AT + len(CODE)] = CODE
    memory[CODE_AT + RETURN] = HLT
