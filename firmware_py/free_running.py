"""A joint's CPU that samples by a timer of its own: its crystal is not the DSP's, and nothing ties one to the other.

The Encoder frame only fills a mailbox with a flag for what is new; the timer's interrupt computes with what is in
there, and looks at nothing else. A sample taken twice reads as speed 0, one behind another that was overwritten as
double speed. Until cycle 0, and in a fault, it is the joint CPU, frame by frame.

Ints and plain classes, for MicroPython and Numba as they stand. Not modelled: the timer's own resolution.
"""

from firmware_py.joint_cpu import ENCODER_LOST, FAULT, MISSES_TO_FAULT, RUN, JointCPU

ONE = 1_000_000_000
"""Of a crystal's error, in parts of 1e9."""


class Timer:
    """Instants `period_ns` apart by a crystal that is `error_ppb` parts in 1e9 too fast.

    Whole ns; what each instant leaves is carried on, so the n-th is floor(n period / (1 + error)) behind the first.
    """

    def __init__(self, period_ns, error_ppb):
        self.divisor = ONE + error_ppb
        self.step_ns, self.rest = divmod(period_ns * ONE, self.divisor)
        self.at_ns = 0
        self.carried = 0

    def set(self, at_ns):
        """Begin anew, there."""
        self.at_ns = at_ns
        self.carried = 0

    def next(self):
        """Return the next instant."""
        self.at_ns += self.step_ns
        self.carried += self.rest
        if self.carried >= self.divisor:
            self.carried -= self.divisor
            self.at_ns += 1
        return self.at_ns


class FreeRunning(JointCPU):
    """The joint CPU by its own timer from cycle 0 on: the first Encoder of the run is answered at once, and sets it.

    Tick n comes phase_ns + n periods (of its own) behind that frame. What it says of itself still follows the Encoder.

    Its reference is the newest AccelRef: whoever does not follow the cycle cannot ask for that of the cycle before. So
    a strike is a tick that none came for since the tick before, one a beat for a fast crystal; three in a row are still
    a fault, as are three ticks in a row without a new Encoder. Frames that the bus lost are missed Encoders; samples
    and references that came and were overwritten unread are missed samples and references.
    """

    def __init__(
        self, number, words, codec, crc16, status, reference, period_ns, compute_ns, crystal_ppb=0, phase_ns=0
    ):
        super().__init__(number, words, codec, crc16, status, reference, period_ns, compute_ns)
        self.timer = Timer(period_ns, crystal_ppb)
        self.phase_ns = phase_ns
        self.count = 0
        self.is_new = False
        self.doubled_in_a_row = 0
        self.doubled_samples = 0
        self.missed_samples = 0
        self.missed_references = 0

    # -- what the driver calls --

    def store(self, identifier, data, at_ns):
        """Keep the newest AccelRef and Parameter; one that replaces an unread AccelRef is counted."""
        if self.state == RUN and identifier == self.accel_ref.identifier and self.reference_data is not None:
            self.missed_references += 1
        super().store(identifier, data, at_ns)

    def on_frame(self, identifier, data, now_ns):
        """Put an Encoder frame of the run into the mailbox; answer all others as the joint CPU does."""
        was_running = self.state == RUN
        if was_running and identifier == self.encoder.identifier:
            return self._receive(data, now_ns)
        busy_ns, timer_ns, sends = super().on_frame(identifier, data, now_ns)
        if self.state == RUN and not was_running:
            timer_ns = self._begin(now_ns)
        return busy_ns, timer_ns, sends

    def on_timer(self, _now_ns):
        """Sample: compute with what is in the mailbox, and send the current reference."""
        self._take_sample()
        if self.state == RUN:
            self._count_strikes(self.cycle)
        if self.state == FAULT:
            self.finished = True
            return 0, None, [self._no_current(), self._stop_frame()]
        self.timer_ns = self.timer.next()
        i, estimate = self.control(self.count, self.a_ref)
        self.i = i
        answer = self.current.pack(i, estimate, self.cycle)
        return self.compute_ns, self.timer_ns, [(self.compute_ns, self.current.identifier, answer)]

    # -- the mailbox --

    def _begin(self, now_ns):
        """Set the timer by the Encoder of cycle 0, which has been answered: nothing in the mailbox is new."""
        self.count = self.count_prev
        self.is_new = False
        self.reference_data = None
        self.timer.set(now_ns + self.phase_ns)
        self.timer_ns = self.timer.next()
        return self.timer_ns

    def _receive(self, data, now_ns):
        fields = self.encoder.unpack(data)
        if fields is None:
            self.crc_errors += 1
            return 0, self.timer_ns, []
        count, cycle = fields
        if cycle == self.cycle:
            self.repeated_encoders += 1
            return 0, self.timer_ns, []
        self.missed_encoders += (cycle - self.cycle - 1) & 0xFF
        self.missed_samples += self.is_new
        self.count, self.cycle, self.is_new = count, cycle, True
        return 0, self.timer_ns, self._take_parameter() + self._status(now_ns)

    def _take_sample(self):
        """Read the mailbox: what is in it may be the sample of the tick before, for at most two ticks in a row."""
        if self.is_new:
            self.doubled_in_a_row = 0
        else:
            self.doubled_samples += 1
            self.doubled_in_a_row += 1
            if self.doubled_in_a_row >= MISSES_TO_FAULT:
                self._enter_fault(ENCODER_LOST)
        self.is_new = False

    def _reference(self, cycle):
        """Return the fields of the AccelRef that came since the tick before; none is older, none is asked for."""
        if self.state != RUN:
            return super()._reference(cycle)
        data, self.reference_data = self.reference_data, None
        if data is None:
            return None
        fields = self.accel_ref.unpack(data)
        self.crc_errors += fields is None
        return fields

    def report(self):
        """Counters by cause; beats: how often the samples have slid past the Encoder by a whole period."""
        return {
            **super().report(),
            "missed_references": self.missed_references,
            "doubled_samples": self.doubled_samples,
            "missed_samples": self.missed_samples,
            "beats": abs(self.doubled_samples - self.missed_samples - self.missed_encoders),
        }
