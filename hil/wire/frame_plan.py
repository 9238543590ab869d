"""The bits of one frame, one by one, as its sender puts them on the bus: for whoever disturbs or follows single bits.

Ref: ISO 11898-1:2015, 10.4 (frames), 10.4.2.6 (CRC field), frame coding; Bosch, CAN Specification 2.0 (1991).
Not implemented: error and overload frames.

A classic frame of 8 bytes takes 0.07 ms, an FD frame of 64 bytes 0.4 ms; who wants the length alone has it from
`frame_bits` and `fd_frame_bits` in a fiftieth of that.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from hil.wire.bits import CRC15_POLYNOMIAL, checked_dlc
from hil.wire.fd_bits import LONGEST_CRC17, fd_dlc
from hil.wire.identifier import check_number

CRC17_POLYNOMIAL = 0x1685B
CRC21_POLYNOMIAL = 0x102899
DOMINANT, RECESSIVE = 0, 1


@dataclass(frozen=True, slots=True)
class FramePlan:
    """A frame from SOF to the last bit of EOF; the four lists have one entry for each bit, stuff bits included.

    levels: 0 dominant, 1 recessive; the ACK slot is recessive, as its sender sends it.
    fields: SOF, ID, SRR, IDE, RTR or RRS, r1, r0 or FDF, res, BRS, ESI; DLC, data, SC, CRC, CRC delimiter, ACK slot,
        ACK delimiter, EOF. A stuff bit bears the field of the bit before it, so the fixed one before SC bears another.
    stuff: whether it is a stuff bit, dynamic or fixed; the fixed ones are those from the one just before SC on.
    fast: whether it lasts a data bit; BRS counts as nominal and the CRC delimiter as fast, see `fd_frame_bits`.
    arbitration_end: index of the first bit behind RTR or RRS. A stuff bit there is no longer arbitration.
    """

    levels: list[int]
    fields: list[str]
    stuff: list[bool]
    fast: list[bool]
    arbitration_end: int


class _Bit(NamedTuple):
    level: int
    field: str
    stuff: bool = False


def frame_plan(
    identifier: int,
    data: bytes,
    extended: bool = False,
    remote: bool = False,
    fd: bool = False,
    brs: bool = True,
    esi: bool = False,
    dlc: int | None = None,
) -> FramePlan:
    """Return the bits of a frame. Arguments and errors as in `frame_bits` and `fd_frame_bits`.

    `dlc` is for classic frames, `brs` and `esi` are for FD frames: the others are without them. ValueError also for
    a remote FD frame, which does not exist.
    """
    check_number(identifier, extended)
    if fd:
        bits = _fd_bits(identifier, data, extended, remote, brs, esi) + _trailer()
    else:
        bits = _classic_bits(identifier, data, extended, remote, checked_dlc(data, remote, dlc)) + _trailer()
    fields = [bit.field for bit in bits]
    return FramePlan(
        levels=[bit.level for bit in bits],
        fields=fields,
        stuff=[bit.stuff for bit in bits],
        fast=_fast(fields, fd and brs),
        arbitration_end=fields.index("RRS" if fd else "RTR") + 1,
    )


def crc15(levels: Iterable[int]) -> int:
    """Return the CRC-15 of classic CAN over bits."""
    return _crc(levels, 15, CRC15_POLYNOMIAL, 0)


def crc17(levels: Iterable[int], start: int = 1 << 16) -> int:
    """Return the CRC-17 of CAN FD over bits. ISO 11898-1 starts from 1 << 16, the specification of 2012 from 0."""
    return _crc(levels, 17, CRC17_POLYNOMIAL, start)


def crc21(levels: Iterable[int], start: int = 1 << 20) -> int:
    """Return the CRC-21 of CAN FD over bits. ISO 11898-1 starts from 1 << 20, the specification of 2012 from 0."""
    return _crc(levels, 21, CRC21_POLYNOMIAL, start)


def _classic_bits(identifier: int, data: bytes, extended: bool, remote: bool, dlc: int) -> list[_Bit]:
    """Return SOF to CRC, stuffed; the CRC is over the bits before stuffing, and stuffed with them."""
    control = (("r1", DOMINANT), ("r0", DOMINANT)) if extended else (("IDE", DOMINANT), ("r0", DOMINANT))
    bits = _arbitration(identifier, extended, "RTR", remote)
    bits += [_Bit(level, field) for field, level in control]
    bits += _number(dlc, 4, "DLC") + _data(data)
    crc = crc15(bit.level for bit in bits)
    return _stuffed(bits + _number(crc, 15, "CRC"))


def _fd_bits(identifier: int, data: bytes, extended: bool, remote: bool, brs: bool, esi: bool) -> list[_Bit]:
    """Return SOF to CRC, stuffed; the CRC is over the stuffed bits and the stuff count, without fixed stuff bits."""
    if remote:
        raise ValueError("remote FD frame: there is none, pass fd=False")
    bits = _arbitration(identifier, extended, "RRS", False)
    if not extended:
        bits.append(_Bit(DOMINANT, "IDE"))
    bits += [_Bit(RECESSIVE, "FDF"), _Bit(DOMINANT, "res"), _Bit(int(brs), "BRS"), _Bit(int(esi), "ESI")]
    bits += _number(fd_dlc(len(data)), 4, "DLC") + _data(data)
    body = _stuffed(bits)
    if body[-1].stuff:
        body.pop()  # the fixed stuff bit takes its place, and it does not count
    count = _number(stuff_count(len(body) - len(bits)), 4, "SC")
    covered = [bit.level for bit in body + count]
    crc = _number(crc17(covered), 17, "CRC") if len(data) <= LONGEST_CRC17 else _number(crc21(covered), 21, "CRC")
    return body + _fixed_stuffed(body[-1], count + crc)


def _arbitration(identifier: int, extended: bool, request: str, remote: bool) -> list[_Bit]:
    """Return SOF to RTR or RRS."""
    sof, rtr = _Bit(DOMINANT, "SOF"), _Bit(int(remote), request)
    if not extended:
        return [sof, *_number(identifier, 11, "ID"), rtr]
    srr, ide = _Bit(RECESSIVE, "SRR"), _Bit(RECESSIVE, "IDE")
    return [sof, *_number(identifier >> 18, 11, "ID"), srr, ide, *_number(identifier & 0x3FFFF, 18, "ID"), rtr]


def _trailer() -> list[_Bit]:
    """Return the CRC delimiter and what follows it: no stuffing, all recessive."""
    fields = ["CRC delimiter", "ACK slot", "ACK delimiter"] + ["EOF"] * 7
    return [_Bit(RECESSIVE, field) for field in fields]


def _number(value: int, width: int, field: str) -> list[_Bit]:
    """Return the bits of a number, most significant first."""
    return [_Bit(value >> shift & 1, field) for shift in reversed(range(width))]


def _data(data: bytes) -> list[_Bit]:
    return [bit for byte in data for bit in _number(byte, 8, "data")]


def _stuffed(bits: list[_Bit]) -> list[_Bit]:
    """Return the bits with the opposite behind each five equal ones; a stuff bit is the first of the next five."""
    wire: list[_Bit] = []
    run = 0
    for bit in bits:
        run = run + 1 if wire and wire[-1].level == bit.level else 1
        wire.append(bit)
        if run == 5:
            wire.append(_opposite(bit))
            run = 1
    return wire


def _fixed_stuffed(last: _Bit, bits: list[_Bit]) -> list[_Bit]:
    """Return the bits with the opposite of its neighbour before each four; `last` is the bit in front of them."""
    wire: list[_Bit] = []
    for index, bit in enumerate(bits):
        if index % 4 == 0:
            wire.append(_opposite(last))
        wire.append(bit)
        last = bit
    return wire


def _opposite(bit: _Bit) -> _Bit:
    return _Bit(1 - bit.level, bit.field, stuff=True)


def stuff_count(dynamic: int) -> int:
    """Return the number of dynamic stuff bits modulo 8 in Gray code, and behind it the bit that makes its ones even."""
    count = dynamic % 8
    gray = count ^ count >> 1
    return gray << 1 | gray.bit_count() % 2


def _crc(levels: Iterable[int], width: int, polynomial: int, register: int) -> int:
    """Return what the shift register of ISO 11898-1 holds after the bits; the polynomial is without its top bit."""
    for level in levels:
        feedback = register >> width - 1 ^ level
        register = register << 1 & (1 << width) - 1
        if feedback:
            register ^= polynomial
    return register


def first_difference(one: FramePlan, other: FramePlan) -> int:
    """Return the bit, counted from SOF, at which two frames differ: the one with a 1 there loses arbitration."""
    pairs = zip(one.levels, other.levels, strict=False)
    return next(bit for bit, (mine, yours) in enumerate(pairs) if mine != yours)


def _fast(fields: list[str], brs: bool) -> list[bool]:
    """Return whether each bit lasts a data bit: those behind BRS, up to the CRC delimiter."""
    if not brs:
        return [False] * len(fields)
    first, last = fields.index("BRS") + 1, fields.index("CRC delimiter")
    return [first <= index <= last for index in range(len(fields))]
