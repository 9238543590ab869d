"""A CAN interface of Linux, judged: is it there, up, at the scenario's bit rate, in good health?

Every check is a function from what was read to a Finding. Ref: CiA DS-301 V4.02, table of bit timings (sample point at
75 % for 1 Mbit/s, 80 % for 800 kbit/s, 87.5 % below), which Linux chooses by itself (drivers/net/can/dev/
calc_bittiming.c); CiA 301 V4.2.0 allows 75 to 90 % from 800 kbit/s on, 85 to 90 % below. ISO 11898-1 (error states).
"""

from collections.abc import Callable

from hil.bus_errors import WIRES
from hil.constants import cycle_frames
from hil.doctor.finding import Finding, Verdict
from hil.doctor.link import OVERRUNS, RECEIVE_DROPPED, SEND_DROPPED, Link
from hil.scenario import Scenario
from hil.wire.bits import worst_case_bits

RESTART_MS = 100
SHORTEST_QUEUE = 10
"""Linux's default for a CAN interface; enough for the frames of a cycle of up to three joints."""
LONGEST_QUEUE = 100
WARNING, PASSIVE = 96, 128
"""Error counters from which on a controller warns, and is error-passive."""
STATES: dict[str, Verdict] = {
    "ERROR-ACTIVE": "ok",
    "ERROR-WARNING": "warn",
    "ERROR-PASSIVE": "bad",
    "BUS-OFF": "bad",
    "STOPPED": "bad",
    "SLEEPING": "bad",
}
HARMFUL_MODES: dict[str, tuple[Verdict, str]] = {
    "LISTEN-ONLY": ("bad", "it neither sends nor acknowledges"),
    "LOOPBACK": ("bad", "it hears itself alone"),
    "ONE-SHOT": ("bad", "a frame that loses arbitration is lost"),
    "PRESUME-ACK": ("warn", "a frame that nobody takes counts as sent"),
}
LOST = {
    RECEIVE_DROPPED: "the machine had no memory or time for a frame: leave it less to do",
    OVERRUNS: "the machine answered the controller's interrupt too late: leave it less to do, or take a larger FIFO",
    SEND_DROPPED: "the interface went down, or bus-off, with frames to send",
}
FAST = 800_000
"""Bit rate from which on CiA 301 allows earlier sample points."""
CLAIMS = "what a run here shows"


def check_link(link: Link, scenario: Scenario) -> list[Finding]:
    """Return what there is to say of an interface that is there."""
    found = [interface(link)]
    if link.is_can:
        found.append(up(link, scenario))
        for name, check in OF_BITS.items():
            bitless = Finding(name, f"none: {link.kind} moves whole frames", "", "unknown")
            found.append(bitless if link.bitless else check(name, link, scenario))
        found += [queue(link, scenario), lost(link), claims(link)]
    return found


def missing(name: str) -> Finding:
    """Return what an interface comes to that is not there."""
    virtual = name if name.startswith("vcan") else "vcan0"
    cure = (
        "`ip link` lists the interfaces; is the adapter plugged in, its driver loaded (`dmesg | grep -i can`)? "
        f"A virtual one: `sudo modprobe vcan; sudo ip link add dev {virtual} type vcan; sudo ip link set {virtual} up`"
    )
    return Finding("interface", f"no {name}", "a CAN interface", "bad", cure)


def interface(link: Link) -> Finding:
    """Is it a CAN interface, and what could be asked about it?"""
    if not link.is_can:
        return Finding(
            "interface", f"{link.name} is not CAN", "a CAN interface", "bad", "`ip link` lists those that are: link/can"
        )
    if link.source != "ip":
        value = f"{link.name}, of which only /sys/class/net tells"
        return Finding("interface", value, "a CAN interface", "unknown", link.source)
    return Finding("interface", f"{link.name} ({link.kind or 'can'})", "a CAN interface", "ok")


def up(link: Link, scenario: Scenario) -> Finding:
    """Is it up?"""
    if link.up:
        return Finding("up", "up", "up", "ok")
    cure = _up(link) if link.bitless or link.bitrate else set_up(link, scenario)
    return Finding("up", "down", "up", "bad", cure)


