"""A joint by chance: right and wrong parameters, damaged, lost and repeated frames, Stop, silence, saturation."""

from dbc.crc import crc16
from dbc.status import Status
from firmware_py.joint_cpu import INIT, READY, RUN, SIGNALS, TABLE_CRC, JointCPU
from firmware_py.words import Words
from tests.examples.transcript import Recorded

OF_A_RUN = ((22938, 1478, 17616, 13, 16384), (22938, 984, 23462, 14, 16384), (22938, 457, 21810, 15, 16384))
PERIODS_NS = (1_000_000, 2_000_000)


class Life:
    """The rest of the bus, for one joint; chance: random.Random."""

    def __init__(self, chance, codec):
        self.chance, self.codec = chance, codec
        joints = chance.randint(1, 6)
        self.number = number = chance.randint(1, joints)
        self.period_ns = chance.choice(PERIODS_NS)
        frame, self.place = ("AccelRef", "AccelRef_2")[(number - 1) // 3], (number - 1) % 3
        status = Status(codec, number, number, joints + 2, self.period_ns, chance.choice((0, 160_000, 900_000)))
        words, compute_ns = Words(16, len(SIGNALS)), chance.choice((0, 125_000))
        cpu = JointCPU(number, words, codec, crc16, status, (frame, self.place), self.period_ns, compute_ns)
        self.joint = Recorded(cpu)
        self.cpu = cpu
        self.encoder, self.parameter = codec[f"Encoder_{number}"], codec[f"Parameter_{number}"]
        self.accel_ref, self.stop = codec[frame], codec["Stop"]
        self.cycle = -chance.randint(5, 600)
        self.count = chance.randrange(0x10000)
        self.speed = 0
        self.drought = 0
        self.clean = chance.random() < 0.5
        self.timed = chance.random() < 0.5  # under `sync` silence is no time
        self.table, self.index = self._table(), 0

    def _table(self):
        """One of a run, or any, now and then one that the arithmetic cannot take."""
        chance = self.chance
        if chance.random() < 0.7:
            return chance.choice(OF_A_RUN)
        words = [chance.choice((chance.randint(-0x8000, 0x7FFF), 0, -0x8000, 0x7FFF)) for _ in range(3)]
        limit = -0x8000 if self.seldom(0.1) else chance.randint(-0x7FFF, 0x7FFF)
        return (*words, -1 if self.seldom(0.1) else chance.choice((0, 1, 15, 16, 31, 32, 33, 0x7FFF)), limit)

    def seldom(self, probability):
        """Something goes wrong, less often in a clean life."""
        return self.chance.random() < probability * (0.1 if self.clean else 1.0)

    def live(self, cycles):
        """Carry the joint through so many cycles."""
        for _ in range(cycles):
            self.cycle += 1
            if self.seldom(0.01) or (self.drought == 2 and self.chance.random() < 0.5):
                self.cycle += self.chance.randint(1, 4)
            self._one()

    def _one(self):
        chance, cpu = self.chance, self.cpu
        if self.timed and cpu.state == RUN and cpu.timer_ns < self.cycle * self.period_ns:
            self.joint.on_timer(cpu.timer_ns)
        if (cpu.state == INIT and chance.random() < 0.6) or self.seldom(0.02):
            self.parameter_frame()
        if cpu.state == RUN and self.seldom(0.005):
            self.drought = 4
        self.drought = max(0, self.drought - 1)
        waits = chance.random() < {INIT: 0.9, READY: 0.8}.get(cpu.state, 0.0)  # INIT: a run that is on without it
        if not (waits or self.drought or self.seldom(0.03)):
            self.reference_frame()
        if self.seldom(0.002):
            self.joint.on_frame(self.stop.identifier, self._damaged(self.stop.pack(chance.randint(0, 7))), self._now())
        self.encoder_frame()

    def encoder_frame(self):
        chance = self.chance
        self.speed = max(-900, min(900, self.speed + round(chance.gauss(0, chance.choice((1, 1, 1, 30))))))
        self.count = (self.count + self.speed) & 0xFFFF
        if self.seldom(0.01):
            self.count = chance.randrange(0x10000)
        data = self._damaged(self.encoder.pack(self.count, self.cycle & 0xFF))
        for _ in range(1 + self.seldom(0.02)):
            self.joint.on_frame(self.encoder.identifier, data, self._now())

    def _now(self):
        return self.cycle * self.period_ns + self.chance.choice((0, 140_000, 280_000, self.period_ns - 1))

    def _damaged(self, data):
        chance = self.chance
        if not self.seldom(0.02):
            return data
        if chance.random() < 0.3:
            return data[: chance.randrange(len(data))] if chance.random() < 0.7 else (data + bytes(8))[:8]
        bit = chance.randrange(8 * len(data))
        return bytes(byte ^ (1 << bit % 8 if at == bit // 8 else 0) for at, byte in enumerate(data))

    def parameter_frame(self):
        """The next entry of the table, or any; after the last, a new table."""
        chance = self.chance
        check = crc16(b"".join((value & 0xFFFF).to_bytes(2, "little") for value in self.table))
        entries = [*self.table, check - 0x10000 if check & 0x8000 else check]
        index, value = self.index, entries[self.index]
        self.index = (self.index + 1) % len(entries)
        if self.index == 0:
            self.table = self._table()
        if self.seldom(0.05):
            value = chance.randint(-32, 32)
        if self.seldom(0.02):
            index = chance.choice((TABLE_CRC, TABLE_CRC + 1, 255))
        data = self.parameter.pack(index, value, 7 if self.seldom(0.05) else self.codec.version)
        self.joint.store(self.parameter.identifier, self._damaged(data), self._now())

    def reference_frame(self):
        chance = self.chance
        values = [round(chance.gauss(0, chance.choice((50, 50, 8000)))) for _ in range(3)]
        cycle = self.cycle - 1 - (chance.randint(-2, 3) if self.seldom(0.03) else 0)
        data = self.accel_ref.pack(*(max(-0x8000, min(0x7FFF, value)) for value in values), cycle & 0xFF)
        self.joint.store(self.accel_ref.identifier, self._damaged(data), self._now())
