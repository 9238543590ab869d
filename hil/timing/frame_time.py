"""How long the longest frame of a message takes: classic, CAN FD, or as long as it was seen to be."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from hil.timing.response_time import Message
from hil.wire.bits import INTERMISSION_BITS, worst_case_bits
from hil.wire.fd_bits import fd_worst_case_bits
from hil.wire.identifier import FD_LENGTHS, longer_fd_length


def longest_bits(length: int, extended: bool, fd: bool) -> tuple[int, int]:
    """Return the bits of the longest frame at either rate, intermission included, the data rate used where fd.

    A length that no DLC of CAN FD says is padded to the next. ValueError for what one frame does not hold.
    """
    if not fd:
        return worst_case_bits(length, extended) + INTERMISSION_BITS, 0
    padded = length if length in FD_LENGTHS else longer_fd_length(length)
    nominal, data = fd_worst_case_bits(length if padded is None else padded, extended)
    return nominal + INTERMISSION_BITS, data


def bits_of(message: Message, bit_ns: int, data_bit_ns: int) -> int:
    """Return the bits of its longest frame at both rates together."""
    return (message.time_ns - message.data_bits * data_bit_ns) // bit_ns + message.data_bits


def at_rates(message: Message, bit_ns: int, data_bit_ns: int, new_bit_ns: int, new_data_bit_ns: int) -> Message:
    """Return the message at other bit times."""
    nominal = bits_of(message, bit_ns, data_bit_ns) - message.data_bits
    return replace(message, time_ns=nominal * new_bit_ns + message.data_bits * new_data_bit_ns)


def as_fd(messages: Sequence[Message], bit_ns: int, data_bit_ns: int) -> list[Message]:
    """Return the same messages as frames of CAN FD with the data rate used; their lengths must be known."""
    found = []
    for message in messages:
        if message.length is None:
            raise ValueError(f"{message.name}: its length is not known: give it, to see it as CAN FD")
        nominal, data = longest_bits(message.length, message.extended, True)
        found.append(replace(message, time_ns=nominal * bit_ns + data * data_bit_ns, data_bits=data))
    return found


def as_seen(messages: Sequence[Message], seen_bits: Mapping[str, int], bit_ns: int, data_bit_ns: int) -> list[Message]:
    """Return the messages as long as their longest frames were, SOF to EOF; those not seen are as long as they may be.

    Of an FD frame every bit that it was shorter counts as one at the data rate, the shorter one: still a bound.
    """
    found = []
    for message in messages:
        longest = bits_of(message, bit_ns, data_bit_ns)
        less = longest - seen_bits.get(message.name, longest - INTERMISSION_BITS) - INTERMISSION_BITS
        shorter_ns = less * (data_bit_ns if message.data_bits else bit_ns)
        found.append(replace(message, time_ns=message.time_ns - shorter_ns))
    return found
