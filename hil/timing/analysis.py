"""A database's messages, analysed: which meet their deadlines at a bit rate, and the lowest rate at which all do."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from dbc.codec import CodecError
from dbc.compiler import Description, describe
from hil.errors import ScenarioError
from hil.timing.response_time import Errors, Message, Response, response_times, utilisation
from hil.wire.bits import INTERMISSION_BITS, worst_case_bits

NS_A_SECOND = 1_000_000_000
MS = 1_000_000
LOWEST_BITRATE, HIGHEST_BITRATE = 1_000, 1_000_000


def messages_of(path: Path, bit_ns: int, periods_ms: Mapping[str, float]) -> list[Message]:
    """Return the messages of a DBC file; raise ScenarioError naming those that nothing gives a period.

    periods_ms: by name, in place of the database's; "": of all that have none. A deadline is the period, behind which
    the next one would overwrite it.
    """
    try:
        described = describe(path)
    except (CodecError, OSError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ScenarioError(f"--dbc {path}: {reason}: name a DBC file, such as a run folder's arm.dbc") from None
    _refuse(described, periods_ms, path)
    return [_message(each, bit_ns, periods_ms) for each in described]


def _refuse(described: Sequence[Description], periods_ms: Mapping[str, float], path: Path) -> None:
    unknown = sorted(periods_ms.keys() - {each.name for each in described} - {""})
    if unknown:
        raise ScenarioError(f"--period {', '.join(unknown)}: no such message in {path}: see its BO_ lines")
    flexible = [each.name for each in described if each.fd]
    if flexible:
        raise ScenarioError(f"{path}: CAN FD is not analysed: leave {', '.join(flexible)} out")
    lacking = [each.name for each in described if not each.cycle_ms and each.name not in periods_ms]
    if lacking and "" not in periods_ms:
        raise ScenarioError(
            f"{path} has no GenMsgCycleTime for {', '.join(lacking)}: say how often each comes at most, "
            f"for example --period {lacking[0]}=10, or --period 1000 for all of them"
        )


def _message(each: Description, bit_ns: int, periods_ms: Mapping[str, float]) -> Message:
    period_ns = round((periods_ms.get(each.name) or each.cycle_ms or periods_ms[""]) * MS)
    bits = worst_case_bits(each.length, each.extended) + INTERMISSION_BITS
    return Message(each.name, each.identifier, period_ns, period_ns, bits * bit_ns, extended=each.extended)


def analyse(messages: Sequence[Message], bit_ns: int, errors: Errors | None = None) -> dict[str, Any]:
    """Return utilisation and the bound of every message, in seconds, ready for JSON; measured ones are None here."""
    found = response_times(messages, bit_ns, errors)
    return {
        "bitrate": NS_A_SECOND / bit_ns,
        "utilisation": float(utilisation(messages)),
        "meets_deadlines": all(each.meets_deadline for each in found),
        "lowest_bitrate": lowest_bitrate(messages, bit_ns, errors),
        "messages": [_row(each, bit_ns) for each in found],
    }


def _row(response: Response, bit_ns: int) -> dict[str, Any]:
    message = response.message
    return {
        "name": message.name,
        "identifier": message.identifier,
        "period_s": message.period_ns / NS_A_SECOND,
        "deadline_s": message.deadline_ns / NS_A_SECOND,
        "bits_worst": message.time_ns // bit_ns,
        "response_bound_s": None if response.bound_ns is None else response.bound_ns / NS_A_SECOND,
        "response_max_s": None,
        "meets_deadline": response.meets_deadline,
    }


def lowest_bitrate(messages: Sequence[Message], bit_ns: int, errors: Errors | None = None) -> int | None:
    """Return the lowest bit rate at which all deadlines are met, by bisection in bit/s; None if 1 Mbit/s is too slow.

    A longer bit makes every term of every bound longer, so there is one such rate. Bits are whole ns here.
    """

    def suffices(bit: int) -> bool:
        scaled = [replace(each, time_ns=each.time_ns // bit_ns * bit) for each in messages]
        return all(each.meets_deadline for each in response_times(scaled, bit, errors))

    shortest, longest = NS_A_SECOND // HIGHEST_BITRATE, NS_A_SECOND // LOWEST_BITRATE
    if not suffices(shortest):
        return None
    while longest - shortest > 1:
        middle = (shortest + longest) // 2
        shortest, longest = (middle, longest) if suffices(middle) else (shortest, middle)
    return -(-NS_A_SECOND // shortest)
