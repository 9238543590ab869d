"""What was said to a joint and what it answered: recorded from the one in Python, played to the one in C."""

import struct
import subprocess
from ctypes import sizeof

from examples.joint_c import node

CALL = struct.Struct("=BBBBIq8sqq")
"""struct call of replay.c."""


class Recorded:
    """A joint in Python; its calls and reactions are kept."""

    def __init__(self, cpu):
        self.cpu = cpu
        self.name, self.wakes_on, self.stores = cpu.name, cpu.wakes_on, cpu.stores
        self.calls = []
        self.reactions = []
        times = (cpu.status.tail_ns, cpu.compute_ns)
        self.calls.append(CALL.pack(ord("i"), 0, cpu.status.turns - 2, 0, cpu.number, cpu.period_ns, b"", *times))

    @property
    def finished(self):
        return self.cpu.finished

    def on_start(self, now_ns):
        return self.cpu.on_start(now_ns)

    def store(self, identifier, data, at_ns):
        self._call("s", identifier, data, at_ns)
        self.cpu.store(identifier, data, at_ns)

    def on_frame(self, identifier, data, now_ns):
        self._call("f", identifier, data, now_ns)
        return self._keep(self.cpu.on_frame(identifier, data, now_ns))

    def on_timer(self, now_ns):
        self._call("t", 0, b"", now_ns)
        return self._keep(self.cpu.on_timer(now_ns))

    def report(self):
        return self.cpu.report()

    def _call(self, kind, identifier, data, now_ns):
        self.calls.append(CALL.pack(ord(kind), len(data), 0, 0, identifier, now_ns, data, 0, 0))

    def _keep(self, answer):
        self.reactions.append(answer)
        return answer

    @property
    def sent(self):
        """(identifier, data) of every frame it sent, in order."""
        return [(identifier, data) for _, _, sends in self.reactions for _, identifier, data in sends]


def play(program, calls):
    """Return the reactions of the core in C to these calls, and its report after them."""
    last = CALL.pack(ord("r"), 0, 0, 0, 0, 0, b"", 0, 0)
    run = subprocess.run([str(program)], input=b"".join([*calls, last]), capture_output=True, timeout=120, check=False)
    assert run.returncode == 0, run.stderr.decode()
    answered, size = sum(call[:1] in b"ft" for call in calls), sizeof(node.Out)
    reactions = [node.reaction(node.Out.from_buffer_copy(run.stdout, at * size)) for at in range(answered)]
    return reactions, node.report(node.Head.from_buffer_copy(run.stdout, answered * size))


def same(recorded, program):
    """Assert that the core in C answers as the joint in Python did."""
    reactions, report = play(program, recorded.calls)
    for index, (ours, theirs) in enumerate(zip(recorded.reactions, reactions, strict=True)):
        assert ours == theirs, f"reaction {index}: {ours} in Python, {theirs} in C"
    assert report == recorded.report()
