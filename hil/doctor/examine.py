"""Everything about a place, read and judged: which checks there are depends on the interface."""

import os

from dbc.compiler import load_arm
from hil.can_node import Place
from hil.can_port import CanPort
from hil.doctor import machine, traffic
from hil.doctor.finding import Finding
from hil.doctor.link import read_link
from hil.doctor.link_checks import CLAIMS, check_link, missing, no_claims
from hil.errors import ChannelError
from hil.scenario import Scenario
from hil.wire import client
from hil.wire.rates import NS_PER_S

WITHOUT_BITS = ("virtual", "udp_multicast")
"""Interfaces of python-can that move whole frames."""


def examine(place: Place, scenario: Scenario, listen_s: float) -> list[Finding]:
    """Return what there is to say of a place for runs of a scenario."""
    if place.interface == "hil":
        return _hil(place, scenario, listen_s)
    if place.interface == "socketcan":
        found = _socketcan(place, scenario, listen_s)
    else:
        found = _other(place, scenario, listen_s)
    return [*found, *machine.check_machine(machine.read_machine(), scenario)]


def _socketcan(place: Place, scenario: Scenario, listen_s: float) -> list[Finding]:
    family, link = machine.check_family(machine.read_family()), read_link(place.channel)
    if link is None:
        return [family, missing(place.channel)]
    found = [family, *check_link(link, scenario)]
    if not link.is_can:
        return found
    heard = _heard(place, link.up and family.verdict == "ok", listen_s)
    age_s = heard.stamp_age_s if isinstance(heard, traffic.Traffic) else None
    return [*found, machine.check_stamps(machine.read_stamps(link.name), age_s), *_judged(heard)]


def _heard(place: Place, possible: bool, listen_s: float) -> traffic.Traffic | ChannelError | None:
    """Return what was heard, why an interface could not be opened, or None where there was nothing to listen to."""
    if not possible:
        return None
    try:
        port = CanPort(place.interface, place.channel, None, **place.options)
    except ChannelError as error:
        return error
    try:
        return traffic.listen(port, load_arm(), listen_s)
    finally:
        port.close()


def _judged(heard: traffic.Traffic | ChannelError | None) -> list[Finding]:
    if heard is None:
        return [Finding("other traffic", "not listened to", "", "unknown", "first mend the above")]
    if isinstance(heard, ChannelError):
        return [Finding("socket", "it cannot be opened", "opens", "bad", str(heard))]
    return traffic.check_traffic(heard)


def _hil(place: Place, scenario: Scenario, listen_s: float) -> list[Finding]:
    """Return what there is to say of a bus in virtual time: its bits are exact, and it needs nothing of the machine."""
    try:
        connection, welcome = client.join(place.channel, f"doctor-{os.getpid()}", False, listen_only=True)
    except ChannelError as error:
        return [Finding("bus", f"no {place.channel}", "a running bus", "bad", f"{error}: `hil bus {place.channel}`")]
    connection.close()
    place = place._replace(options=place.options | {"listen_only": True, "error_frames": "all"})
    return [
        Finding("bus", f"{place.channel}, {welcome['fidelity']}", "a running bus", "ok"),
        check_rate(welcome["bit_ns"], place.channel, scenario),
        Finding(CLAIMS, "order, payloads, arbitration, exact bit times, in virtual time", "a bus with bits", "ok")
        if welcome["bit_ns"]
        else no_claims("a functional bus"),
        *_judged(_heard(place, True, listen_s)),
    ]


def check_rate(bit_ns: int, channel: str, scenario: Scenario) -> Finding:
    """Does a bus in virtual time run at the scenario's bit rate?"""
    limit = f"{scenario.bus.bitrate} bit/s, as bus.bitrate says"
    if not bit_ns:
        return Finding("bit rate", "none: functional, a frame takes no time", limit, "unknown", f"hil bus {channel}")
    value = f"{NS_PER_S / bit_ns:.0f} bit/s"
    if bit_ns == scenario.bit_ns:
        return Finding("bit rate", value, limit, "ok")
    return Finding("bit rate", value, limit, "bad", f"hil bus {channel} --bitrate {scenario.bus.bitrate}")


def inside_one_process(name: str) -> Finding:
    """Return what python-can's interface `virtual` comes to."""
    cure = "take -i udp_multicast, or -i hil: the nodes of a run are processes"
    return Finding("interface", f"{name} is inside one process", "one between processes", "bad", cure)


def _other(place: Place, scenario: Scenario, listen_s: float) -> list[Finding]:
    """Return what there is to say of python-can's other interfaces: what can be seen through its socket."""
    name = f"{place.interface} {place.channel}"
    if place.interface == "virtual":
        return [inside_one_process(name)]
    heard = _heard(place, True, listen_s)
    if isinstance(heard, ChannelError):
        return [Finding("interface", f"no {name}", "one that opens", "bad", str(heard))]
    found = [Finding("interface", name, "one that opens", "ok")]
    if place.interface in WITHOUT_BITS:
        found += [Finding("bit rate", f"none: {place.interface} moves whole frames", "", "unknown")]
        found += [no_claims(place.interface)]
    else:
        limit = f"{scenario.bus.bitrate} bit/s, as bus.bitrate says"
        cure = f"it is what was asked for: --bus-kwargs '{{\"bitrate\": {scenario.bus.bitrate}}}'"
        found += [Finding("bit rate", "not to be read", limit, "unknown", cure)]
        found += [
            Finding(each, "not to be read", "", "unknown", "see the adapter's own tool")
            for each in ("sample point", "controller", "error state", "error counters", "restart-ms", "txqueuelen")
        ]
    return found + _judged(heard)
