"""A bus looked at before a run: fit for it, as `hil doctor` judges, and silent.

Error-passive is no reason to refuse: good frames mend it.
"""

import os
from collections.abc import Collection, Iterator

from dbc.codec import Codec
from hil.bus_errors import see_doctor
from hil.can_node import Place
from hil.can_port import CanPort
from hil.doctor import traffic
from hil.doctor.examine import check_rate, inside_one_process
from hil.doctor.finding import Finding
from hil.doctor.link import read_link
from hil.doctor.link_checks import bit_rate, controller, error_state, interface, up
from hil.errors import ChannelError
from hil.scenario import Scenario
from hil.wire import client
from hil.witness import sender_of

LISTEN_S = 0.3
"""300 cycles: who sends on our identifiers sends in each, or an idle rig's Sync every 0.25 s."""


def check_place(place: Place, scenario: Scenario) -> None:
    """Raise ChannelError for an interface on which no run can be: down, off, listening only, at another bit rate."""
    for found in _findings(place, scenario):
        if found.verdict == "bad" and found.value != "ERROR-PASSIVE":
            raise ChannelError(
                f"{place.interface} {place.channel}: {found.name}: {found.value} (wanted: {found.limit}): {found.cure}"
            )


def _findings(place: Place, scenario: Scenario) -> Iterator[Finding]:
    if place.interface == "hil":
        connection, welcome = client.join(place.channel, f"rate-{os.getpid()}", False, listen_only=True)
        connection.close()
        yield check_rate(welcome["bit_ns"], place.channel, scenario)
    elif place.interface == "virtual":
        yield inside_one_process(f"{place.interface} {place.channel}")
    elif place.interface == "socketcan" and (link := read_link(place.channel)) is not None:
        yield interface(link)
        yield up(link, scenario)
        if not link.bitless:
            yield bit_rate("bit rate", link, scenario)
            yield controller("controller", link, scenario)
            yield error_state("error state", link, scenario)


def check_silence(port: CanPort, place: Place, codec: Codec, external: Collection[str]) -> None:
    """Listen for LISTEN_S; raise ChannelError if somebody sends what only nodes of ours would send.

    external: nodes that somebody else plays, who may be there already: a DSP repeats Sync, and is answered. A Stop may
    be the end of another run.
    """
    heard = traffic.listen(port, codec, LISTEN_S)
    port.errors.counts.update(heard.errors)
    if heard.trouble:
        raise ChannelError(f"{place.interface} {place.channel}: {heard.trouble}: is the interface up?")
    ours = {name: count for name, count in heard.ours.items() if name != "Stop" and sender_of(name) not in external}
    if ours:
        said = ", ".join(
            f"{name} {codec[name].identifier:#05x} {count / heard.seconds:.0f} times a second"
            for name, count in ours.items()
        )
        cure = traffic.GOING_ON if "Sync" in ours else traffic.STRANGER
        doctor = see_doctor(place.interface, place.channel)
        raise ChannelError(f"{place.interface} {place.channel}: somebody else sends {said}: {cure}; {doctor}")
