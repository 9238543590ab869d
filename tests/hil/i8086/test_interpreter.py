"""The interpreter against closed forms in Python's ints, and at its limits; test_captures.py is against silicon."""

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.i8086.clocks import INTERRUPT, MULTIPLY_MOST, multiply
from hil.i8086.interpreter import Interpreter, MachineCodeError
from hil.i8086.state import AF, AX, BP, BX, CF, CS, CX, DI, DS, DX, ES, MEMORY_BYTES, OF, PF, SF, SI, SP, SS, ZF

CODE_AT = 0x100
MEMORY = bytearray(MEMORY_BYTES)
"""Of all examples; each puts its code first."""

words = st.one_of(st.sampled_from((0, 1, 0x7FFF, 0x8000, 0xFFFF, 0x000F, 0x0010)), st.integers(0, 0xFFFF))
carries = st.integers(0, 1)


def refuse(*_: int) -> int:
    raise AssertionError("no port instruction here")


def cpu_with(code: bytes, **registers: int) -> Interpreter:
    """Return a processor before this code, in segment 0, with other segments elsewhere."""
    cpu = Interpreter(MEMORY, refuse, refuse)
    MEMORY[CODE_AT : CODE_AT + len(code)] = code
    cpu.ip = CODE_AT
    cpu.segments[DS], cpu.segments[SS], cpu.segments[ES] = 0x2000, 0x3000, 0x4000
    for name, value in registers.items():
        cpu.registers[{"ax": AX, "bx": BX, "cx": CX, "dx": DX, "sp": SP, "si": SI, "di": DI}[name]] = value
    return cpu


def stepped(code: bytes, carry: int = 0, **registers: int) -> Interpreter:
    """Return a processor after one instruction. carry: CF before it; all other flags are set."""
    cpu = cpu_with(code, **registers)
    cpu.flags = cpu.flags | PF | AF | ZF | SF | OF | carry
    cpu.step()
    return cpu


def signed(word: int) -> int:
    return word - 0x10000 if word >= 0x8000 else word


def flags_of(result: int, carry: bool, half_carry: bool, overflow: bool) -> int:
    """Return the six flags by their definitions."""
    low_ones = bin(result & 0xFF).count("1")
    return sum(
        flag
        for flag, is_set in (
            (CF, carry),
            (PF, low_ones % 2 == 0),
            (AF, half_carry),
            (ZF, result == 0),
            (SF, result >= 0x8000),
            (OF, overflow),
        )
        if is_set
    )


ALL = CF | PF | AF | ZF | SF | OF
NO_AF = ALL & ~AF
"""Where AF is undefined."""


def fits(x: int) -> bool:
    return -0x8000 <= x <= 0x7FFF


# -- sums and differences --


@pytest.mark.parametrize(("code", "with_carry"), [(b"\x01\xd8", False), (b"\x11\xd8", True)], ids=["add", "adc"])
@given(a=words, b=words, carry=carries)
def test_sums(code: bytes, with_carry: bool, a: int, b: int, carry: int) -> None:
    cpu, more = stepped(code, carry, ax=a, bx=b), carry * with_carry
    result = (a + b + more) % 0x10000
    half = a % 16 + b % 16 + more > 15
    assert cpu.registers[AX] == result
    assert cpu.flags & ALL == flags_of(result, a + b + more > 0xFFFF, half, not fits(signed(a) + signed(b) + more))


@pytest.mark.parametrize(
    ("code", "with_borrow", "kept"),
    [(b"\x29\xd8", False, True), (b"\x19\xd8", True, True), (b"\x39\xd8", False, False)],
    ids=["sub", "sbb", "cmp"],
)
@given(a=words, b=words, carry=carries)
def test_differences(code: bytes, with_borrow: bool, kept: bool, a: int, b: int, carry: int) -> None:
    cpu, less = stepped(code, carry, ax=a, bx=b), carry * with_borrow
    result = (a - b - less) % 0x10000
    half = a % 16 < b % 16 + less
    assert cpu.registers[AX] == (result if kept else a)
    assert cpu.flags & ALL == flags_of(result, a < b + less, half, not fits(signed(a) - signed(b) - less))


@given(a=words, b=st.integers(-128, 127))
def test_a_byte_in_place_of_an_immediate_word_keeps_its_sign(a: int, b: int) -> None:
    assert stepped(bytes((0x83, 0xE8, b & 0xFF)), ax=a).registers[AX] == (a - b) % 0x10000


