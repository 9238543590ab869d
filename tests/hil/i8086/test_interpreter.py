"""The interpreter's branches, addresses, segments, ports and limits; test_captures.py is against silicon."""

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.i8086.clocks import INTERRUPT
from hil.i8086.interpreter import Interpreter, MachineCodeError
from hil.i8086.state import AX, BP, BX, CS, DI, DS, DX, ES, SI, SP, SS
from tests.hil.i8086.processor import CODE_AT, MEMORY, cpu_with, fits, refuse, signed, stepped, words

# -- branches --

CONDITIONS: dict[int, Callable[[int, int], bool]] = {
    0x70: lambda a, b: not fits(signed(a) - signed(b)),
    0x72: lambda a, b: a < b,
    0x74: lambda a, b: a == b,
    0x78: lambda a, b: (a - b) % 0x10000 >= 0x8000,
    0x7C: lambda a, b: signed(a) < signed(b),
    0x7E: lambda a, b: signed(a) <= signed(b),
}


@pytest.mark.parametrize("opcode", [even + odd for even in CONDITIONS for odd in (0, 1)], ids="{:02X}".format)
@given(a=words, b=words, displacement=st.integers(-128, 127))
def test_a_branch_after_cmp(opcode: int, a: int, b: int, displacement: int) -> None:
    cpu = cpu_with(bytes((0x39, 0xD8, opcode, displacement & 0xFF)), ax=a, bx=b)
    cpu.step()
    cpu.step()
    taken = CONDITIONS[opcode & 0xFE](a, b) != bool(opcode & 1)
    assert (cpu.ip, cpu.clocks - 3) == ((CODE_AT + 4 + displacement, 16) if taken else (CODE_AT + 4, 4))


# -- segments, ends of memory, ports --


def test_a_word_at_the_end_of_its_segment_wraps_to_its_beginning() -> None:
    cpu = cpu_with(b"\xa3\xff\xff\xa1\xff\xff", ax=0xABCD)
    cpu.step()
    assert (MEMORY[0x2FFFF], MEMORY[0x20000]) == (0xCD, 0xAB)
    cpu.registers[AX] = 0
    cpu.step()
    assert cpu.registers[AX] == 0xABCD


@pytest.mark.parametrize(("offset", "places"), [(0x0F, (0xFFFFF, 0)), (0x10, (0, 1))])
def test_a_word_past_the_end_of_memory_is_at_its_beginning(offset: int, places: tuple[int, int]) -> None:
    cpu = cpu_with(bytes((0xA3, offset, 0)), ax=0xABCD)
    cpu.segments[DS] = 0xFFFF
    cpu.step()
    assert [MEMORY[place] for place in places] == [0xCD, 0xAB]


MODES = ("bx si 7", "bx di 8", "bp si 8", "bp di 7", "si 5", "di 5", "bp 5", "bx 5")
"""By ModRM's r/m: registers that add up, and documented clocks, 4 more with a displacement."""
NUMBERS = {"bx": BX, "bp": BP, "si": SI, "di": DI}


@given(rm=st.integers(0, 7), mode=st.integers(0, 2), displacement=words, values=st.lists(words, min_size=4, max_size=4))
def test_addresses_by_modrm(rm: int, mode: int, displacement: int, values: list[int]) -> None:
    """MOV of DX to there; the stack segment where BP has a part, and BP without displacement is none."""
    direct = mode == 0 and rm == 6
    code = bytes((0x89, mode << 6 | DX << 3 | rm)) + displacement.to_bytes(2, "little")[: 2 if direct else mode]
    cpu = cpu_with(code, dx=0x1234)
    at = dict(zip(NUMBERS, values, strict=True))
    for name, number in NUMBERS.items():
        cpu.registers[number] = at[name]
    *names, clocks = ["6"] if direct else MODES[rm].split()
    byte = (displacement + 0x80) % 0x100 - 0x80
    offset = sum(at[name] for name in names) + (displacement if direct else (0, byte, displacement)[mode])
    segment = cpu.segments[SS if "bp" in names else DS] << 4
    cpu.step()
    places = [segment + (offset + k) % 0x10000 for k in (0, 1)]
    assert [MEMORY[place] for place in places] == [0x34, 0x12]
    for place in places:
        MEMORY[place] = 0
    assert cpu.clocks == 9 + int(clocks) + (4 if mode else 0) + (4 if offset % 2 else 0)
    assert cpu.ip == CODE_AT + len(code)


@pytest.mark.parametrize("number", range(8))
def test_mov_of_a_byte_leaves_the_other_half(number: int) -> None:
    cpu = cpu_with(bytes((0xB0 + number, 0x99)), ax=0x1234, cx=0x1234, dx=0x1234, bx=0x1234)
    cpu.step()
    expected = [0x1234] * 4
    expected[number % 4] = 0x1299 if number < 4 else 0x9934
    assert cpu.registers[:4] == expected


def test_code_at_the_end_of_its_segment_goes_on_at_its_beginning() -> None:
    """MOV AX,1234h, cut by the end; again after its last byte has changed, which is no part of what stands in line."""
    cpu = Interpreter(MEMORY, refuse, refuse)
    cpu.segments[CS] = 0x5000
    MEMORY[0x5FFFF], MEMORY[0x50000:0x50002] = 0xB8, b"\x34\x12"
    MEMORY[0x60000:0x60002] = b"\x34\x12"
    for high in (0x12, 0x56):
        MEMORY[0x50001] = high
        cpu.ip = 0xFFFF
        cpu.step()
        assert (cpu.registers[AX], cpu.ip) == (high << 8 | 0x34, 2)


