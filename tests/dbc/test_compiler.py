"""What the compiler accepts, and the reason and cure it gives for what it does not."""

import pytest

from dbc.codec import CodecError
from dbc.compiler import compile_dbc

HEAD = 'VERSION ""\n\nNS_ :\n\nBS_:\n\nBU_: A B\n\n'


def compile_text(tmp_path, body, head=HEAD):
    path = tmp_path / "small.dbc"
    path.write_text(head + body)
    return compile_dbc(path)


def one_message(*signals, length=4, identifier=0x123):
    lines = [f' SG_ {signal} (1,0) [0|0] "" B' for signal in signals]
    return "\n".join([f"BO_ {identifier} M: {length} A", *lines]) + "\n"


def test_all_formats_in_the_order_of_their_bits(tmp_path):
    codec = compile_text(tmp_path, one_message("Late : 24|16@1-", "Word : 8|16@1+", "Byte : 0|8@1-", length=5))["M"]
    assert codec.signals == ("Byte", "Word", "Late")
    assert codec.pack(-1, 0x0102, -2) == bytes([0xFF, 0x02, 0x01, 0xFE, 0xFF])
    wide = compile_text(tmp_path, one_message("Low : 0|32@1-", "High : 32|32@1+", length=8))["M"]
    assert wide.unpack(wide.pack(-(1 << 31), (1 << 32) - 1)) == (-(1 << 31), (1 << 32) - 1)


def test_message_without_crc_is_not_protected(tmp_path):
    codec = compile_text(tmp_path, one_message("Byte : 0|8@1+", length=1))["M"]
    assert codec.pack(5) == b"\x05"
    assert codec.unpack(b"\xff") == (255,)


def test_empty_message(tmp_path):
    codec = compile_text(tmp_path, one_message(length=0))["M"]
    assert (codec.pack(), codec.unpack(b"")) == (b"", ())


REFUSED = {
    "big-endian": (one_message("S : 7|32@0+"), "M, signal S: big-endian: write @1"),
    "not byte-aligned": (one_message("S : 4|16@1+"), "M, signal S: begins at bit 4, inside a byte: move it"),
    "gap": (one_message("S : 0|8@1+", "T : 16|16@1+"), "M, signal T: begins at bit 16, not 8: the gap must be filled"),
    "gap before": (one_message("S : 16|16@1+"), "M, signal S: begins at bit 16, not 0: the gap must be filled"),
    "gap behind": (one_message("S : 0|16@1+"), "M, signal S: ends at bit 16 of 32: fill the rest or shorten"),
    "no signals": (one_message(), "M, signal .none.: ends at bit 0 of 32"),
    "overlap": (one_message("S : 0|16@1+", "T : 8|16@1+"), "M, signal T: begins at bit 8, not 16: it overlaps"),
    "too long": (one_message("S : 0|32@1+", length=3), "M, signal S: ends at bit 32 of 24: set the length to 4 bytes"),
    "multiplexer": (one_message("S M : 0|8@1+", "T m0 : 8|8@1+", length=2), "M, signal S: multiplexed: give each"),
    "width": (one_message("S : 0|24@1+", "T : 24|8@1+"), "M, signal S: 24 bits: use 8, 16 or 32"),
    "64 bits": (one_message("S : 0|64@1+", length=8), "M, signal S: 64 bits: use 8, 16 or 32"),
    "crc first": (
        one_message("Crc : 0|8@1+", "S : 8|8@1+", length=2),
        "M, signal Crc: must be the last byte, unsigned",
    ),
    "crc wide": (one_message("S : 0|16@1+", "Crc : 16|16@1+"), "M, signal Crc: must be the last byte, unsigned"),
    "crc signed": (
        one_message("S : 0|8@1+", "Crc : 8|8@1-", length=2),
        "M, signal Crc: must be the last byte, unsigned",
    ),
    "extended": (one_message("S : 0|32@1+", identifier=0x80000123), "M: identifier 0x123 has 29 bits"),
    "long frame": (one_message("S : 0|32@1+", "T : 32|32@1+", "U : 64|8@1+", length=9), "M: 9 bytes or CAN FD"),
    "float": (one_message("S : 0|32@1-") + "SIG_VALTYPE_ 291 S : 1;\n", "M, signal S: floating point: use a scaled"),
    "offset": (one_message("S : 0|32@1+").replace("(1,0)", "(1,-40)"), "M, signal S: offset -40: use a signed signal"),
    "same identifier": (
        one_message(length=0) + "BO_ 291 N: 0 A\n",
        "messages M and N share identifier 0x123: renumber",
    ),
    "same name": (one_message(length=0) + "BO_ 292 M: 0 A\n", "message M is defined twice: rename one"),
    "no version": (one_message(length=0), 'VERSION "A.2": write a number up to 255'),
    "no DBC": ("BO_ nonsense", "small.dbc is no readable database: DBC: .Invalid syntax at line 9"),
}


@pytest.mark.parametrize(("body", "reason"), REFUSED.values(), ids=REFUSED.keys())
def test_refused_with_message_signal_and_cure(tmp_path, body, reason):
    head = HEAD.replace('""', '"A.2"') if "VERSION" in reason else HEAD
    with pytest.raises(CodecError, match=reason):
        compile_text(tmp_path, body, head)


@pytest.mark.parametrize(("text", "version"), [("", 0), ("0", 0), ("7", 7), ("255", 255)])
def test_version_of_the_database(tmp_path, text, version):
    assert compile_text(tmp_path, one_message(length=0), HEAD.replace('""', f'"{text}"')).version == version
