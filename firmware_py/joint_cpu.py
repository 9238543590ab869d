"""One joint's CPU: the disturbance observer of the paper in 16-bit words, and the state machine around it.

Ints, functions and plain classes without imports: what it needs (word arithmetic, codec, CRC-16) is handed in, so
MicroPython and Numba take this file as it is. All values are raw counts; the DBC says what a count means.

Ref: S. Komada, M. Ishida, T. Hori, Control of Robots Using Disturbance Observer, eqs. (5), (6), (8), table 1.
"""

INIT, READY, RUN, FAULT = 0, 1, 2, 3
STATES = ("init", "ready", "run", "fault")
NO_FAULT, ENCODER_LOST, REFERENCE_LOST, PARAMETERS, STOPPED, NOT_READY = 0, 1, 2, 3, 4, 7
FAULTS = (
    "none",
    "encoder lost",
    "reference lost",
    "parameters",
    "stopped",
    "singular reference",
    "out of reach",
    "node not ready",
)
STOP_END, STOP_JOINT_FAULT = 0, 2
MISSES_TO_FAULT = 3

# The order of the parameter table; the last index carries the CRC-16 of those before it.
KA, KB, KJ, SHIFT, CURRENT_LIMIT, TABLE_CRC = 0, 1, 2, 3, 4, 5
PARAMETERS_NAMES = ("KA", "KB", "KJ", "shift", "current_limit")

# What an operation returns to its size; the last two are reported where they did not fit only.
W, DW, KB_DW, D, CURRENT, ERROR, A_REF, ESTIMATE = 0, 1, 2, 3, 4, 5, 6, 7
SIGNALS = ("w", "dw", "KB*dw", "d", "i", "i-d", "a_ref", "estimate")


def make_step(words):
    """Return the control step on a kind of words: 3 multiplications and 6 additions (table 1).

    words: the class; the step takes one of its objects first. Reference, limit, current and estimate are bus counts.
    d is the disturbance estimate t_dis_hat / Ktn in current counts, a word and a fraction:
    d' = g (i - d) - KB w', which is (5) without a filter of the large term g Jn w. The estimate is the d that the
    step's current answers; the d that it leaves already holds g T of that current, which the next speed takes off.
    """
    multiply, add, subtract = words.multiply, words.add, words.subtract
    wrap, saturate, saturate_speed, saturate_d = words.wrap, words.saturate, words.saturate_speed, words.saturate_d
    speed_in_d, current_in_d, whole, limit = words.speed_in_d, words.current_in_d, words.whole, words.limit
    acceleration_from_bus, reference_current = words.acceleration_from_bus, words.reference_current
    current_from_bus, current_to_bus = words.current_from_bus, words.current_to_bus

    def step(words, count, count_prev, w_prev, d, a_ref, ka, kb, kj, shift, current_limit):
        a = acceleration_from_bus(words, A_REF, a_ref)
        bound = current_from_bus(words, current_limit)
        w = wrap(words, W, subtract(words, count, count_prev))
        dw = wrap(words, DW, subtract(words, w, w_prev))
        from_speed = saturate_speed(words, KB_DW, multiply(words, kb, dw))
        d = saturate_d(words, D, subtract(words, d, speed_in_d(words, from_speed)))
        estimate = whole(words, ESTIMATE, d)
        feed = reference_current(words, multiply(words, kj, a), shift)
        i = limit(words, CURRENT, add(words, feed, estimate), bound)
        error = saturate(words, ERROR, subtract(words, i, estimate))
        d = saturate_d(words, D, add(words, d, current_in_d(words, multiply(words, ka, error))))
        return w, d, current_to_bus(words, CURRENT, i), current_to_bus(words, ESTIMATE, estimate)

    return step


def usable(table):
    """Return whether the step can compute with a table: no shift to the left, a limit with an opposite in its word."""
    return table[SHIFT] >= 0 and table[CURRENT_LIMIT] > -0x8000


