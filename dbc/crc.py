"""The two checksums of the frames, by tables made from their polynomials.

Ref: SAE J1850 (CRC-8), ITU-T V.41 polynomial with preset ones, known as CRC-16/CCITT-FALSE. Both work most significant
bit first. Published check values over b"123456789": 0x4B and 0x29B1.
"""

CRC8_POLYNOMIAL = 0x1D
CRC8_PRESET = 0xFF
CRC8_INVERT = 0xFF
"""The register is inverted before it is sent."""

CRC16_POLYNOMIAL = 0x1021
CRC16_PRESET = 0xFFFF


def _entry(byte: int, polynomial: int, width: int) -> int:
    """Return what one byte at the top of a register of `width` bits does to it."""
    register = byte << width - 8
    for _ in range(8):
        carry = register >> width - 1
        register = register << 1 & (1 << width) - 1
        if carry:
            register ^= polynomial
    return register


CRC8_TABLE = bytes(_entry(byte, CRC8_POLYNOMIAL, 8) for byte in range(256))
_CRC16_TABLE = [_entry(byte, CRC16_POLYNOMIAL, 16) for byte in range(256)]

CRC8_RESIDUE = CRC8_TABLE[CRC8_INVERT]
"""The register after any data followed by its own CRC-8."""


def crc8_register(data: bytes, register: int = CRC8_PRESET) -> int:
    """Return the CRC-8 register after data, not yet inverted, so that more data may follow."""
    for byte in data:
        register = CRC8_TABLE[register ^ byte]
    return register


def crc8(data: bytes) -> int:
    """Return the CRC-8 SAE J1850 of data."""
    return crc8_register(data) ^ CRC8_INVERT


def frame_crc8(identifier: int, payload: bytes) -> int:
    """Return the last byte of a protected frame: the CRC-8 over the identifier, high byte first, and the payload."""
    return crc8(identifier.to_bytes(2, "big") + payload)


def crc16(data: bytes) -> int:
    """Return the CRC-16/CCITT-FALSE of data."""
    register = CRC16_PRESET
    for byte in data:
        register = (register << 8 & 0xFFFF) ^ _CRC16_TABLE[register >> 8 ^ byte]
    return register
