"""The joint on a CAN bus, by the Sync frame: time is counted by the cycles of the Encoder frames.

Encoder k is answered when AccelRef k - 1 is there, and leaves AccelRef k for the next: a controller with several
receive queues need not keep the order of the bus. Ref: docs/board.md, "Time", the clock `sync`.
Not implemented: the clock `wall`, in which silence is a fault.
"""

import gc

BEFORE_ALL = -256
"""Encoder counts cycles modulo 256; a set-up is no longer."""


class Ordered:
    """The joint with the frames in their order."""

    def __init__(self, joint):
        self.joint = joint
        self.cycle = BEFORE_ALL
        self.announced = False  # the first AccelRef has come, that of cycle -1
        self.references = {}
        self.waiting = None  # Encoder k, while AccelRef k - 1 is missing
        self.question = None  # the last one that was answered, and what with
        self.answer = []

    def hear(self, identifier, data):
        """Take a frame; return those to send, as a node does."""
        joint = self.joint
        if identifier == joint.stop.identifier:
            return [] if self.question is None else self._wake(identifier, data)  # else of a run before this one
        if identifier == joint.parameter.identifier:
            joint.store(identifier, data, self._now_ns())
        elif identifier == joint.accel_ref.identifier:
            self._keep(data)
        elif data == self.question:
            return self.answer
        else:
            self.waiting = data
        return [] if self.waiting is None else self._take_encoder(self.waiting)

    def _keep(self, data):
        """Keep a reference by the parity of its cycle; a damaged one does not exist."""
        fields = self.joint.accel_ref.unpack(data)
        if fields is None:
            return
        self.references[fields[-1] & 1] = fields[-1], data
        if not self.announced:
            self.announced, self.cycle = True, -1

    def _take_encoder(self, data):
        """Have Encoder answered, if nothing is missing."""
        joint, fields = self.joint, self.joint.encoder.unpack(data)
        if fields is not None:
            byte = fields[-1]
            cycle = self.cycle + ((byte - self.cycle) & 0xFF)
            if self.announced and cycle >= 0:
                of, reference = self.references.get(~byte & 1, (None, None))
                if of != (byte - 1) & 0xFF:
                    return []
                joint.store(joint.accel_ref.identifier, reference, self._now_ns())
            self.cycle = cycle
        self.waiting, self.question = None, data
        self.answer = self._wake(joint.encoder.identifier, data)
        return self.answer

    def _wake(self, identifier, data):
        _busy_ns, _timer_ns, sends = self.joint.on_frame(identifier, data, self._now_ns())
        return sends

    def _now_ns(self):
        return self.cycle * self.joint.period_ns


def serve(joint, bus):
    """Play until Stop, or a fault. Garbage is collected behind each answer, so not before it."""
    ordered = Ordered(joint)
    while not joint.finished:
        sends = ordered.hear(*bus.receive())
        for _delay_ns, identifier, data in sends:
            bus.send(identifier, data)
        if sends:
            gc.collect()
