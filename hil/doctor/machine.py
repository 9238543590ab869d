"""What a run by the wall clock needs of a machine: read, and judged."""

import ctypes
import errno
import fcntl
import os
import socket
import struct
import time
from array import array
from dataclasses import dataclass
from pathlib import Path

from hil.doctor.finding import Finding
from hil.real_time import MCL_CURRENT
from hil.scenario import Scenario
from hil.stamped_socket import RX_HARDWARE, RX_SOFTWARE
from hil.stamps import OTHER_CLOCK_NS

CPUS = Path("/sys/devices/system/cpu")
CLOCKSOURCE = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
SIOCETHTOOL, ETHTOOL_GET_TS_INFO = 0x8946, 0x41
"""Ref: linux/sockios.h, linux/ethtool.h."""
TICKS_A_PERIOD = 1000
"""How much finer than the period the clock should be."""
SLOW_CLOCKS = ("jiffies", "acpi_pm", "hpet")
LIMITS = (
    """printf '%s - rtprio 80\\n%s - memlock unlimited\\n' "$USER" "$USER" | sudo tee /etc/security/limits.d/hil.conf"""
)


@dataclass(frozen=True)
class Machine:
    """fifo, mlock: errno of asking for it, 0 if it was granted. governors: of the CPUs, none where nothing tells."""

    fifo: int
    mlock: int
    resolution_s: float
    clocksource: str
    governors: tuple[str, ...]


def read_machine() -> Machine:
    """Return what this machine grants this process; what was granted is given back at once."""
    return Machine(_fifo(), _mlock(), time.clock_getres(time.CLOCK_MONOTONIC), _text(CLOCKSOURCE), _governors())


def _fifo() -> int:
    before, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        os.sched_setscheduler(0, before, parameters)
    except OSError as error:
        return error.errno or errno.EPERM
    return 0


def _mlock() -> int:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(MCL_CURRENT):
        return ctypes.get_errno()
    libc.munlockall()
    return 0


def _governors() -> tuple[str, ...]:
    found = {_text(path) for path in CPUS.glob("cpu[0-9]*/cpufreq/scaling_governor")}
    return tuple(sorted(found - {""}))


def _text(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""


def read_stamps(channel: str) -> int | None:
    """Return the flags of the time stamps that an interface can give, None if it does not tell (`ethtool -T`)."""
    answer = array("B", struct.pack("=I", ETHTOOL_GET_TS_INFO) + bytes(60))
    request = struct.pack("16sP16x", channel.encode()[:15], answer.buffer_info()[0])
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
            fcntl.ioctl(asking, SIOCETHTOOL, request)
    except OSError:
        return None
    return int(struct.unpack_from("=II", answer)[1])


def read_family() -> int:
    """Return the errno of opening a CAN socket, 0 if this kernel has SocketCAN."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        return error.errno or errno.EAFNOSUPPORT
    except AttributeError:  # this Python was built without
        return errno.EAFNOSUPPORT
    return 0


def check_family(number: int) -> Finding:
    """Is there SocketCAN?"""
    if not number:
        return Finding("kernel", "SocketCAN", "SocketCAN", "ok")
    if number in (errno.EPERM, errno.EACCES):
        cure = "run as a user who may open CAN sockets; in a container, one that shares the host's network"
        return Finding("kernel", "CAN sockets are not permitted", "SocketCAN", "bad", cure)
    cure = "`sudo modprobe can_raw`; where there is no such module, take -i hil, which needs none"
    return Finding("kernel", "no SocketCAN", "SocketCAN", "bad", cure)


def check_stamps(flags: int | None, age_s: float | None) -> Finding:
    """Does the kernel stamp a frame when it comes, by the system's clock? age_s: of a fresh stamp, if a frame came."""
    limit = "by the kernel, on reception"
    if age_s is not None and abs(age_s) * 1e9 > OTHER_CLOCK_NS:
        cure = "its stamps are of another clock than the system's: set that clock, or take another driver"
        return Finding("time stamps", f"{age_s:.3g} s old when taken", limit, "bad", cure)
    age = "" if age_s is None else f", {age_s * 1e3:.1f} ms old when taken"
    if flags is None:
        return Finding("time stamps", f"not to be read{age}", limit, "unknown")
    if flags & RX_SOFTWARE:
        return Finding("time stamps", f"kernel{' and controller' * bool(flags & RX_HARDWARE)}{age}", limit, "ok")
    cure = "programs that wake up late stamp late: take a driver with software time stamps (`ethtool -T`)"
    return Finding("time stamps", f"none by the kernel{age}", limit, "warn", cure)


def check_machine(machine: Machine, scenario: Scenario) -> list[Finding]:
    """Return what there is to say of a machine; `sync` needs nothing of it."""
    return [fifo(machine), mlock(machine), clock(machine, scenario), governor(machine)]


def fifo(machine: Machine) -> Finding:
    """May a process have real-time priority?"""
    if not machine.fifo:
        return Finding("SCHED_FIFO", "permitted", "permitted, for the wall clock", "ok")
    cure = f"`{LIMITS}`, then log in anew; in a container --cap-add SYS_NICE"
    return Finding("SCHED_FIFO", os.strerror(machine.fifo), "permitted, for the wall clock", "warn", cure)


def mlock(machine: Machine) -> Finding:
    """May a process keep its memory from being paged out?"""
    if not machine.mlock:
        return Finding("mlock", "permitted", "permitted, for the wall clock", "ok")
    cure = f"`{LIMITS}`, then log in anew; in a container --ulimit memlock=-1"
    return Finding("mlock", os.strerror(machine.mlock), "permitted, for the wall clock", "warn", cure)


def clock(machine: Machine, scenario: Scenario) -> Finding:
    """Is the clock fine enough for the period, and quick to read?"""
    period_s = scenario.clock.period_s
    limit = f"{period_s / TICKS_A_PERIOD * 1e9:.0f} ns or finer, for a period of {period_s * 1e3:g} ms"
    value = f"{machine.resolution_s * 1e9:.0f} ns{f', {machine.clocksource}' * bool(machine.clocksource)}"
    if machine.resolution_s > period_s / TICKS_A_PERIOD:
        cure = "this kernel has no high-resolution timers: boot one with CONFIG_HIGH_RES_TIMERS, without highres=off"
        return Finding("clock", value, limit, "bad" if machine.resolution_s > period_s else "warn", cure)
    if machine.clocksource in SLOW_CLOCKS:
        cure = f"{machine.clocksource} is slow to read: `echo tsc | sudo tee {CLOCKSOURCE}`, where it is on offer"
        return Finding("clock", value, limit, "warn", cure)
    return Finding("clock", value, limit, "ok")


def governor(machine: Machine) -> Finding:
    """Does a CPU that sleeps most of a period wake up fast?"""
    if not machine.governors:
        return Finding(
            "CPU governor", "not to be read: a virtual machine, or a fixed frequency", "performance", "unknown"
        )
    value = ", ".join(machine.governors)
    if machine.governors == ("performance",):
        return Finding("CPU governor", value, "performance", "ok")
    return Finding("CPU governor", value, "performance", "warn", "sudo cpupower frequency-set -g performance")
