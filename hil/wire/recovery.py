"""Coming back from bus-off: 128 times 11 recessive bits in a row. Ref: ISO 11898-1:2015, 12.1.4.4 (bus-off)."""

from typing import TYPE_CHECKING

from hil.wire.agenda import DELIVER
from hil.wire.confinement import RECOVERY_BITS, RECOVERY_SEQUENCES

if TYPE_CHECKING:
    from hil.wire.medium import Medium
    from hil.wire.port import Port


class Recovery:
    """Counts the recessive bits of one bus for those who are bus-off."""

    def __init__(self, medium: "Medium") -> None:
        self.off: list[Port] = []
        self._medium = medium
        self._since_ns: int | None = medium.agenda.now_ns

    @property
    def listening(self) -> bool:
        """Whether the bus is recessive, as far as it was told."""
        return self._since_ns is not None

    def dominant(self, since_ns: int) -> None:
        """The bus has been dominant since then."""
        recessive_ns, self._since_ns = self._since_ns, None
        if recessive_ns is not None:
            for port in list(self.off):
                self._hear(port, recessive_ns, since_ns)

    def recessive(self, since_ns: int) -> None:
        """The bus has been recessive since then."""
        self._since_ns = since_ns
        self.expect()

    def expect(self) -> None:
        """Look again when each of them will have heard enough, if the bus stays recessive."""
        if self._since_ns is None:
            return
        agenda = self._medium.agenda
        for port in self.off:
            wanted = RECOVERY_SEQUENCES - port.controller.confinement.sequences
            due_ns = self._begin_ns(port, self._since_ns) + wanted * self._sequence_ns
            agenda.at(max(due_ns, agenda.now_ns), DELIVER, port.order, self._look, (port, self._since_ns))

    def _look(self, expected: tuple["Port", int]) -> None:
        port, since_ns = expected
        if since_ns == self._since_ns and port in self.off:
            self._hear(port, since_ns, self._medium.agenda.now_ns)

    def _hear(self, port: "Port", since_ns: int, until_ns: int) -> None:
        heard_ns = until_ns - self._begin_ns(port, since_ns)
        confinement = port.controller.confinement
        if heard_ns < 0:
            return
        sequences = heard_ns // self._sequence_ns
        if self._since_ns is None:
            confinement.heard(sequences)
        elif confinement.sequences + sequences >= RECOVERY_SEQUENCES:
            confinement.reset()
        if not confinement.off:
            self._medium.reporter.check_states()
            self._medium.rouse()

    @property
    def _sequence_ns(self) -> int:
        return RECOVERY_BITS * self._medium.rates.bit_ns

    @staticmethod
    def _begin_ns(port: "Port", since_ns: int) -> int:
        return max(since_ns, port.controller.off_since_ns)