def set_up(link: Link, scenario: Scenario) -> str:
    """Return the commands that set an interface up for a scenario."""
    timing = f"bitrate {scenario.bus.bitrate} sample-point {recommended_point(scenario.bus.bitrate):g}"
    return _again(link, f"{timing} restart-ms {RESTART_MS}")


def _again(link: Link, settings: str) -> str:
    """Return the commands that change settings, which only an interface that is down takes."""
    return f"sudo ip link set {link.name} down; sudo ip link set {link.name} type can {settings}; {_up(link)}"


def _up(link: Link) -> str:
    return f"sudo ip link set {link.name} up"


def _unread(name: str, limit: str, link: Link) -> Finding:
    """Return what a check comes to whose value the interface does not tell."""
    cure = "its driver does not tell: see the adapter's manual" if link.source == "ip" else link.source
    return Finding(name, "not to be read", limit, "unknown", cure)


def bit_rate(name: str, link: Link, scenario: Scenario) -> Finding:
    """Is it the scenario's?"""
    limit = f"{scenario.bus.bitrate} bit/s, as bus.bitrate says"
    if link.bitrate == scenario.bus.bitrate:
        return Finding(name, f"{link.bitrate} bit/s", limit, "ok")
    if link.bitrate:
        return Finding(name, f"{link.bitrate} bit/s", limit, "bad", set_up(link, scenario))
    if link.kind == "can" and link.source == "ip":
        return Finding(name, "not set", limit, "bad", set_up(link, scenario))
    return _unread(name, limit, link)


def recommended_point(bitrate: int) -> float:
    """Return the sample point to ask for: at 1 Mbit/s a little behind DS-301's, well inside CiA 301's range."""
    return 0.8 if bitrate >= FAST else 0.875


def allowed_points(bitrate: int) -> tuple[float, float]:
    """Return the first and the last sample point that CiA 301 V4.2.0 allows."""
    return (0.75, 0.9) if bitrate >= FAST else (0.85, 0.9)


def sample_point(name: str, link: Link, scenario: Scenario) -> Finding:
    """Does it sample where others on the bus do?"""
    first, last = allowed_points(link.bitrate or scenario.bus.bitrate)
    limit = f"{first:.1%} to {last:.1%} (CiA 301), the same in all nodes"
    if not link.sample_point:
        return _unread(name, limit, link)
    within = first <= link.sample_point <= last
    cure = "" if within else set_up(link, scenario)
    return Finding(name, f"{link.sample_point:.1%}", limit, "ok" if within else "warn", cure)


def controller(name: str, link: Link, _scenario: Scenario) -> Finding:
    """Does the controller take part in the bus?"""
    limit = "sends, acknowledges, repeats"
    if link.modes is None:
        return _unread(name, limit, link)
    harmful = [mode for mode in link.modes if mode in HARMFUL_MODES]
    if not harmful:
        return Finding(name, ", ".join(link.modes) or "normal", limit, "ok")
    value = "; ".join(f"{mode}: {HARMFUL_MODES[mode][1]}" for mode in harmful)
    verdict: Verdict = "bad" if any(HARMFUL_MODES[mode][0] == "bad" for mode in harmful) else "warn"
    return Finding(name, value, limit, verdict, _again(link, " ".join(f"{mode.lower()} off" for mode in harmful)))


def error_state(name: str, link: Link, _scenario: Scenario) -> Finding:
    """Is the controller on the bus, and error-active?"""
    if link.state is None:
        return _unread(name, "ERROR-ACTIVE", link)
    verdict = STATES.get(link.state, "unknown")
    return Finding(name, link.state, "ERROR-ACTIVE", verdict, "" if verdict == "ok" else state_cure(link))


