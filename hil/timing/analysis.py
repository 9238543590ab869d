"""Messages analysed: which meet their deadlines at a bit rate, and the lowest rate at which all do."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from hil.timing import search
from hil.timing.frame_time import as_fd, as_seen, at_rates, bits_of
from hil.timing.queues import queues
from hil.timing.response_time import Errors, Message, Response, meet_deadlines, response_times, utilisation
from hil.wire.rates import NS_PER_S


def analyse(
    messages: Sequence[Message],
    bit_ns: int,
    errors: Errors | None = None,
    *,
    data_bit_ns: int | None = None,
    fifo: Collection[str] = (),
    depth: int | None = None,
    actual_bits: Mapping[str, int] | None = None,
) -> dict[str, Any]:
    """Return utilisation and the bound of every message, in seconds, ready for JSON; measured ones are None here.

    data_bit_ns: of CAN FD; classic messages are bounded as such frames, too. depth: places in each transmit queue.
    actual_bits: the longest frame seen of each message, by name, SOF to EOF.
    """
    data_ns = data_bit_ns or bit_ns
    found = response_times(messages, bit_ns, errors, fifo)
    flexible = data_bit_ns is not None and not all(each.data_bits for each in messages)
    beside = as_fd(messages, bit_ns, data_ns) if flexible else None
    seen = None if actual_bits is None else as_seen(messages, actual_bits, bit_ns, data_ns)
    other = {
        "response_bound_fd_s": _bounds(beside, bit_ns, errors, fifo),
        "response_bound_actual_s": _bounds(seen, bit_ns, errors, fifo),
    }
    return {
        "bitrate": NS_PER_S / bit_ns,
        "data_bitrate": None if data_bit_ns is None else NS_PER_S / data_bit_ns,
        "utilisation": float(utilisation(messages)),
        "meets_deadlines": all(each.meets_deadline for each in found),
        "lowest_bitrate": lowest_bitrate(messages, bit_ns, errors, data_bit_ns=data_bit_ns, fifo=fifo),
        "queues": queues(found, depth),
        "messages": [
            _row(each, bits_of(each.message, bit_ns, data_ns))
            | {key: bounds.get(each.message.name) for key, bounds in other.items()}
            for each in found
        ],
    }


def _bounds(
    messages: Sequence[Message] | None, bit_ns: int, errors: Errors | None, fifo: Collection[str]
) -> dict[str, float | None]:
    """Return the bounds of messages in seconds, by name; nothing for none."""
    found = [] if messages is None else response_times(messages, bit_ns, errors, fifo)
    return {each.message.name: seconds(each.bound_ns) for each in found}


def _row(response: Response, bits: int) -> dict[str, Any]:
    message = response.message
    return {
        "name": message.name,
        "identifier": message.identifier,
        "period_s": message.period_ns / NS_PER_S,
        "jitter_s": message.jitter_ns / NS_PER_S,
        "deadline_s": message.deadline_ns / NS_PER_S,
        "bits_worst": bits,
        "response_bound_s": seconds(response.bound_ns),
        "response_max_s": None,
        "meets_deadline": response.meets_deadline,
        "unbounded": response.reason or None,
    }


def seconds(ns: float | None) -> float | None:
    """Return nanoseconds in seconds, nothing for nothing."""
    return None if ns is None else ns / NS_PER_S


def lowest_bitrate(
    messages: Sequence[Message],
    bit_ns: int,
    errors: Errors | None = None,
    *,
    data_bit_ns: int | None = None,
    fifo: Collection[str] = (),
) -> int | None:
    """Return the lowest bit rate at which all deadlines are met; None if 1 Mbit/s is too slow.

    A longer bit makes every term of every bound longer, so there is one such rate. The data
    rate of CAN FD stays what it is, for it is limited by other things, but is never below the other.
    """
    data_ns = data_bit_ns or bit_ns

    def holds(bit: int) -> bool:
        scaled = [at_rates(each, bit_ns, data_ns, bit, min(data_ns, bit)) for each in messages]
        return meet_deadlines(scaled, bit, errors, fifo)

    return search.lowest_bitrate(holds)
