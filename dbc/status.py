"""State and Heartbeat: which node speaks in which cycle, and when.

Node k mod N sends in cycle k, State and Heartbeat by turns, late enough to follow everything urgent and early enough
to end before the next cycle: a low-priority frame that begins just before kT would delay that cycle by 100 us.
"""

from dbc.codec import Codec

MAX_U8, MAX_U16, MAX_U32 = 0xFF, 0xFFFF, 0xFFFFFFFF


class Status:
    """The turns of one node: `number` names its frames, `turn` of `turns` its cycles.

    tail_ns: how long before the end of the cycle the frame is queued. A node that is later than that skips its turn,
    which `skipped` counts.
    """

    def __init__(self, codec: Codec, number: int, turn: int, turns: int, period_ns: int, tail_ns: int) -> None:
        self.state = codec[f"State_{number}"]
        self.heartbeat = codec[f"Heartbeat_{number}"]
        self.turn = turn
        self.turns = turns
        self.period_ns = period_ns
        self.tail_ns = tail_ns
        self.cycles = 0
        self.skipped = 0

    def sends(
        self, now_ns: int, state: int, fault: int, saturations: int, strikes: int, missed: int, version: int
    ) -> list[tuple[int, int, bytes]]:
        """Return the frame of this cycle as (delay in ns, identifier, data), or nothing. Counters stop at their top."""
        self.cycles += 1
        cycle = now_ns // self.period_ns
        if cycle % self.turns != self.turn:
            return []
        delay_ns = (cycle + 1) * self.period_ns - self.tail_ns - now_ns
        if delay_ns < 0:
            self.skipped += 1
            return []
        if cycle // self.turns % 2 == 0:
            counters = min(saturations, MAX_U16), min(strikes, MAX_U8), min(missed, MAX_U8)
            data = self.state.pack(state, fault, *counters, cycle & 0xFF)
            return [(delay_ns, self.state.identifier, data)]
        data = self.heartbeat.pack(state, version, self.cycles & MAX_U32, cycle & 0xFF)
        return [(delay_ns, self.heartbeat.identifier, data)]