def state_cure(link: Link) -> str:
    """Return how a controller comes back to error-active."""
    if link.state in ("STOPPED", "SLEEPING"):
        return _up(link)
    if link.state == "BUS-OFF":
        return f"{WIRES}; then `sudo ip link set {link.name} down; {_up(link)}`"
    return f"{WIRES}; a node that is alone gets no acknowledgement, and becomes error-passive by that"


def error_counters(name: str, link: Link, _scenario: Scenario) -> Finding:
    """How near is the controller to leaving the bus, and has it left before?"""
    limit = f"0; it warns at {WARNING}, is passive at {PASSIVE}, off at 256"
    happened = {event: count for event, count in link.history.items() if count and event != "arbitration_lost"}
    past = "".join(f", {event.replace('_', ' ')} {count} times" for event, count in happened.items())
    if link.tec is None or link.rec is None:
        unread = _unread(name, limit, link)
        return unread._replace(value=unread.value + past, verdict="warn", cure=state_cure(link)) if past else unread
    value = f"transmit {link.tec}, receive {link.rec}{past}"
    if max(link.tec, link.rec) >= PASSIVE:
        return Finding(name, value, limit, "bad", state_cure(link))
    if link.tec or link.rec or past:
        return Finding(name, value, limit, "warn", f"good frames lower the counters; if they grow, {state_cure(link)}")
    return Finding(name, value, limit, "ok")


def restart(name: str, link: Link, _scenario: Scenario) -> Finding:
    """Does it come back from bus-off by itself?"""
    limit = "above 0: back from bus-off by itself"
    if link.restart_ms is None:
        return _unread(name, limit, link)
    if link.restart_ms:
        return Finding(name, f"{link.restart_ms} ms", limit, "ok")
    return Finding(name, "0: it stays off", limit, "warn", _again(link, f"restart-ms {RESTART_MS}"))


OF_BITS: dict[str, Callable[[str, Link, Scenario], Finding]] = {
    "bit rate": bit_rate,
    "sample point": sample_point,
    "controller": controller,
    "error state": error_state,
    "error counters": error_counters,
    "restart-ms": restart,
}
"""Checks of what only an interface with bits has."""


def queue(link: Link, scenario: Scenario) -> Finding:
    """Do the frames of a cycle fit into the device's queue, and how long may one wait in it?"""
    frames = cycle_frames(scenario.joints)
    least = max(SHORTEST_QUEUE, len(frames))
    limit = f"{least} to {LONGEST_QUEUE} frames: those of a cycle, and little more"
    if link.bitless:
        return Finding("txqueuelen", "not in use: a frame is there at once", limit, "unknown")
    if link.txqueuelen is None:
        return _unread("txqueuelen", limit, link)
    longest_ms = link.txqueuelen * worst_case_bits(max(frames.values())) * 1e3 / scenario.bus.bitrate
    value = f"{link.txqueuelen} frames, up to {longest_ms:.1f} ms"
    fits = least <= link.txqueuelen <= LONGEST_QUEUE
    cure = "" if fits else f"sudo ip link set {link.name} txqueuelen {least}"
    return Finding("txqueuelen", value, limit, "ok" if fits else "warn", cure)


def lost(link: Link) -> Finding:
    """Has the interface lost frames, since it was made?"""
    causes = [cause for cause, count in link.lost.items() if count]
    if not causes:
        return Finding("lost frames", "0", "0", "ok")
    value = ", ".join(f"{cause} {link.lost[cause]}" for cause in causes)
    return Finding("lost frames", value, "0", "warn", "if it grows: " + "; ".join(LOST[cause] for cause in causes))


def claims(link: Link) -> Finding:
    """What may be claimed of a run here?"""
    if link.bitless:
        return no_claims(link.name)
    return Finding(CLAIMS, "order, payloads, arbitration, bus load", "a bus with bits", "ok")


def no_claims(what: str) -> Finding:
    """Return what may not be claimed on something that is no bus."""
    value = f"order and payloads alone: {what} has no bit rate, no arbitration, no error state"
    cure = "what is timed here proves nothing about a bus: take a real interface, or -i hil, whose bits are exact"
    return Finding(CLAIMS, value, "a bus with bits", "unknown", cure)
