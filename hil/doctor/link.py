"""A CAN interface as the kernel describes it: by `ip -json`, or by /sys/class/net where iproute2 is missing.

Neither needs a privilege. Ref: iproute2, ip/iplink_can.c (can_print_opt, can_print_xstats); linux/can/netlink.h.
"""

import json
import os
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

SYSFS = Path("/sys/class/net")
IP_S = 5.0
"""Wall time after which `ip` is not waited for any longer."""
IP_FLAGS = ("-json", "-details", "-statistics")
ARPHRD_CAN = 280
IFF_UP = 1
RECEIVE_DROPPED, OVERRUNS, SEND_DROPPED = "received, dropped", "receive FIFO overruns", "sent, dropped"
BITLESS = ("vcan", "vxcan")
"""Kinds of interfaces that move whole frames: no bits, no arbitration, no acknowledgement, no error state."""


@dataclass(frozen=True)
class Link:
    """One interface; None is what its source does not say.

    source: what was read. kind: of device: can, vcan, vxcan, virtual (of software, more is not known). tec, rec: error
    counters. modes: of the controller. history: error events, lost: frames lost, by name, since the interface was made.
    """

    name: str
    source: str
    kind: str
    is_can: bool
    up: bool
    txqueuelen: int | None
    bitrate: int | None = None
    sample_point: float | None = None
    restart_ms: int | None = None
    modes: tuple[str, ...] | None = None
    state: str | None = None
    tec: int | None = None
    rec: int | None = None
    history: Mapping[str, int] = field(default_factory=dict)
    lost: Mapping[str, int] = field(default_factory=dict)

    @property
    def bitless(self) -> bool:
        """Whether it moves whole frames, without bits."""
        return self.kind in (*BITLESS, "virtual")


def read_link(name: str) -> Link | None:
    """Return an interface of this machine, None if there is none of that name."""
    folder = SYSFS / name
    if "/" in name or name in ("", ".", "..") or not folder.exists():
        return None
    text, trouble = _ask_ip(name)
    if text is not None:
        try:
            return from_ip(text)
        except (ValueError, TypeError, LookupError, AttributeError):
            trouble = "what `ip -json` says is not understood: update iproute2"
    return from_sysfs(folder, trouble)


def _ask_ip(name: str) -> tuple[str | None, str]:
    """Return what `ip` says, or why it says nothing."""
    program = shutil.which("ip", path=f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin")
    if program is None:
        return None, "iproute2 is missing: sudo apt install iproute2"
    command = [program, *IP_FLAGS, "link", "show", "dev", name]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, timeout=IP_S, check=True)
    except (OSError, subprocess.SubprocessError) as error:
        return None, f"`{' '.join(command)}` failed: {error}"
    return answer.stdout, ""


def from_ip(text: str) -> Link:
    """Return the interface that `ip -json -details -statistics link show` describes."""
    (told,) = json.loads(text)
    info = told.get("linkinfo", {})
    data = info.get("info_data", {})
    timing = data.get("bittiming", {})
    counters = data.get("berr_counter", {})
    point = timing.get("sample_point")
    configured = info.get("info_kind") == "can"
    return Link(
        name=told["ifname"],
        source="ip",
        kind=info.get("info_kind", ""),
        is_can=told.get("link_type") == "can",
        up="UP" in told["flags"],
        txqueuelen=told.get("txqlen"),
        bitrate=timing.get("bitrate", data.get("bittiming_bitrate")),
        sample_point=None if point is None else float(point),
        restart_ms=data.get("restart_ms"),
        modes=tuple(data.get("ctrlmode", ())) if configured else None,
        state=data.get("state"),
        tec=counters.get("tx"),
        rec=counters.get("rx"),
        history=dict(info.get("info_xstats", {})),
        lost=_lost(told.get("stats64", told.get("stats", {}))),
    )


def _lost(statistics: Mapping[str, Any]) -> dict[str, int]:
    received, sent = statistics.get("rx", {}), statistics.get("tx", {})
    return {
        RECEIVE_DROPPED: received.get("dropped", 0),
        OVERRUNS: received.get("over_errors", 0),
        SEND_DROPPED: sent.get("dropped", 0),
    }


def from_sysfs(folder: Path, trouble: str) -> Link:
    """Return what a folder of /sys/class/net says of an interface; trouble: why it is asked and not `ip`."""
    virtual = "virtual" in folder.resolve().parts
    is_can = _number(folder / "type") == ARPHRD_CAN
    return Link(
        name=folder.name,
        source=trouble,
        kind="virtual" if virtual else "can" if is_can else "",
        is_can=is_can,
        up=bool((_number(folder / "flags") or 0) & IFF_UP),
        txqueuelen=_number(folder / "tx_queue_len"),
        lost={
            RECEIVE_DROPPED: _number(folder / "statistics" / "rx_dropped") or 0,
            OVERRUNS: _number(folder / "statistics" / "rx_over_errors") or 0,
            SEND_DROPPED: _number(folder / "statistics" / "tx_dropped") or 0,
        },
    )


def _number(path: Path) -> int | None:
    try:
        return int(path.read_text(), 0)
    except (OSError, ValueError):
        return None
