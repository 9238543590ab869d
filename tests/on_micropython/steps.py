"""The control step on rows of int32 from stdin, under MicroPython: results and saturations of each to stdout."""

import sys
from array import array

from firmware_py.joint_cpu import SIGNALS, make_step
from firmware_py.words import Words

ARGUMENTS = 10
ROWS = 1000

words = Words(16, len(SIGNALS))
step = make_step(Words)
while True:
    rows = array("i", sys.stdin.buffer.read(4 * ARGUMENTS * ROWS))
    if not rows:
        break
    results = array("i")
    for at in range(0, len(rows), ARGUMENTS):
        words.saturations = [0] * len(SIGNALS)
        results.extend(array("i", step(words, *rows[at : at + ARGUMENTS])))
        results.extend(array("i", words.saturations))
    sys.stdout.buffer.write(results)
