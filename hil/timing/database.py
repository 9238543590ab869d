"""The messages of a DBC file as the analysis needs them: lengths, senders, periods, jitter, deadlines."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path

from dbc.codec import CodecError
from dbc.compiler import Description, describe
from hil.errors import ScenarioError
from hil.timing.frame_time import longest_bits
from hil.timing.response_time import Message

MS = 1_000_000
ALL = "all"
"""In place of a node's name: every one."""


@dataclass(frozen=True)
class Given:
    """What is said of messages beside the database, in ns by name; "": of all others (of a period: that have none)."""

    periods: Mapping[str, int] = field(default_factory=dict)
    jitters: Mapping[str, int] = field(default_factory=dict)
    deadlines: Mapping[str, int] = field(default_factory=dict)


def messages_of(path: Path, bit_ns: int, data_bit_ns: int | None, given: Given) -> list[Message]:
    """Return the messages of a DBC file; raise ScenarioError for what cannot be analysed, by name.

    A deadline is the period, behind which the next one would overwrite it, unless given. No attribute in common use
    says deadlines or jitter.
    """
    described = _described(path)
    _refuse(described, data_bit_ns, given, path)
    return [_message(each, bit_ns, data_bit_ns, given, path) for each in described]


def _described(path: Path) -> list[Description]:
    try:
        described = describe(path)
    except (CodecError, OSError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ScenarioError(f"--dbc {path}: {reason}: name a DBC file, such as a run folder's arm.dbc") from None
    if not described:
        raise ScenarioError(f"--dbc {path} has no messages: name a DBC file with BO_ lines")
    return described


def _refuse(described: Sequence[Description], data_bit_ns: int | None, given: Given, path: Path) -> None:
    names = {each.name for each in described}
    options = {"--period": given.periods, "--jitter": given.jitters, "--deadline": given.deadlines}
    for option, values in options.items():
        unknown = sorted(values.keys() - names - {""})
        if unknown:
            raise ScenarioError(f"{option} {', '.join(unknown)}: no such message in {path}: see its BO_ lines")
    _refuse_twins(described, path)
    flexible = [each.name for each in described if each.fd]
    if flexible and data_bit_ns is None:
        raise ScenarioError(
            f"{path}: {', '.join(flexible)}: CAN FD: say how fast the data goes, for example --data-bitrate 2000000; "
            "as fast as the rest, where the bit rate is not switched"
        )
    lacking = [each.name for each in described if not each.distance_ms and each.name not in given.periods]
    if lacking and "" not in given.periods:
        raise ScenarioError(
            f"{path} has no GenMsgCycleTime for {', '.join(lacking)}: say how often each comes at most, "
            f"for example --period {lacking[0]}=10, or --period 1000 for all of them"
        )


def _refuse_twins(described: Sequence[Description], path: Path) -> None:
    """Refuse two messages of one name, or of one identifier."""
    names: set[str] = set()
    identifiers: dict[tuple[int, bool], str] = {}
    for each in described:
        other = identifiers.setdefault((each.identifier, each.extended), each.name)
        if each.name in names or other != each.name:
            raise ScenarioError(
                f"{path}: {other} and {each.name} share identifier {each.identifier:#x}: renumber one"
                if other != each.name
                else f"{path}: message {each.name} is there twice: rename one"
            )
        names.add(each.name)


def _message(each: Description, bit_ns: int, data_bit_ns: int | None, given: Given, path: Path) -> Message:
    try:
        nominal, data = longest_bits(each.length, each.extended, each.fd)
    except ValueError as error:
        raise ScenarioError(f"{path}: {each.name}: {error}; or is it CAN FD, by its VFrameFormat?") from None
    period_ns = _period_ns(each, given.periods, path)
    return Message(
        each.name,
        each.identifier,
        period_ns,
        given.deadlines.get(each.name, given.deadlines.get("", period_ns)),
        nominal * bit_ns + data * (data_bit_ns or bit_ns),
        given.jitters.get(each.name, given.jitters.get("", 0)),
        each.extended,
        each.senders,
        each.length,
        data,
    )


def _period_ns(each: Description, periods: Mapping[str, int], path: Path) -> int:
    if each.name in periods or not each.distance_ms:
        return periods.get(each.name) or periods[""]
    period_ns = Decimal(str(each.distance_ms)) * MS
    if period_ns != int(period_ns):
        raise ScenarioError(
            f"{path}: {each.name} comes every {each.distance_ms} ms, which is no whole number of ns: "
            f"round it, for example --period {each.name}={Decimal(int(period_ns)) / MS}"
        )
    return int(period_ns)


def fifo_nodes(messages: Iterable[Message], named: Iterable[str], path: Path) -> frozenset[str]:
    """Return the nodes that are named, or all; raise ScenarioError for one that sends nothing."""
    senders = frozenset[str]().union(*(each.senders for each in messages))
    chosen = frozenset(named)
    if ALL in chosen:
        return senders
    unknown = sorted(chosen - senders)
    if unknown:
        known = ", ".join(sorted(senders)) or "nobody is known to send"
        raise ScenarioError(f"--fifo {', '.join(unknown)}: sends nothing in {path}: take one of {known}, or {ALL}")
    return chosen
