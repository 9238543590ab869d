"""The C core as a node of the rig: your firmware in virtual time, before there is a board.

    make -C examples/joint_c
    hil run --inline --set joint2.cpu=examples.joint_c.node:CJoint

The library is loaded from build/ beside this file, or from where HIL_JOINT_LIBRARY says.
"""

import ctypes
import os
from pathlib import Path

LIBRARY = Path(__file__).parent / "build" / "libjoint.so"
NO_TIMER = -(1 << 63)
SIGNALS = ("w", "dw", "KB*dw", "d", "i", "i-d")
FAULTS = ("", "encoder lost", "reference lost", "parameters", "stopped", "", "", "node not ready")


class Law(ctypes.Structure):
    """struct joint_law."""

    _fields_ = (
        ("saturations", ctypes.c_uint32 * len(SIGNALS)),
        ("d", ctypes.c_int32),
        ("count_prev", ctypes.c_uint16),
        ("w_prev", ctypes.c_int16),
        ("table", ctypes.c_int16 * 5),
    )


class Head(ctypes.Structure):
    """struct joint, as far as a report needs it."""

    _fields_ = (
        ("law", Law),
        ("crc_errors", ctypes.c_uint32),
        ("strikes", ctypes.c_uint32),
        ("missed_encoders", ctypes.c_uint32),
        ("repeated_encoders", ctypes.c_uint32),
        ("skipped_status", ctypes.c_uint32),
        ("cycles", ctypes.c_uint32),
        ("state", ctypes.c_uint8),
        ("fault", ctypes.c_uint8),
        ("finished", ctypes.c_bool),
    )


class Send(ctypes.Structure):
    """struct joint_send."""

    _fields_ = (
        ("delay_ns", ctypes.c_int64),
        ("id", ctypes.c_uint32),
        ("length", ctypes.c_uint8),
        ("data", ctypes.c_uint8 * 8),
    )


class Out(ctypes.Structure):
    """struct joint_out."""

    _fields_ = (
        ("busy_ns", ctypes.c_int64),
        ("timer_ns", ctypes.c_int64),
        ("sends", ctypes.c_int32),
        ("send", Send * 4),
    )


class CJoint:
    """Built and called as firmware_py.joint_cpu.JointCPU is; all it does is done by the library."""

    def __init__(self, number, _words, codec, _crc16, status, reference, period_ns, compute_ns):
        path = Path(os.environ.get("HIL_JOINT_LIBRARY", LIBRARY))
        if not path.exists():
            raise FileNotFoundError(f"{path} is not there: make -C {Path(__file__).parent}")
        self.library = ctypes.CDLL(str(path))
        self.memory = ctypes.create_string_buffer(self.library.joint_size())
        self.head = Head.from_buffer(self.memory)
        self.out = Out()
        self.name = f"joint{number}"
        self.wakes_on = (codec[f"Encoder_{number}"].identifier, codec["Stop"].identifier)
        self.stores = (codec[reference[0]].identifier, codec[f"Parameter_{number}"].identifier)
        times = [ctypes.c_int64(ns) for ns in (period_ns, status.tail_ns, compute_ns)]
        self.library.joint_init(self.memory, number, status.turns - 2, *times)

    @property
    def finished(self):
        """Whether its part in the run is over."""
        return self.head.finished

    def on_start(self, _now_ns):
        """Wait for the set-up."""
        return 0, None, []

    def store(self, identifier, data, _at_ns):
        """Keep AccelRef or Parameter."""
        self.library.joint_store(self.memory, identifier, data, len(data))

    def on_frame(self, identifier, data, now_ns):
        """Answer Encoder or Stop."""
        out = ctypes.byref(self.out)
        self.library.joint_frame(self.memory, identifier, data, len(data), ctypes.c_int64(now_ns), out)
        return reaction(self.out)

    def on_timer(self, _now_ns):
        """Three Encoder frames in a row are missing."""
        self.library.joint_timer(self.memory, ctypes.byref(self.out))
        return reaction(self.out)

    def report(self):
        """Counters of the emulated system, by cause."""
        return report(self.head)


def reaction(out):
    """Return struct joint_out as what a node answers."""
    sends = [(each.delay_ns, each.id, bytes(each.data[: each.length])) for each in out.send[: out.sends]]
    return out.busy_ns, None if out.timer_ns == NO_TIMER else out.timer_ns, sends


def report(head):
    """Return the counters of struct joint as a node reports them."""
    return {
        "fault": FAULTS[head.fault],
        "skipped_status": head.skipped_status,
        "crc_errors": head.crc_errors,
        "strikes": head.strikes,
        "missed_encoders": head.missed_encoders,
        "repeated_encoders": head.repeated_encoders,
        "saturations": dict(zip(SIGNALS, head.law.saturations, strict=True)),
    }
