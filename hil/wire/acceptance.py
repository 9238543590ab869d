"""Which frames a client takes: python-can's filters, applied where the bus is, so that nobody is woken in vain."""

from collections.abc import Sequence

from hil.wire.identifier import EXTENDED, EXTENDED_MASK, FD

Filter = tuple[int, int, bool | None]
"""(can_id, can_mask, extended or not, None: either)."""


class Acceptance:
    """The identifiers that one of the filters lets pass; none: every one. fd: FD frames as well.

    Ref: python-can, `BusABC.set_filters`.
    """

    def __init__(self, filters: Sequence[Filter], fd: bool) -> None:
        self._fd = fd
        self._filters = filters

    def __contains__(self, identifier: object) -> bool:
        if not isinstance(identifier, int) or (identifier & FD and not self._fd):
            return False
        if not self._filters:
            return True
        number, extended = identifier & EXTENDED_MASK, identifier & EXTENDED != 0
        return any(
            (wanted is None or wanted == extended) and (number ^ can_id) & mask == 0
            for can_id, mask, wanted in self._filters
        )


NOTHING: frozenset[int] = frozenset()
