"""The plant as a node: latches the encoders at exactly kT, lets each current act from the end of its frame.

One wake-up a period: at kT it carries the arm through the period that ends there, with every Current stored since at
its own instant, then sends Encoder k. The brakes release at the cycle after the first AccelRef, which is cycle 0, and
engage by Stop. Where a joint gives no Current for three periods in a row, nobody controls it any more, whatever the
reason: the brakes engage, and the plant says so by Stop.
"""

from collections.abc import Sequence
from itertools import chain
from typing import Any

from dbc.codec import Codec
from dbc.status import Status
from plant.contact import Touch
from plant.dead_time import DeadTime
from plant.external import ExternalTorque, changes
from plant.robot import Robot

INIT, READY, RUN, FAULT = 0, 1, 2, 3
NO_FAULT, STOPPED, CURRENT_LOST = 0, 4, 8
STOP_CURRENT_LOST = 8
MISSES_TO_FAULT = 3
AWAITED = (1 << 128) - 1
"""Cycles that a Current may be late by: half of what its byte tells apart."""

Reaction = tuple[int, int | None, list[tuple[int, int, bytes]]]


class Plant:
    """The robot on the bus.

    payloads: (mass on the hand in kg, from ns on); action_delay_ns: for each joint, the least time
    after its cycle's start at which a current acts (0 where the bus itself takes time); one that comes later in its
    cycle acts then, and is overdue. dead_time: of the amplifiers, behind all that. torques: from outside.
    grasps: (when the hand closes, when it opens), ns, for each payload of the robot's world.
    """

    name = "plant"
    wakes_on = ()

    def __init__(
        self,
        robot: Robot,
        codec: Codec,
        status: Status,
        period_ns: int,
        action_delay_ns: Sequence[int],
        payloads: Sequence[tuple[float, int]] = (),
        torques: Sequence[ExternalTorque] = (),
        grasps: Sequence[tuple[int, int]] = (),
        dead_time: DeadTime | None = None,
    ) -> None:
        self.torques = torques
        self.dead_time = dead_time
        self.robot = robot
        self.status = status
        self.period_ns = period_ns
        self.action_delay_ns = tuple(action_delay_ns)
        joints = range(1, robot.parameters.joints + 1)
        encoders = [codec[f"Encoder_{n}"] for n in joints]
        self.encoders = [(encoder.identifier, encoder.pack) for encoder in encoders]
        currents = [(n, codec[f"Current_{n}"]) for n in joints]
        self.currents = {current.identifier: (n, current.unpack) for n, current in currents}
        self.codecs = codec.by_identifier
        self.release = codec["AccelRef"].identifier
        self.stop = codec["Stop"].identifier
        self.pack_stop = codec["Stop"].pack
        self.stores = (*self.currents, self.release, self.stop)

        self.state = INIT
        self.awaited = [1] * len(joints)
        """Of each joint, a bit for each cycle whose Current has not come: bit 0 is this one's, from cycle 0 on."""
        self.cycle = 0
        self.missed_currents = [0] * len(joints)
        self.missed_in_a_row = [0] * len(joints)
        self.late_currents = self.overdue_currents = self.repeated_currents = 0
        self.stopped = False
        self.finished = False
        self.message = ""
        self.braked_ns: int | None = None
        self.crc_errors = 0
        self.rows: list[tuple[float, ...]] = []
        for mass_kg, at_ns in payloads:
            robot.set_payload(mass_kg, at_ns)
        for payload, (closes_ns, opens_ns) in enumerate(grasps, start=1):
            robot.grasp(payload, closes_ns)
            robot.drop(payload, opens_ns)

    def on_start(self, now_ns: int) -> Reaction:
        """Begin at the next multiple of the period."""
        return 0, -(-now_ns // self.period_ns) * self.period_ns, []

    def on_frame(self, identifier: int, data: bytes, now_ns: int) -> Reaction:
        """Nothing wakes the plant but its timer."""
        raise NotImplementedError

    def store(self, identifier: int, data: bytes, at_ns: int) -> None:
        """Let a current act, release the brakes, or engage them."""
        current = self.currents.get(identifier)
        if current is not None:
            joint, unpack = current
            self._take_current(joint, unpack(data), at_ns)
        elif self.codecs[identifier].unpack(data) is None:
            self.crc_errors += 1
        elif identifier == self.stop:
            self._brake(at_ns)
        elif self.state == INIT and not self.stopped:
            self.state = READY

    def on_timer(self, now_ns: int) -> Reaction:
        """Move the arm to kT and show where it is."""
        robot = self.robot
        if self.state == READY:
            robot.release_brakes(now_ns)
            self.state = RUN
        elif self.state == RUN:
            self._count_missing()
        robot.advance_to(now_ns)
        for at_ns, joint, torque_Nm in changes(self.torques, now_ns, now_ns + self.period_ns):
            robot.set_external_torque(joint, torque_Nm, at_ns)
        if self.state == RUN:
            self._record()
            if max(self.missed_in_a_row) >= MISSES_TO_FAULT:
                return self.lose(now_ns)
        self.finished = self.stopped
        self.cycle = now_ns // self.period_ns & 0xFF
        encoders = zip(self.encoders, robot.counts(), strict=True)
        sends = [(0, identifier, pack(count, self.cycle)) for (identifier, pack), count in encoders]
        fault = STOPPED if self.stopped else NO_FAULT
        saturations, missed = sum(robot.saturations), sum(self.missed_currents)
        sends += self.status.sends(now_ns, self.state, fault, saturations, self.late_currents, missed, 0)
        return 0, now_ns + self.period_ns, sends

    def _take_current(self, joint: int, fields: tuple[int, ...] | None, at_ns: int) -> None:
        if fields is None:
            self.crc_errors += 1
            return
        counts, _, cycle = fields
        period = at_ns // self.period_ns
        age = (period - cycle) & 0xFF
        self.missed_in_a_row[joint - 1] = 0
        if self.state == RUN:
            self._tick_off(joint - 1, cycle, age > 0)
        delay_ns = self.action_delay_ns[joint - 1]
        acts_ns = (period - age) * self.period_ns + delay_ns
        self.overdue_currents += age == 0 and delay_ns > 0 and acts_ns < at_ns
        acts_ns = max(at_ns, acts_ns)
        if self.dead_time is not None:
            acts_ns = self.dead_time.applied_ns(joint - 1, period - age, acts_ns)
        self.robot.set_current(joint, counts, acts_ns)

    def _tick_off(self, joint: int, cycle: int, late: bool) -> None:
        """Take the Current that a cycle awaits; count one that is late, or one too many for its cycle."""
        passed = (self.cycle - cycle) & 0xFF
        if not self.awaited[joint] >> passed & 1:
            self.repeated_currents += 1
            return
        self.awaited[joint] ^= 1 << passed
        self.late_currents += late
        self.missed_currents[joint] -= passed > 0  # it was counted there, and is late instead

    def _count_missing(self) -> None:
        """Count joints whose Current of the period that ends did not come; the amplifier held the last one."""
        for joint, awaited in enumerate(self.awaited):
            missed = awaited & 1
            self.missed_currents[joint] += missed
            self.missed_in_a_row[joint] = self.missed_in_a_row[joint] + 1 if missed else 0
            self.awaited[joint] = (awaited << 1 | 1) & AWAITED

    def lose(self, now_ns: int, who: str = "") -> Reaction:
        """Engage the brakes and say Stop; who: that was lost, by default the joints without a Current."""
        silent = [n for n, missed in enumerate(self.missed_in_a_row, start=1) if missed >= MISSES_TO_FAULT]
        who = who or "Current of " + ", ".join(f"joint{n}" for n in silent)
        self.message = f"no {who} for {MISSES_TO_FAULT} periods: brakes engaged"
        self._brake(now_ns)
        self.state, self.finished = FAULT, True
        return 0, None, [(0, self.stop, self.pack_stop(STOP_CURRENT_LOST))]

    def _brake(self, at_ns: int) -> None:
        self.robot.engage_brakes(at_ns)
        self.state, self.stopped = INIT, True
        if self.braked_ns is None:
            self.braked_ns = at_ns

    def _record(self) -> None:
        """Keep the truth at kT, the currents and accelerations being those of the instant."""
        robot = self.robot
        acceleration, friction = robot.balance()
        self.rows.append(
            (
                *robot.q,
                *robot.w,
                *acceleration,
                *robot.current_A,
                *friction,
                *robot.external_Nm,
                robot.payload_kg,
                *self._record_world(),
            )
        )

    def _record_world(self) -> list[float]:
        """Return how the tip meets every surface, and where every body is, in the order of `_world_columns`."""
        encounter = self.robot.encounter
        if encounter is None:
            return []
        return [*chain(*encounter.touches().values(), *encounter.places().values())]

    def _world_columns(self) -> list[str]:
        encounter = self.robot.encounter
        if encounter is None:
            return []
        touches = [f"{name}_{field}" for name in encounter.world.surfaces for field in Touch._fields]
        return touches + [f"{name}_{what}" for name in encounter.world.bodies for what in ("x_m", "y_m", "angle_rad")]

    def report(self) -> dict[str, Any]:
        """Counters by cause, and the truth at kT, a row a cycle from 0 on."""
        names = ("q_rad", "w_rad_s", "a_rad_s2", "current_A", "friction_Nm", "external_Nm")
        joints = range(1, len(self.encoders) + 1)
        columns = [f"{name}_{n}" for name in names for n in joints]
        return {
            "fault": self.message,
            "braked_ns": self.braked_ns,
            "skipped_status": self.status.skipped,
            "crc_errors": self.crc_errors,
            "late_currents": self.late_currents,
            "overdue_currents": self.overdue_currents,
            "repeated_currents": self.repeated_currents,
            "missed_currents": {f"joint{n}": self.missed_currents[n - 1] for n in joints},
            **({} if self.robot.encounter is None else {"missed_grasps": self.robot.missed_grasps}),
            "saturations": {f"amplifier joint{n}": self.robot.saturations[n - 1] for n in joints},
            "columns": [*columns, "payload_kg", *self._world_columns()],
            "rows": self.rows,
        }
