"""The interpreter against captures of single instructions of an Intel P80C86A-2."""

from collections import Counter, defaultdict
from functools import cache

from hil.i8086.bounds import reachable
from hil.i8086.clocks import FORMS
from hil.i8086.decoded import BRANCH, Decoded
from hil.i8086.image import CODE, INTERRUPT
from tests.hil.i8086.captures import PORTS, Capture, Replay, captures, decoded

CHECKED = 9000
"""150 captures of each of 58 forms, and of INC and DEC with a second register."""
NOT_CAPTURED = {"15", "1D", "81.2", "81.3", "81.6", "83.2", "83.3", "F4"}
"""Forms that the joint's code has no use for either: ADC, SBB and XOR with other immediate words, HLT."""

OTHERS = "registers, immediates, POP, RET, IRET, MOV AX from memory"

# Clocks measured - counted, least and most, by family. Captures start with a full queue (6 bytes from an even address,
# 5 from an odd one) and no wait states: what is left is the bus, which may be fetching, and the manual's own error.
TOLERANCES = {
    # The bus is not waited for, or silicon has what the manual has.
    OTHERS: (0, 0),
    "branch not taken": (0, 0),
    # A fetch under way comes first.
    "memory": (0, 1),
    # So do the last bytes of an instruction that is as long as the queue, or longer.
    "immediate word to a register": (0, 1),
    "immediate word to memory": (0, 2),
    # The manual has one clock less than silicon, in a compare with an immediate one or two.
    "MOV AX to memory": (1, 1),
    "CMP of memory and immediate": (1, 2),
    # It has one more.
    "NEG of memory, IMUL by memory": (-1, 0),
    # Silicon takes one more where AX is negative.
    "CWD": (0, 1),
    # The clocks of IMUL are a fit: one too few in 2 of these 41.
    "IMUL by a register": (0, 1),
    # The queue is full from an even address, with no fetch in the way.
    "PUSH": (-1, 0),
    # It is filled again, two clocks sooner or later by the address of the instruction.
    "CALL": (-2, 0),
    "JMP": (0, 2),
    "branch taken": (1, 3),
}
OF_MEMORY = {
    "A1": OTHERS,
    "A3": "MOV AX to memory",
    **dict.fromkeys(("81.0", "81.5"), "immediate word to memory"),
    **dict.fromkeys(("81.7", "83.7"), "CMP of memory and immediate"),
    **dict.fromkeys(("F7.3", "F7.5"), "NEG of memory, IMUL by memory"),
}
OF_REGISTERS = {
    **dict.fromkeys(("81.0", "81.5", "81.7", "C7"), "immediate word to a register"),
    "50": "PUSH",
    "99": "CWD",
    "E8": "CALL",
    "E9": "JMP",
    "EB": "JMP",
    "F7.5": "IMUL by a register",
}
JOINT_FORMS = {
    "ADD ADC SBB SUB CMP": "01 11 19 29 2B 39 83.7",
    "INC DEC NEG XOR": "FF.0 48 F7.3 35",
    "IMUL CWD": "F7.5 99",
    "SHL RCL SAR": "D1.4 D1.2 D1.7",
    "MOV PUSH POP": "89 8B A1 A3 B0 B8 50 58",
    "JO JB JE JNE JL JGE JG JMP": "70 72 74 75 7C 7D 7F E9 EB",
    "CALL RET IRET": "E8 C3 CF",
    "IN OUT": "E5 E6 E7",
}
"""Every form in joint.bin; a register in the low bits of an opcode is left out of its name."""


def family(instruction: Decoded, capture: Capture) -> str:
    """Return which tolerance a capture has."""
    if instruction.goes == BRANCH:
        ip = capture["initial"]["regs"]["ip"]
        not_taken = capture["final"]["regs"].get("ip", ip) == ip + instruction.length & 0xFFFF
        return "branch not taken" if not_taken else "branch taken"
    if "[" in capture["name"]:
        return OF_MEMORY.get(instruction.form, "memory")
    return OF_REGISTERS.get(instruction.form, OTHERS)


@cache
def replayed() -> tuple[list[str], dict[str, Counter[int]]]:
    """Return all differences from silicon, and clocks measured - counted by family, of all captures of known forms."""
    replay, wrong, clocks = Replay(), [], defaultdict(Counter)
    for form, group in captures().items():
        for capture in group["tests"]:
            instruction = decoded(capture)
            if instruction is not None:
                differences, more = replay(capture, group["flags_mask"])
                wrong += [f"{form} {capture['name']}: {difference}" for difference in differences]
                clocks[family(instruction, capture)][more] += 1
    assert not any(replay.memory), "an instruction wrote where silicon did not"
    return wrong, clocks


def test_registers_memory_and_defined_flags_are_those_of_silicon() -> None:
    wrong, clocks = replayed()
    assert not wrong
    assert sum(map(Counter.total, clocks.values())) == CHECKED


def test_clocks_are_within_their_tolerance_and_no_tolerance_is_larger_than_it_must_be() -> None:
    _, clocks = replayed()
    assert {name: (min(counts), max(counts)) for name, counts in clocks.items()} == TOLERANCES


def joint_forms() -> set[str]:
    return set(" ".join(JOINT_FORMS.values()).split())


def test_the_joint_has_these_forms() -> None:
    assert {decoded.form for decoded in reachable(CODE, INTERRUPT).values()} == joint_forms()


def test_all_of_the_joints_code_can_be_reached() -> None:
    """So no form hides in a part that was not looked at."""
    assert sum(decoded.length for decoded in reachable(CODE, INTERRUPT).values()) == len(CODE) - INTERRUPT


def test_every_form_of_the_joint_is_captured_or_a_port_instruction() -> None:
    captured = {
        instruction.form
        for group in captures().values()
        for capture in group["tests"]
        if (instruction := decoded(capture)) is not None
    }
    assert joint_forms() - captured == set(JOINT_FORMS["IN OUT"].split())
    assert set(FORMS) - captured == NOT_CAPTURED | PORTS
