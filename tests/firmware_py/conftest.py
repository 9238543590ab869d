"""What the firmware's tests share: the codec, the paper's scenario, joints on a bus of one's own."""

from types import SimpleNamespace

import pytest

from dbc.compiler import load_arm
from dbc.crc import crc16
from dbc.status import Status
from firmware_py.joint_cpu import SIGNALS, TABLE_CRC, JointCPU
from firmware_py.words import Words
from hil.constants import parameter_table
from hil.scenario_file import load

T_NS = 1_000_000
COMPUTE_NS = 125_000
NODES = 5


class Bench:
    """Plays the rest of the bus to one joint CPU and keeps what it answers, by frame name."""

    def __init__(self, codec, number, table, words, make_cpu=JointCPU):
        self.codec = codec
        self.number = number
        self.table = list(table)
        self.words = words
        status = Status(codec, number, number, NODES, T_NS, 160_000)
        self.cpu = make_cpu(number, words, codec, crc16, status, ("AccelRef", number - 1), T_NS, COMPUTE_NS)
        self.timer_ns = None
        self.busy_ns = None
        self.sends = []
        self.cpu.on_start(-200 * T_NS)

    def message(self, name):
        return self.codec[name if name in ("AccelRef", "Stop") else f"{name}_{self.number}"]

    def _take(self, reaction):
        self.busy_ns, self.timer_ns, self.sends = reaction
        answers = []
        for delay_ns, identifier, data in self.sends:
            message = self.codec.by_identifier[identifier]
            answers.append((message.name.split("_")[0], delay_ns, message.unpack(data)))
        return answers

    def reference(self, cycle, *values, corrupt=False):
        """Store AccelRef of a cycle."""
        message = self.message("AccelRef")
        data = bytearray(message.pack(*values, cycle & 0xFF))
        data[0] ^= corrupt
        self.cpu.store(message.identifier, bytes(data), cycle * T_NS + 830_000)

    def send_parameter(self, index, value, version=1, corrupt=False):
        """Store a Parameter frame."""
        message = self.message("Parameter")
        data = bytearray(message.pack(index, value, version))
        data[1] ^= corrupt
        self.cpu.store(message.identifier, bytes(data), 0)

    def encoder(self, cycle, count, corrupt=False):
        """Send Encoder of a cycle; return the answers as (frame, delay, fields)."""
        message = self.message("Encoder")
        data = bytearray(message.pack(count & 0xFFFF, cycle & 0xFF))
        data[0] ^= corrupt
        return self._take(self.cpu.on_frame(message.identifier, bytes(data), cycle * T_NS + 140_000))

    def stop(self, reason, now_ns=0):
        message = self.message("Stop")
        return self._take(self.cpu.on_frame(message.identifier, message.pack(reason), now_ns))

    def timer(self):
        return self._take(self.cpu.on_timer(self.timer_ns))

    def current(self, answers):
        """Return (reference, estimate, cycle) of the one Current frame among the answers."""
        (fields,) = (fields for name, _, fields in answers if name == "Current")
        return fields

    def set_up(self, first_cycle=-20):
        """Write the table and its CRC, one entry a cycle."""
        check = crc16(b"".join((value & 0xFFFF).to_bytes(2, "little") for value in self.table))
        for index, value in enumerate([*self.table, check - 0x10000 if check & 0x8000 else check]):
            self.send_parameter(index, value)
            self.encoder(first_cycle + index, 0)

    def start(self, first=(0, 0, 0), count=0):
        """Set up, then enter run at cycle 0; return the answers of that cycle."""
        self.set_up()
        self.encoder(-1, count)
        self.reference(-1, *first)
        return self.encoder(0, count)


@pytest.fixture(scope="session")
def codec():
    return load_arm()


@pytest.fixture(scope="session")
def paper_joint():
    return load("paper-joint")


@pytest.fixture(scope="session")
def tables(codec, paper_joint):
    """KA, KB, KJ, shift, limit of joints 1 to 3."""
    return tuple(parameter_table(paper_joint, n, codec) for n in (1, 2, 3))


@pytest.fixture(scope="session")
def make_bench(codec, tables):
    """Return a function (joint number, words, table, class of the CPU) -> Bench."""

    def make(number=1, words=None, table=None, make_cpu=JointCPU):
        words = Words(16, len(SIGNALS)) if words is None else words
        return Bench(codec, number, tables[number - 1] if table is None else table, words, make_cpu)

    return make


@pytest.fixture
def bench(make_bench):
    return make_bench()


@pytest.fixture
def bus():
    """The numbers of the bench's bus."""
    return SimpleNamespace(T_ns=T_NS, compute_ns=COMPUTE_NS, table_crc=TABLE_CRC)
