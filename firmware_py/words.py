"""Word arithmetic of the target CPU: the only place where a number is rounded, wrapped or saturated.

A word has `bits` bits, two's complement (16 on the 8086); a double has twice as many. Products of two words and sums of
doubles are exact until one of the operations below says how they return to their size.
Signals are named by a small integer (an index into the caller's table of names). The operations read nothing but ints
of what they belong to, and write `saturations` alone: so the same source runs on a tuple of the same names under Numba,
and under MicroPython.

Ref: Intel 8086 Family User's Manual 1979, IMUL, ADD/ADC, SAR.
Not implemented: division, rounding at random.
"""

FLOOR, NEAREST, CONVERGENT, TOWARD_ZERO = 0, 1, 2, 3
ROUNDINGS = ("floor", "nearest", "convergent", "toward-zero")
"""Nearest: halves up. Convergent: halves to the even one."""


def rounded(x, places, rounding):
    """Return x / 2^places as a whole number."""
    if places <= 0:
        return x << -places
    if rounding == FLOOR:
        return x >> places
    half = 1 << (places - 1)
    if rounding == NEAREST:
        return (x + half) >> places
    down = x >> places
    rest = x - (down << places)
    if rounding == CONVERGENT:
        return down + int(rest > half or (rest == half and down & 1 == 1))
    return down + int(x < 0 and rest != 0)


def bounded(words, signal, x, low, high):
    """Return x, brought back into low to high by saturating or wrapping; count that under its signal."""
    if low <= x <= high:
        return x
    words.saturations[signal] += 1
    if words.wraps_over:
        return ((x - low) & (high - low)) + low
    return high if x > high else low


class Words:
    """The operations, bare: the fast form, which counts overflows by signal and nothing else.

    d_fraction: bits behind the point of a joint's state d, a word and so many bits; ka_fraction, kb_fraction: of its
    constants (kb_fraction may be below 0). current_shift, acceleration_shift: bits that its counts have more than the
    bus's. roundings: of d, of the estimate, of the reference. wraps_over: overflows wrap in place of saturating.
    counter_bits: of the position counter.
    """

    def __init__(
        self,
        bits=16,
        signals=16,
        d_fraction=None,
        ka_fraction=None,
        kb_fraction=0,
        current_shift=0,
        acceleration_shift=0,
        roundings=(FLOOR, FLOOR, NEAREST),
        wraps_over=False,
        counter_bits=None,
    ):
        counter_bits = bits if counter_bits is None else counter_bits
        self.bits = bits
        self.d_fraction = bits if d_fraction is None else d_fraction
        self.high_word = (1 << (bits - 1)) - 1
        self.low_word = -(1 << (bits - 1))
        self.high_speed = (1 << (bits - 1 + kb_fraction)) - 1
        self.low_speed = -(1 << (bits - 1 + kb_fraction))
        self.high_d = (1 << (bits - 1 + self.d_fraction)) - 1
        self.low_d = -(1 << (bits - 1 + self.d_fraction))
        self.counter_mask = (1 << counter_bits) - 1
        self.counter_low = -(1 << (counter_bits - 1))
        self.speed_places = kb_fraction - self.d_fraction
        self.current_places = (bits - 1 if ka_fraction is None else ka_fraction) - self.d_fraction
        self.current_shift = current_shift
        self.acceleration_shift = acceleration_shift
        self.round_d, self.round_estimate, self.round_reference = roundings
        self.wraps_over = wraps_over
        self.saturations = [0] * signals

    def multiply(self, x, y):
        """Return the product of two words, a double."""
        return x * y

    def add(self, x, y):
        """Return the sum of two doubles."""
        return x + y

    def subtract(self, x, y):
        """Return the difference of two doubles."""
        return x - y

    def shift_right(self, x, count):
        """Return x / 2^count, floored."""
        return x >> count

    def wrap(self, _signal, x):
        """Return what a counter shows."""
        return ((x - self.counter_low) & self.counter_mask) + self.counter_low

    def saturate(self, signal, x):
        """Return x as a word."""
        if self.low_word <= x <= self.high_word:
            return x
        return bounded(self, signal, x, self.low_word, self.high_word)

    def saturate_speed(self, signal, x):
        """Return KB dw as a word and the fraction of KB."""
        if self.low_speed <= x <= self.high_speed:
            return x
        return bounded(self, signal, x, self.low_speed, self.high_speed)

    def saturate_d(self, signal, x):
        """Return x as a word and the fraction of d."""
        if self.low_d <= x <= self.high_d:
            return x
        return bounded(self, signal, x, self.low_d, self.high_d)

    def limit(self, signal, x, bound):
        """Return x between -bound and bound: a law, whatever overflows do."""
        if -bound <= x <= bound:
            return x
        self.saturations[signal] += 1
        return bound if x > bound else -bound

    def speed_in_d(self, x):
        """Return KB dw with the fraction of d."""
        if self.speed_places <= 0:
            return x << -self.speed_places
        return rounded(x, self.speed_places, self.round_d)

    def current_in_d(self, x):
        """Return KA (i - d) with the fraction of d."""
        if self.current_places <= 0:
            return x << -self.current_places
        return rounded(x, self.current_places, self.round_d)

    def whole(self, signal, d):
        """Return d as a word."""
        if self.round_estimate == FLOOR:
            return d >> self.d_fraction  # always fits
        return bounded(self, signal, rounded(d, self.d_fraction, self.round_estimate), self.low_word, self.high_word)

    def reference_current(self, x, shift):
        """Return KJ a_ref in current counts."""
        if self.round_reference == NEAREST:
            # On the 8086 one ADC 0 behind the last SAR: the bit shifted out is in the carry flag.
            return (x + (1 << shift >> 1)) >> shift
        return rounded(x, shift, self.round_reference)

    # -- between the bus's counts, int16, and the step's: to the nearest --

    def acceleration_from_bus(self, signal, x):
        """Return a reference in the step's counts."""
        if self.acceleration_shift == 0 and self.low_word <= x <= self.high_word:
            return x
        return bounded(self, signal, rounded(x, -self.acceleration_shift, NEAREST), self.low_word, self.high_word)

    def current_from_bus(self, x):
        """Return a limit in the step's counts."""
        if self.current_shift == 0:
            return x
        return rounded(x, -self.current_shift, NEAREST)

    def current_to_bus(self, signal, x):
        """Return a current in the bus's counts."""
        if self.current_shift == 0 and -0x8000 <= x <= 0x7FFF:
            return x
        return bounded(self, signal, rounded(x, self.current_shift, NEAREST), -0x8000, 0x7FFF)


