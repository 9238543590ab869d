"""Word arithmetic of the target CPU: the only place where a number is rounded, wrapped or saturated.

A word has `bits` bits, two's complement (16 on the 8086); a double has twice as many. Products of two words and sums of
doubles are exact until one of the operations below says how they return to their size; shifts floor unless they are
named otherwise.
Signals are named by a small integer (an index into the caller's table of names), so that the same source runs under
Numba and MicroPython.

Ref: Intel 8086 Family User's Manual 1979, IMUL, ADD/ADC, SAR.
Not implemented: division, rounding other than floor and to the nearest (halves up).
"""


class Words:
    """The operations, bare: the fast form, which counts saturations by signal and nothing else."""

    def __init__(self, bits=16, signals=16):
        self.bits = bits
        self.high_word = (1 << (bits - 1)) - 1
        self.low_word = -(1 << (bits - 1))
        self.saturations = [0] * signals
        self._bind()

    def _bind(self):  # noqa: C901 (a list of one-line operations)
        """Make each operation a closure over plain ints, which is what Numba takes."""
        bits, low, high = self.bits, self.low_word, self.high_word
        mask = (1 << bits) - 1
        low_double, high_double = -(1 << (2 * bits - 1)), (1 << (2 * bits - 1)) - 1
        saturations = self.saturations

        def multiply(x, y):
            return x * y

        def add(x, y):
            return x + y

        def subtract(x, y):
            return x - y

        def wrap(_signal, x):
            return ((x - low) & mask) + low

        def saturate(signal, x):
            if low <= x <= high:
                return x
            saturations[signal] += 1
            return high if x > high else low

        def saturate_double(signal, x):
            if low_double <= x <= high_double:
                return x
            saturations[signal] += 1
            return high_double if x > high_double else low_double

        def limit(signal, x, bound):
            if -bound <= x <= bound:
                return x
            saturations[signal] += 1
            return bound if x > bound else -bound

        def shift_right(x, count):
            return x >> count

        def shift_right_nearest(x, count):
            # On the 8086 one ADC 0 behind the last SAR: the bit shifted out is in the carry flag.
            return x + (1 << count >> 1) >> count

        def shift_left(x, count):
            return x << count

        def high_of(x):
            return x >> bits

        def to_high(x):
            return x << bits

        self.multiply, self.add, self.subtract = multiply, add, subtract
        self.wrap, self.saturate, self.saturate_double, self.limit = wrap, saturate, saturate_double, limit
        self.shift_right, self.shift_right_nearest, self.shift_left = shift_right, shift_right_nearest, shift_left
        self.high_of, self.to_high = high_of, to_high


class InstrumentedWords(Words):
    """The same operations, counted, with the range and the wraps of every signal; refuses what no word can hold."""

    def __init__(self, bits=16, signals=16):
        self.multiplications = 0
        self.additions = 0
        self.minimum = [None] * signals
        self.maximum = [None] * signals
        self.wraps = [0] * signals
        super().__init__(bits, signals)

    def _bind(self):
        super()._bind()
        self.multiply = self._counted(self.multiply, 1, 0)
        self.add = self._counted(self.add, 0, 1)
        self.subtract = self._counted(self.subtract, 0, 1)
        self.wrap = self._seen(self._wraps_counted(self.wrap))
        self.saturate = self._seen(self.saturate)
        self.saturate_double = self._seen(self.saturate_double)
        self.limit = self._seen(self.limit)

    def _counted(self, operation, multiplications, additions):
        """A multiplier takes words, an adder takes doubles (ADD/ADC)."""
        width = self.bits if multiplications else 2 * self.bits

        def counted(x, y):
            for operand in (x, y):
                if not -(1 << (width - 1)) <= operand < 1 << (width - 1):
                    raise OverflowError("operand " + str(operand) + " does not fit " + str(width) + " bits")
            self.multiplications += multiplications
            self.additions += additions
            return operation(x, y)

        return counted

    def _wraps_counted(self, operation):
        def counted(signal, x):
            wrapped = operation(signal, x)
            self.wraps[signal] += wrapped != x
            return wrapped

        return counted

    def _seen(self, operation):
        """Keep the range of what the operation returns."""

        def seen(signal, *operands):
            x = operation(signal, *operands)
            low, high = self.minimum[signal], self.maximum[signal]
            self.minimum[signal] = x if low is None or x < low else low
            self.maximum[signal] = x if high is None or x > high else high
            return x

        return seen
