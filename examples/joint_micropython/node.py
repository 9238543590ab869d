"""firmware_py/joint_cpu.py under MicroPython as a node of the rig: as it stands, in a process of its own.

    hil run --inline --set joint2.cpu=examples.joint_micropython.node:MicroPythonJoint

The program is `micropython` on the path, or what HIL_MICROPYTHON says.
"""

from examples.joint_micropython.on_board.by_calls import FRAME, START, TIMER
from examples.joint_micropython.process import Process, program
from firmware_py.joint_cpu import JointCPU


class MicroPythonJoint:
    """Built and called as JointCPU is; each call is carried over and its answer back."""

    def __init__(self, *arguments):
        self.twin = JointCPU(*arguments)
        self.name, self.wakes_on, self.stores = self.twin.name, self.twin.wakes_on, self.twin.stores
        self.program = program()
        self.process = None
        self.counters = None

    @property
    def finished(self):
        """Whether its part in the run is over."""
        return self.process is not None and self.process.finished

    def on_start(self, now_ns):
        """Start the process, not before: a rig builds its nodes once more than it needs them, to see that it can."""
        self.process = Process(self.program, self.twin)
        return self.process.ask(START, now_ns)

    def store(self, identifier, data, at_ns):
        """Keep AccelRef or Parameter; the next call takes it along."""
        self.process.tell(FRAME, at_ns, identifier, data)

    def on_frame(self, identifier, data, now_ns):
        """Answer Encoder or Stop."""
        return self.process.ask(FRAME, now_ns, identifier, data)

    def on_timer(self, now_ns):
        """Three Encoder frames in a row are missing."""
        return self.process.ask(TIMER, now_ns)

    def report(self):
        """Counters of the emulated system, by cause; after it the process is gone."""
        if self.counters is None:
            self.counters = self.process.report()
            self.process.end()
        return self.counters