class InstrumentedWords(Words):
    """The same operations, counted, with the range and the wraps of every signal; refuses what no word can hold."""

    def __init__(self, bits=16, signals=16, *formats):
        Words.__init__(self, bits, signals, *formats)
        self.multiplications = 0
        self.additions = 0
        self.minimum = [None] * signals
        self.maximum = [None] * signals
        self.wraps = [0] * signals

    def multiply(self, x, y):
        """Count; a multiplier takes words."""
        self._check(self.bits, x, y)
        self.multiplications += 1
        return x * y

    def add(self, x, y):
        """Count; an adder takes doubles (ADD/ADC)."""
        self._check(2 * self.bits, x, y)
        self.additions += 1
        return x + y

    def subtract(self, x, y):
        """Count as `add` does."""
        self._check(2 * self.bits, x, y)
        self.additions += 1
        return x - y

    def wrap(self, signal, x):
        """Count those that change the value."""
        wrapped = Words.wrap(self, signal, x)
        self.wraps[signal] += wrapped != x
        return self._seen(signal, wrapped)

    def saturate(self, signal, x):
        """Keep the range."""
        return self._seen(signal, Words.saturate(self, signal, x))

    def saturate_speed(self, signal, x):
        """Keep the range."""
        return self._seen(signal, Words.saturate_speed(self, signal, x))

    def saturate_d(self, signal, x):
        """Keep the range."""
        return self._seen(signal, Words.saturate_d(self, signal, x))

    def limit(self, signal, x, bound):
        """Keep the range."""
        return self._seen(signal, Words.limit(self, signal, x, bound))

    def _check(self, width, x, y):
        for operand in (x, y):
            if not -(1 << (width - 1)) <= operand < 1 << (width - 1):
                raise OverflowError("operand " + str(operand) + " does not fit " + str(width) + " bits")

    def _seen(self, signal, x):
        low, high = self.minimum[signal], self.maximum[signal]
        self.minimum[signal] = x if low is None or x < low else low
        self.maximum[signal] = x if high is None or x > high else high
        return x
