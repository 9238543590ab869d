"""Arithmetic and its flags against closed forms in Python's ints."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.i8086.clocks import MULTIPLY_MOST, multiply
from hil.i8086.state import AF, AX, CF, DX, OF, PF, SF, ZF
from tests.hil.i8086.processor import fits, signed, stepped, words

carries = st.integers(0, 1)


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
