"""A joint's brake: friction that needs a while to engage and none to release.

Units: N m, integer ns. A brake is Coulomb friction added to the joint's own: it
holds, and it slows a joint that still turns, with the same torque. Not modelled: wear, gradual build-up of the torque.
"""


class Brake:
    """Engaged, engaging or released; starts engaged."""

    def __init__(self, torque_Nm: float, delay_ns: int) -> None:
        self._torque_Nm = torque_Nm
        self._delay_ns = delay_ns
        self._holds_from_ns: int | None = None
        self._released = False

    def engage(self, now_ns: int) -> int:
        """Command it to engage; return the time from which it holds. A brake that engages already keeps its time."""
        if self._released:
            self._released = False
            self._holds_from_ns = now_ns + self._delay_ns
        return now_ns if self._holds_from_ns is None else max(now_ns, self._holds_from_ns)

    def release(self) -> None:
        """Command it to release: immediate, also while it engages."""
        self._released = True

    def state(self, now_ns: int) -> str:
        """Return "engaged", "engaging" or "released"."""
        if self._released:
            return "released"
        holds = self._holds_from_ns is None or now_ns >= self._holds_from_ns
        return "engaged" if holds else "engaging"

    def torque_at(self, now_ns: int) -> float:
        """Return the friction [N m] that it adds."""
        return self._torque_Nm if self.state(now_ns) == "engaged" else 0.0