@given(a=words)
def test_neg(a: int) -> None:
    cpu = stepped(b"\xf7\xd8", ax=a)
    assert cpu.registers[AX] == -a % 0x10000
    assert cpu.flags & ALL == flags_of(-a % 0x10000, a != 0, a % 16 != 0, a == 0x8000)


@pytest.mark.parametrize(("code", "by"), [(b"\x40", 1), (b"\x48", -1), (b"\xff\xc0", 1), (b"\xff\xc8", -1)])
@given(a=words, carry=carries)
def test_inc_and_dec_leave_the_carry(code: bytes, by: int, a: int, carry: int) -> None:
    cpu = stepped(code, carry, ax=a)
    result = (a + by) % 0x10000
    half = a % 16 == (15 if by == 1 else 0)
    assert cpu.registers[AX] == result
    assert cpu.flags & ALL == flags_of(result, bool(carry), half, not fits(signed(a) + by))


@given(a=words, b=words)
def test_xor_clears_carry_and_overflow(a: int, b: int) -> None:
    cpu = stepped(b"\x31\xd8", 1, ax=a, bx=b)
    assert cpu.registers[AX] == a ^ b
    assert cpu.flags & NO_AF == flags_of(a ^ b, False, False, False)


# -- shifts by one bit --


@given(a=words, carry=carries)
def test_shl_doubles(a: int, carry: int) -> None:
    cpu = stepped(b"\xd1\xe0", carry, ax=a)
    assert cpu.registers[AX] == 2 * a % 0x10000
    assert cpu.flags & NO_AF == flags_of(2 * a % 0x10000, a >= 0x8000, False, not fits(2 * signed(a)))


@given(a=words, carry=carries)
def test_sar_halves_and_floors(a: int, carry: int) -> None:
    cpu = stepped(b"\xd1\xf8", carry, ax=a)
    assert signed(cpu.registers[AX]) == signed(a) // 2
    assert cpu.flags & NO_AF == flags_of(cpu.registers[AX], a % 2 == 1, False, False)


@given(a=words, carry=carries)
def test_rcl_doubles_and_takes_the_carry_in(a: int, carry: int) -> None:
    cpu = stepped(b"\xd1\xd0", carry, ax=a)
    assert cpu.registers[AX] == (2 * a + carry) % 0x10000
    overflow = OF if (a >= 0x8000) != (cpu.registers[AX] >= 0x8000) else 0
    assert cpu.flags & ALL == (CF if a >= 0x8000 else 0) | PF | AF | ZF | SF | overflow


# -- products, signs --


@given(a=words, b=words)
def test_imul(a: int, b: int) -> None:
    cpu = stepped(b"\xf7\xeb", ax=a, bx=b)
    product = signed(a) * signed(b)
    assert signed(cpu.registers[DX]) * 0x10000 + cpu.registers[AX] == product
    assert cpu.flags & (CF | OF) == (0 if fits(product) else CF | OF)
    assert cpu.multiplications == 1
    assert 127 <= cpu.clocks <= 127 + MULTIPLY_MOST


@pytest.mark.parametrize(
    ("ax", "by", "more"),
    [
        pytest.param(0, 0, 0, id="no ones, no sign: least"),
        pytest.param(0x7FFF, 1, 15, id="fifteen ones"),
        pytest.param(1, 0xFFFF, 1 - 1 + 12, id="signs differ"),
        pytest.param(0xFFFF, 0xFFFF, 1 + 2 - 1, id="both negative"),
        pytest.param(0x8000, 0, 1 + 2 + 12, id="-32768 has one one"),
        pytest.param(0x8001, 0, 15 + 2 + 12, id="most"),
    ],
)
def test_clocks_of_imul_by_its_formula(ax: int, by: int, more: int) -> None:
    assert multiply(ax, by) == more


@given(a=words, b=words)
def test_no_imul_is_outside_its_range(a: int, b: int) -> None:
    assert 0 <= multiply(a, b) <= MULTIPLY_MOST == multiply(0x8001, 0)


@given(a=words)
def test_cwd(a: int) -> None:
    cpu = stepped(b"\x99", ax=a, dx=0x1234)
    assert signed(cpu.registers[DX]) * 0x10000 + cpu.registers[AX] == signed(a)


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