class JointCPU:
    """Joint `number` (1 to n): answers each Encoder frame with a Current frame.

    words: Words; codec: frames by name; crc16: of bytes; status: sends State and Heartbeat in this node's turn;
    reference: (name of the AccelRef frame, index of this joint's value in it).
    """

    def __init__(self, number, words, codec, crc16, status, reference, period_ns, compute_ns):
        self.number = number
        self.name = "joint" + str(number)
        self.words = words
        self.step = make_step(type(words))
        self.crc16 = crc16
        self.status = status
        self.period_ns = period_ns
        self.compute_ns = compute_ns

        suffix = "_" + str(number)
        self.encoder = codec["Encoder" + suffix]
        self.current = codec["Current" + suffix]
        self.parameter = codec["Parameter" + suffix]
        self.acknowledge = codec["Acknowledge" + suffix]
        self.stop = codec["Stop"]
        self.accel_ref = codec[reference[0]]
        self.reference_index = reference[1]
        self.wakes_on = (self.encoder.identifier, self.stop.identifier)
        self.stores = (self.accel_ref.identifier, self.parameter.identifier)

        self.state = INIT
        self.fault = NO_FAULT
        self.table = [0] * TABLE_CRC
        self.database_version = codec.version
        self.version = 0
        self.parameter_data = None
        self.reference_data = None
        self.timer_ns = None
        self.finished = False

        self.count_prev = 0
        self.w_prev = 0
        self.d = 0
        self.i = 0
        self.a_ref = 0
        self.cycle = 0

        self.crc_errors = 0
        self.strikes = 0
        self.strikes_in_a_row = 0
        self.missed_encoders = 0
        self.repeated_encoders = 0

    # -- what the driver calls --

    def on_start(self, _now_ns):
        """Wait for the set-up."""
        return 0, None, []

    def store(self, identifier, data, _at_ns):
        """Keep the newest AccelRef and Parameter."""
        if identifier == self.accel_ref.identifier:
            self.reference_data = data
        else:
            self.parameter_data = data

    def on_frame(self, identifier, data, now_ns):
        """Answer an Encoder frame with the current reference of the same cycle."""
        fields = (self.stop if identifier == self.stop.identifier else self.encoder).unpack(data)
        if fields is None:
            self.crc_errors += 1
            return 0, self.timer_ns, []
        if identifier == self.stop.identifier:
            return self._stop(fields[0])
        count, cycle = fields
        if self.state == RUN and cycle == self.cycle:
            self.repeated_encoders += 1
            return 0, self.timer_ns, []
        sends = self._take_parameter()
        self._follow(count, cycle, now_ns)
        i = estimate = 0
        if self.state == RUN:
            i, estimate = self.control(count, self.a_ref)
            self.i = i
        elif self.state == FAULT:
            self.finished = True
            sends.append(self._stop_frame())
        elif self.state == INIT and self._left_out(cycle):
            sends.append(self._stop_frame())
        self.cycle = cycle
        sends.append((self.compute_ns, self.current.identifier, self.current.pack(i, estimate, cycle)))
        sends += self._status(now_ns)
        return self.compute_ns, self.timer_ns, sends

    def on_timer(self, _now_ns):
        """Three Encoder frames in a row are missing."""
        self._enter_fault(ENCODER_LOST)
        self.finished = True
        return 0, None, [self._no_current(), self._stop_frame()]

    # -- the law --

    def control(self, count, a_ref):
        """Return (current reference, disturbance estimate) in current counts; a user's own law replaces this."""
        ka, kb, kj, shift, current_limit = self.table
        self.w_prev, self.d, i, estimate = self.step(
            self.words, count, self.count_prev, self.w_prev, self.d, a_ref, ka, kb, kj, shift, current_limit
        )
        self.count_prev = count
        return i, estimate

    def preset(self, count):
        """Enter run without a bump: at rest, no disturbance known."""
        self.count_prev = count
        self.w_prev = 0
        self.d = 0

    def bridge(self, count, missed):
        """Make up for Encoder frames that never came.

        One missing: half the difference stands for each period. Two: the speed is taken to have stayed (a third is no
        shift). No addition of the step is touched; count_prev is.
        """
        w = self.w_prev
        if missed == 1:
            w = self.words.shift_right(self.words.wrap(W, count - self.count_prev), 1)
        self.count_prev = count - w

    # -- the state machine --

    def _follow(self, count, cycle, now_ns):
        """Take the AccelRef of the cycle before, and enter or leave run."""
        if self.state == READY:
            if self.reference_data is None:
                return
            if self._count_strikes(cycle):
                self.state = RUN
                self.preset(count)
        elif self.state == RUN:
            self._count_misses(count, cycle)
            self._count_strikes(cycle)
        if self.state == RUN:
            self.timer_ns = now_ns + MISSES_TO_FAULT * self.period_ns + self.period_ns // 2

    def _reference(self, cycle):
        """Return the fields of AccelRef if it is that of the cycle before, never another."""
        if self.reference_data is None:
            return None
        fields = self.accel_ref.unpack(self.reference_data)
        if fields is None:
            self.crc_errors += 1
            self.reference_data = None
        elif fields[-1] == (cycle - 1) & 0xFF:
            return fields
        return None

    def _count_misses(self, count, cycle):
        missed = (cycle - self.cycle - 1) & 0xFF
        if missed == 0:
            return
        self.missed_encoders += missed
        if missed >= MISSES_TO_FAULT:
            self._enter_fault(ENCODER_LOST)
        else:
            self.bridge(count, missed)

    def _count_strikes(self, cycle):
        """Take the AccelRef of the cycle before, or count a strike; return whether it was there."""
        fields = self._reference(cycle)
        if fields is not None:
            self.a_ref = fields[self.reference_index]
            self.strikes_in_a_row = 0
            return True
        self.strikes += 1
        self.strikes_in_a_row += 1
        if self.strikes_in_a_row >= MISSES_TO_FAULT:
            self._enter_fault(REFERENCE_LOST)
        return False

    def _enter_fault(self, fault):
        if self.state != FAULT:
            self.fault = fault
        self.state = FAULT
        self.timer_ns = None
        self.i = 0

    def _stop(self, reason):
        """Give no current from now on; to run again takes a new set-up. A fault stays what it is."""
        self.finished = True
        if self.state != FAULT:
            self.state = INIT
            self.fault = NO_FAULT if reason == STOP_END else STOPPED
        self.timer_ns = None
        self.reference_data = None
        self.i = 0
        return 0, None, [self._no_current()]

    def _left_out(self, cycle):
        """Return whether a run is on without this joint: references come, and it was not set up for them.

        As after a reset in the middle of a run, when its current of zero would look like an answer.
        """
        on = self._reference(cycle) is not None
        self.reference_data = None
        if on:
            self.fault = NOT_READY
        return on

    def _stop_frame(self):
        return 0, self.stop.identifier, self.stop.pack(STOP_JOINT_FAULT)

    def _no_current(self):
        return 0, self.current.identifier, self.current.pack(0, 0, self.cycle)

    # -- parameters over CAN --

    def _take_parameter(self):
        """Take one entry of the parameter table and return its acknowledgement, or nothing."""
        if self.parameter_data is None:
            return []
        fields = self.parameter.unpack(self.parameter_data)
        self.parameter_data = None
        if fields is None:
            self.crc_errors += 1
            return []
        index, value, version = fields
        if self.state in (INIT, READY) and index <= TABLE_CRC:
            self._write_parameter(index, value, version)
        if index < TABLE_CRC:
            value = self.table[index]  # what stands there, whatever was asked
        answer = self.acknowledge.pack(index, value, self.database_version, self.table_crc())
        return [(self.compute_ns, self.acknowledge.identifier, answer)]

    def _write_parameter(self, index, value, version):
        if version != self.database_version:  # who knows what its entries mean
            self.state = INIT
            self.fault = PARAMETERS
            return
        self.version = version
        if index < TABLE_CRC:
            self.table[index] = value
            self.state = INIT
        elif value & 0xFFFF != self.table_crc():
            self.fault = PARAMETERS
        elif not usable(self.table):
            self._enter_fault(PARAMETERS)
        else:
            self.state = READY
            self.fault = NO_FAULT
            self.reference_data = None
            self.strikes_in_a_row = 0

    def table_crc(self):
        """CRC-16 over the values in index order, little-endian."""
        data = []
        for value in self.table:
            data += [value & 0xFF, (value >> 8) & 0xFF]
        return self.crc16(bytes(data))

    # -- what it says of itself --

    def _status(self, now_ns):
        return self.status.sends(
            now_ns,
            self.state,
            self.fault,
            sum(self.words.saturations),
            self.strikes,
            self.missed_encoders,
            self.version,
        )

    def report(self):
        """Counters of the emulated system, by cause."""
        return {
            "fault": FAULTS[self.fault] if self.fault else "",
            "skipped_status": self.status.skipped,
            "crc_errors": self.crc_errors,
            "strikes": self.strikes,
            "missed_encoders": self.missed_encoders,
            "repeated_encoders": self.repeated_encoders,
            "saturations": {SIGNALS[k]: n for k, n in enumerate(self.words.saturations) if k < A_REF or n},
        }
