"""The joint's CPU, firmware_py/joint_cpu.py as it stands, made from what board.py has written into settings.py."""

import settings

from dbc.codec import Codec
from dbc.crc import crc16
from dbc.status import Status
from firmware_py.joint_cpu import JointCPU
from firmware_py.words import Words


def make_joint():
    """Return the joint at the beginning of its life."""
    codec = Codec(settings.MESSAGES, settings.VERSION)
    status = Status(codec, settings.NUMBER, settings.TURN, settings.TURNS, settings.PERIOD_NS, settings.TAIL_NS)
    times_ns = settings.PERIOD_NS, settings.COMPUTE_NS
    return JointCPU(settings.NUMBER, Words(*settings.WORDS), codec, crc16, status, settings.REFERENCE, *times_ns)