def test_code_that_changes_is_what_it_has_become() -> None:
    cpu = cpu_with(b"\x40")
    cpu.step()
    MEMORY[CODE_AT] = 0x48
    cpu.ip = CODE_AT
    cpu.step()
    assert cpu.registers[AX] == 0


@pytest.mark.parametrize(("prefix", "segment"), [(0x26, ES), (0x2E, CS), (0x36, SS), (0x3E, DS)])
def test_a_prefix_names_the_segment(prefix: int, segment: int) -> None:
    cpu = cpu_with(bytes((prefix, 0xA1, 0x40, 0x00)))
    at = (cpu.segments[segment] << 4) + 0x40
    MEMORY[at : at + 2] = b"\x34\x12"
    cpu.step()
    MEMORY[at : at + 2] = b"\0\0"
    assert (cpu.registers[AX], cpu.clocks) == (0x1234, 12)


def test_push_sp_stores_what_it_has_become() -> None:
    cpu = stepped(b"\x54", sp=0x100)
    assert cpu.pop() == 0xFE


def test_a_call_and_its_return_and_a_return_from_an_interrupt() -> None:
    cpu = cpu_with(b"\xe8\x01\x00\xcf\xc3", sp=0x100)
    for word in (0x0AFF, 0x1234, 0x5678):
        cpu.push(word)
    for _ in range(3):
        cpu.step()
    assert (cpu.ip, cpu.segments[CS], cpu.flags, cpu.registers[SP]) == (0x5678, 0x1234, 0xFAD7, 0x100)
    assert cpu.clocks == 19 + 16 + 32


def test_ports_give_and_take_bytes_and_words() -> None:
    written: list[tuple[int, int]] = []
    cpu = Interpreter(MEMORY, lambda port: 0x9900 + port, lambda port, value: written.append((port, value)))
    MEMORY[CODE_AT : CODE_AT + 8] = b"\xe5\x10\xe7\x12\xe4\x11\xe6\x21"
    cpu.ip = CODE_AT
    for _ in range(4):
        cpu.step()
    assert cpu.registers[AX] == 0x9911
    assert written == [(0x12, 0x9910), (0x21, 0x11)]
    assert cpu.clocks == 40


@pytest.mark.parametrize("code", [b"\xe5\x11", b"\xe7\x13"], ids=["in", "out"])
def test_a_word_at_an_odd_port_takes_two_bus_cycles(code: bytes) -> None:
    cpu = Interpreter(MEMORY, lambda _port: 0, lambda _port, _value: None)
    MEMORY[CODE_AT : CODE_AT + 2] = code
    cpu.ip = CODE_AT
    cpu.step()
    assert cpu.clocks == 14


def test_the_acknowledgement_of_an_interrupt_is_the_manual_s() -> None:
    assert INTERRUPT == 61


# -- limits --


def test_a_run_ends_before_the_instruction_it_is_to_reach() -> None:
    cpu = cpu_with(b"\x40\x40\xf4\x40")
    cpu.run(CODE_AT + 3, most=3)
    assert (cpu.registers[AX], cpu.instructions, cpu.clocks) == (2, 3, 6)


def test_a_run_to_where_it_stands_does_nothing() -> None:
    cpu = cpu_with(b"\x40")
    cpu.run(CODE_AT, most=0)
    assert cpu.instructions == 0


def test_a_run_that_does_not_end_is_ended() -> None:
    cpu = cpu_with(b"\xeb\xfe")
    with pytest.raises(MachineCodeError, match=r"50 instructions did not lead to 0000:0200, the last to 0000:0100.*50"):
        cpu.run(0x200, most=50)
    assert cpu.instructions == 50


@pytest.mark.parametrize(
    "code",
    [
        pytest.param(b"\x0f\x01", id="POP CS, later a prefix"),
        pytest.param(b"\xc1\xe0\x04", id="SHL AX,4 of the 186"),
        pytest.param(b"\x69\xc0\x03\x00", id="IMUL AX,AX,3 of the 186"),
        pytest.param(b"\x66\x40", id="an operand of 32 bits"),
        pytest.param(b"\xf7\xf3", id="DIV"),
        pytest.param(b"\x81\xc8\x01\x00", id="OR AX,1 as a group"),
        pytest.param(b"\x83\xf0\x01", id="XOR AX,1 as a byte, in later manuals"),
        pytest.param(b"\xff\xe0", id="JMP AX"),
        pytest.param(b"\xd1\xe8", id="SHR"),
        pytest.param(b"\xf3\x40", id="REP"),
        pytest.param(b"\x26\x2e\x40", id="two prefixes"),
        pytest.param(b"\x26\x0f", id="unknown behind a prefix"),
    ],
)
def test_an_instruction_that_is_not_known_is_named_and_changes_nothing(code: bytes) -> None:
    cpu = cpu_with(code)
    before = (*cpu.registers, cpu.flags, cpu.ip)
    with pytest.raises(MachineCodeError, match=f"opcode {code[0]:02X} at 0000:0100, bytes {code.hex(' ').upper()}"):
        cpu.run(0x200)
    assert (*cpu.registers, cpu.flags, cpu.ip) == before
    assert cpu.instructions == cpu.clocks == 0
